"""``EepromBudget``: writes to EEPROM, which wears, counted and limited for each parameter and day."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

from drivebus.drives.operations.steps import DriveOperation, UpdateStore
from drivebus.drives.store import Store
from drivebus.errors import EepromBudgetExceeded

DEFAULT_EEPROM_WRITES_PER_DAY = 20  # of one parameter: an EEPROM of 100,000 writes lasts 13 years, of 10,000 1.4


@dataclass(frozen=True, slots=True)
class SaveCount:
    """Number of times a parameter was saved."""

    day: str = ""
    today: int = 0
    total: int = 0
    ram_written: bool = False  # a RAM-only write came after the last save, so the EEPROM may hold another value


class EepromBudget:
    """Budget of EEPROM writes of one drive, counted per parameter and day in a store."""

    def __init__(self, store: Store, key: str, budget: int = DEFAULT_EEPROM_WRITES_PER_DAY) -> None:
        self._store, self._key, self.budget = store, key, budget

    def count(self, notation: str) -> SaveCount:
        """Return the stored count; an unreadable record counts as a used-up budget."""
        return self._parse(self._store.get(self._key_of(notation)))

    def _parse(self, text: str | None) -> SaveCount:
        if text is None:
            return SaveCount()
        try:
            count = SaveCount(**json.loads(text))
        except (ValueError, TypeError, RecursionError):
            return self._used_up()
        types = tuple(map(type, (count.day, count.today, count.total, count.ram_written)))
        return count if types == (str, int, int, bool) else self._used_up()

    def _used_up(self) -> SaveCount:
        return SaveCount("9999-12-31", self.budget, ram_written=True)

    def _key_of(self, notation: str) -> str:
        return f"eeprom/{self._key}/{notation}"

    def consume(self, notation: str, day: str) -> DriveOperation[None]:
        """Count one save before it is sent, as a write that may have happened counts. Raises EepromBudgetExceeded.

        Reading, checking and counting are one step, so that two programs never save on the same count.
        """

        def one_more(old: SaveCount) -> SaveCount:
            today = old.today if day <= old.day else 0  # a clock that is set back gives no new budget
            if today >= self.budget:
                key = "drives.eeprom_clock" if day < old.day else "drives.eeprom_budget"
                raise EepromBudgetExceeded(key, notation=notation, count=today, budget=self.budget, day=old.day)
            return replace(old, day=max(day, old.day), today=today + 1, total=old.total + 1)

        yield from self._change(notation, one_more)

    def mark_saved(self, notation: str) -> DriveOperation[None]:
        """Record that RAM and EEPROM hold the same value again."""
        if self.count(notation).ram_written:
            yield from self._change(notation, lambda old: replace(old, ram_written=False))

    def mark_ram_only(self, notation: str) -> DriveOperation[None]:
        """Record that RAM and EEPROM may differ from now on."""
        if not self.count(notation).ram_written:
            yield from self._change(notation, lambda old: replace(old, ram_written=True))

    def _change(self, notation: str, change: Callable[[SaveCount], SaveCount]) -> DriveOperation[None]:
        yield UpdateStore(self._key_of(notation), lambda text: json.dumps(asdict(change(self._parse(text)))))
