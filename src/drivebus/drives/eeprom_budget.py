"""EEPROM writes are counted, per parameter and day, where they survive the program (G16, ruling 8). Pure: the caller
stores. These drives have no serial number to key on: the key is port identity + address.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

from drivebus.drives.operations.steps import DriveOperation, UpdateStore
from drivebus.drives.store import Store
from drivebus.errors import EepromBudgetExceeded

DEFAULT_SAVES_PER_DAY = 20
"""Writes of one parameter a day: at 100,000 writes an EEPROM lasts 13 years of that, at 10,000 1.4."""


@dataclass(frozen=True, slots=True)
class SaveCount:
    """How often a parameter was saved."""

    day: str = ""
    today: int = 0
    total: int = 0
    ram_written: bool = False
    """A RAM-only write came after the last save: the EEPROM may hold something else (ruling 8)."""


class EepromBudget:
    """Counters of one drive over a Store."""

    def __init__(self, store: Store, key: str, budget: int = DEFAULT_SAVES_PER_DAY) -> None:
        self._store, self._key, self.budget = store, key, budget

    def count(self, notation: str) -> SaveCount:
        """What is stored; a record that can't be read counts as a used-up budget, never as none."""
        return self._parse(self._store.get(self._key_of(notation)))

    def _parse(self, text: str | None) -> SaveCount:
        if text is None:
            return SaveCount()
        try:
            return SaveCount(**json.loads(text))
        except (ValueError, TypeError):
            return SaveCount("9999-12-31", self.budget, 0, True)

    def _key_of(self, notation: str) -> str:
        return f"wear/{self._key}/{notation}"

    def consume(self, notation: str, day: str) -> DriveOperation[None]:
        """Count one save *before* it is sent: a write that may have happened counts. Raises WearBudget.

        Read, judged and counted as one: two programs never save on the same count.
        """

        def one_more(old: SaveCount) -> SaveCount:
            today = old.today if day <= old.day else 0  # a clock set back gives no new budget (F21)
            if today >= self.budget:
                key = "drives.wear_clock" if day < old.day else "drives.wear_budget"
                raise EepromBudgetExceeded(key, notation=notation, count=today, budget=self.budget, day=old.day)
            return replace(old, day=max(day, old.day), today=today + 1, total=old.total + 1)

        yield from self._change(notation, one_more)

    def mark_saved(self, notation: str) -> DriveOperation[None]:
        """The drive is known to have saved: RAM and EEPROM are the same again. Never before that is known."""
        if self.count(notation).ram_written:
            yield from self._change(notation, lambda old: replace(old, ram_written=False))

    def mark_ram_only(self, notation: str) -> DriveOperation[None]:
        """Remember that RAM and EEPROM may differ from now on."""
        if not self.count(notation).ram_written:
            yield from self._change(notation, lambda old: replace(old, ram_written=True))

    def _change(self, notation: str, change: Callable[[SaveCount], SaveCount]) -> DriveOperation[None]:
        yield UpdateStore(self._key_of(notation), lambda text: json.dumps(asdict(change(self._parse(text)))))
