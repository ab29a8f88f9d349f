"""State of one drive between operations: limits, pre-flight check, ramps and EEPROM budget."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import isnan

from drivebus.bus.messages import BusResult
from drivebus.drives.dialects.base import Dialect
from drivebus.drives.eeprom_budget import DEFAULT_EEPROM_WRITES_PER_DAY, EepromBudget
from drivebus.drives.operations.steps import BusConditions
from drivebus.drives.permissives import CommandKind, DriveCommand
from drivebus.drives.state import Direction
from drivebus.errors import CapabilityError, ConfigurationError, LimitError, Superseded
from drivebus.values import Text


@dataclass(frozen=True, slots=True)
class DriveLimits:
    """Limits set by the user; frequency limits in Hz can only narrow those of the profile.

    Raises ConfigurationError where ``eeprom_writes_per_day`` is not a whole number from 0, or a frequency is NaN.
    """

    minimum_hz: float = 0.0
    maximum_hz: float | None = None
    forward: bool = True
    reverse: bool = True
    eeprom_writes_per_day: int = DEFAULT_EEPROM_WRITES_PER_DAY  # of each parameter, counted across restarts; 0: none

    def __post_init__(self) -> None:
        budget = self.eeprom_writes_per_day
        if type(budget) is not int or budget < 0:
            raise ConfigurationError("drives.eeprom_writes_per_day", found=budget)
        for name, hz in (("minimum_hz", self.minimum_hz), ("maximum_hz", self.maximum_hz)):
            if hz is not None and isnan(hz):
                raise ConfigurationError("drives.limit_is_nan", name=name)


@dataclass(frozen=True, slots=True)
class UnmetPrecondition:
    """Precondition of the profile that the drive does not meet."""

    notation: str
    found: int | None
    accepted: tuple[int, ...]
    keypad: Text
    rejection: Text | None = None
    """Why the drive rejected the read; its setting is unknown then."""


@dataclass(frozen=True, slots=True)
class Preflight:
    """Result of the pre-flight check: does the drive accept commands from the bus?

    What can't be read is named in ``unreadable`` and never assumed to be met.
    """

    satisfied: tuple[str, ...]
    unmet: tuple[UnmetPrecondition, ...]
    unreadable: tuple[tuple[str, Text], ...]
    at: float
    """Time of its end, in seconds by ``Bus.now``."""

    @property
    def passed(self) -> bool:
        """Whether every precondition that can be read is met."""
        return not self.unmet


@dataclass(slots=True, kw_only=True)
class DriveContext:
    """Dialect, limits, pre-flight check, ramps, EEPROM budget and command numbers of one drive."""

    dialect: Dialect
    eeprom_budget: EepromBudget
    limits: DriveLimits = field(default_factory=DriveLimits)
    preflight: Preflight | None = None
    acceleration_s: float | None = None
    deceleration_s: float | None = None
    command_count: int = 0
    model_key: str | None = None  # in the store: of the model that last passed its pre-flight check here
    was_this_model: bool = False  # the stored record names this model
    contact_losses: int = 0  # of the station when it last answered: a later loss voids the pre-flight check
    model_assumed: bool = False  # the user states that the station is of this model: its stops are sent unread
    withdrawal: Superseded | None = None  # why the commands that were under way at that moment are not continued
    on_read: Callable[[BusResult], None] = lambda _result: None  # called with every read of an operation

    def create_command(self, kind: CommandKind, conditions: BusConditions) -> DriveCommand:
        """Create a command now."""
        self.command_count += 1
        return DriveCommand(f"{kind.value}-{self.command_count}", kind, conditions.now, conditions.stop_epoch)

    def require_capability(self, capability: str) -> None:
        """Raise CapabilityError where the model lacks a capability."""
        profile = self.dialect.profile
        if capability not in profile.capabilities:
            raise CapabilityError("drives.cannot", model=profile.model, what=capability)

    @property
    def maximum_hz(self) -> float:
        profile_hz, own_hz = self.dialect.profile.limits.maximum_hz, self.limits.maximum_hz
        return profile_hz if own_hz is None else min(profile_hz, own_hz)

    @property
    def minimum_hz(self) -> float:
        return max(self.dialect.profile.limits.minimum_hz, self.limits.minimum_hz)

    def check_frequency(self, frequency_hz: float) -> tuple[int, float]:
        """Return the raw word of a frequency and the frequency that it means. Raises LimitError."""
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
        """Raise CapabilityError where the model can't reverse, LimitError where the user forbids a direction."""
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
