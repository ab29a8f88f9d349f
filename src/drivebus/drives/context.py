"""What the host keeps of one drive between conversations. Values and one counter; no clock, no port."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace

from drivebus.bus.messages import BusResult
from drivebus.drives.dialects.base import Dialect
from drivebus.drives.operations.steps import BusConditions, DriveOperation, UpdateStore
from drivebus.drives.permissives import CommandKind, DriveCommand
from drivebus.drives.state import Direction
from drivebus.drives.store import Store
from drivebus.errors import CapabilityError, ConfigurationError, EepromBudgetExceeded, LimitError
from drivebus.profiles.model import Text

DEFAULT_EEPROM_WRITES_PER_DAY = 20
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

    def __init__(self, store: Store, key: str, budget: int = DEFAULT_EEPROM_WRITES_PER_DAY) -> None:
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


@dataclass(frozen=True, slots=True)
class DriveLimits:
    """The user's own limits. Those of frequency, in Hz, can only be narrower than the profile's.

    Raises ConfigurationError where ``eeprom_writes_per_day`` is no whole number from 0.
    """

    minimum_hz: float = 0.0
    maximum_hz: float | None = None
    forward: bool = True
    reverse: bool = True
    eeprom_writes_per_day: int = DEFAULT_EEPROM_WRITES_PER_DAY
    """How often a day each parameter may be written to EEPROM, 0: never (G16). Counted over restarts."""

    def __post_init__(self) -> None:
        found = self.eeprom_writes_per_day
        if type(found) is not int or found < 0:
            raise ConfigurationError("drives.eeprom_writes_per_day", found=found)


@dataclass(frozen=True, slots=True)
class UnmetPrecondition:
    """A precondition that does not hold."""

    notation: str
    found: int | None
    accepted: tuple[int, ...]
    keypad: Text


@dataclass(frozen=True, slots=True)
class Preflight:
    """Does this drive listen to the bus? What holds, what does not, and what can't be read (named, never assumed)."""

    satisfied: tuple[str, ...]
    unmet: tuple[UnmetPrecondition, ...]
    unreadable: tuple[tuple[str, Text], ...]
    at: float

    @property
    def passed(self) -> bool:
        """Everything that can be read holds."""
        return not self.unmet


@dataclass(slots=True)
class DriveContext:
    """One drive's dialect, limits, pre-flight, ramps, wear and command numbers."""

    dialect: Dialect
    eeprom_budget: EepromBudget
    limits: DriveLimits = field(default_factory=DriveLimits)
    preflight: Preflight | None = None
    acceleration_s: float | None = None
    deceleration_s: float | None = None
    command_count: int = 0
    on_read: Callable[[BusResult], None] = lambda _answer: None
    """Told of every read that a conversation took into its book."""

    def create_command(self, kind: CommandKind, around: BusConditions) -> DriveCommand:
        """A new wish, made now."""
        self.command_count += 1
        return DriveCommand(f"{kind.value}-{self.command_count}", kind, around.now, around.stop_epoch)

    def require_capability(self, capability: str) -> None:
        """Raises CapabilityError where the model can't; nothing is sent."""
        profile = self.dialect.profile
        if capability not in profile.capabilities:
            raise CapabilityError("drives.cannot", model=profile.model, what=capability)

    @property
    def maximum_hz(self) -> float:
        profile, own = self.dialect.profile.limits.maximum_hz, self.limits.maximum_hz
        return profile if own is None else min(profile, own)

    @property
    def minimum_hz(self) -> float:
        return max(self.dialect.profile.limits.minimum_hz, self.limits.minimum_hz)

    def check_frequency(self, frequency_hz: float) -> tuple[int, float]:
        """The raw word of a frequency and what the drive makes of it, both within the limits. Raises LimitError."""
        self._check_limits(frequency_hz)
        word = self.dialect.setpoint_word(frequency_hz)
        actual_hz = self.dialect.setpoint_frequency(word)
        self._check_limits(actual_hz)
        return word, actual_hz

    def _check_limits(self, frequency_hz: float) -> None:
        if not frequency_hz <= self.maximum_hz:
            raise LimitError("drives.above_maximum", frequency_hz=frequency_hz, limit_hz=self.maximum_hz)
        if frequency_hz < self.minimum_hz:
            raise LimitError("drives.below_minimum", frequency_hz=frequency_hz, limit_hz=self.minimum_hz)

    def check_direction(self, direction: Direction | None) -> None:
        """Raises CapabilityError (the model can't) or LimitError (the user forbids it)."""
        if direction is Direction.REVERSE:
            self.require_capability("reverse")
        allowed = self.limits.reverse if direction is Direction.REVERSE else self.limits.forward
        unsure = (
            direction is None
            and not self.dialect.reports_run_state
            and not (self.limits.forward and self.limits.reverse)
        )
        if not allowed or unsure:
            raise LimitError("drives.direction_forbidden", direction=direction or Direction.FORWARD)
