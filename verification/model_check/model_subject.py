"""Subject of the model check: one drive model and one kind of command, on a grid of time."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import floor
from typing import Any

from drivebus import profiles
from drivebus.drives.context import DriveContext
from drivebus.drives.dialects.base import CommandFrame, Dialect, Hold, StopMode
from drivebus.drives.dialects.create import create_dialect
from drivebus.drives.eeprom_budget import EepromBudget
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.permissives import CommandKind
from drivebus.drives.readings import ReadingPairs
from drivebus.drives.state import Direction
from drivebus.drives.store import MemoryStore
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.protocols.codec import Effect
from drivebus.serial_settings import SerialSettings, StationTiming
from drivebus.values import Reading
from verification.model_check.permit_monitor import COMMAND_LIFETIMES_S
from verification.reference.effects import RequestEffect

# --- time grid --------------------------------------------------------------------------------------------------------

FINE_STEP_S = 2.0**-10
"""Distance from a tick to the instant just after it, in seconds."""
GRID_START_S = 4096.0
"""Start time of the model, in seconds."""


@dataclass(frozen=True, slots=True)
class TimeGrid:
    """Grid of time, exact in binary: whole ticks, with ``fine`` also the instants just after them.

    Every frame, reply, gap and quarantine takes one tick, so that all orders of events are finite. ``tick_s`` is a
    power of two or a whole number.
    """

    tick_s: float
    fine: bool = True

    def after(self, now: float) -> float:
        """Return the next instant."""
        whole = floor(now / self.tick_s) * self.tick_s
        return now + FINE_STEP_S if self.fine and now == whole else whole + self.tick_s

    @property
    def timing(self) -> StationTiming:
        """Delays of a station on this grid."""
        return StationTiming(
            gap_characters=1.0,
            reply_delay_s=0.0,
            adapter_latency_s=0.0,
            turnaround_s=self.tick_s,
            max_reply_lateness_s=self.tick_s,
        )


class GridSerialSettings(SerialSettings):
    """Serial settings in which any number of characters takes one tick."""

    tick_s = 0.5
    character_s = 0.0  # no station, no gap

    def seconds(self, characters: float) -> float:
        return self.tick_s if characters else 0.0


def grid_serial_settings(grid: TimeGrid) -> SerialSettings:
    """Return serial settings in which any number of characters takes one tick of this grid."""
    kind = type("Line", (GridSerialSettings,), {"tick_s": grid.tick_s})
    made: SerialSettings = kind()
    return made


# --- subject ----------------------------------------------------------------------------------------------------------

MODEL_NAMES = ("c320", "dzb100", "vc660", "df800")
OUR_ADDRESS, OTHER_ADDRESS = 1, 2
"""Stations of the model: the commanded one, and one whose permits must not count."""
START_FREQUENCY_HZ = {"c320": 0.5, "dzb100": 0.5}
"""Frequency of a start, in Hz: below the cap of a drive whose scale is not calibrated; 20 Hz elsewhere."""
START_DIRECTION = {"vc660": Direction.REVERSE, "df800": None}
"""Direction of a start: reverse where every later word must repeat it; none for the uncalibrated DF800."""


@dataclass(slots=True, kw_only=True)
class ModelSubject:
    """Objects that all states of one search share; the command word, which changes, is restored for each state."""

    model: str
    kind: CommandKind
    grid: TimeGrid
    dialect: Dialect
    other: Dialect
    op: OperationContext
    frames: tuple[CommandFrame, ...]
    foreign: Any
    """Same request to the other station."""
    permit_needs: dict[tuple[int, tuple[Any, ...]], bool] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return f"{self.model}/{self.kind.value}"

    def limit_s(self, effect: RequestEffect) -> float:
        """Return how long the command is valid for a frame with this effect."""
        life_s = COMMAND_LIFETIMES_S[self.kind.value]
        return min(life_s, COMMAND_LIFETIMES_S["start"]) if effect is RequestEffect.MOTION else life_s

    @property
    def command_word(self) -> tuple[Any, ...]:
        word = getattr(self.dialect, "command_word", None)
        return () if word is None else (word.levels, word._last_was_edge, word._holds)

    @command_word.setter
    def command_word(self, held: tuple[Any, ...]) -> None:
        if held:
            word: Any = getattr(self.dialect, "command_word", None)
            word.levels, word._last_was_edge, word._holds = held

    def needs_permit(self, place: int, command_word: tuple[Any, ...]) -> bool:
        """Return whether this frame needs a permit: whether it is more than a stop for a drive with these levels."""
        found = self.permit_needs.get((place, command_word))
        if found is None:
            self.command_word = command_word
            frame = self.dialect.codec.encode_request(self.frames[place].request)
            found = self.permit_needs[place, command_word] = (
                self.dialect.station_config.effect_of(frame) is not Effect.STOP
            )
        return found

    def stop_request(self, mode: StopMode) -> Any:
        """Return the first request of a stop: the one that stops the drive."""
        return self.dialect.stop(mode)[0]


def model_subject(model: str, kind: CommandKind, grid: TimeGrid) -> ModelSubject:
    """Build the subject of one model and command kind."""
    options: dict[str, Any] = {"setpoint_step": "0.01"} if model == "c320" else {}
    options |= {"direction_calibrated": True} if model == "df800" and kind is CommandKind.JOG else {}
    ours, other = (
        create_dialect(profiles.load(model), address, options=options, timing=grid.timing)
        for address in (OUR_ADDRESS, OTHER_ADDRESS)
    )
    op = OperationContext(DriveContext(dialect=ours, eeprom_budget=EepromBudget(MemoryStore(), "model/1")))
    frames, foreign = _command_frames(ours, kind, op), _command_frames(other, kind, op)[0].request
    subject = ModelSubject(
        model=model, kind=kind, grid=grid, dialect=ours, other=other, op=op, frames=frames, foreign=foreign
    )
    if subject.command_word:  # the status, which is read before each command, has shown no pause
        subject.command_word = (None, False, frozenset())
    return subject


def _command_frames(dialect: Dialect, kind: CommandKind, op: OperationContext) -> tuple[CommandFrame, ...]:
    model = dialect.profile.model
    word = op.drive.check_frequency(START_FREQUENCY_HZ.get(model, 20.0))[0]
    if kind is CommandKind.START:
        return dialect.start(START_DIRECTION.get(model, Direction.FORWARD), word)
    if kind is CommandKind.JOG:
        return dialect.jog(Direction.FORWARD, None if dialect.profile.family == "modbus" else word)
    if kind is CommandKind.PAUSE:
        return (dialect.hold(Hold.PAUSE),)
    if kind is CommandKind.RAMP_HOLD:
        return (dialect.hold(Hold.RAMP), dialect.end_hold())
    return dialect.reset() if kind is CommandKind.RESET else dialect.set_frequency(word, _runs_forward())


def _runs_forward() -> ReadingPairs:
    """Return the reading pairs of a running DZB100: its last command, read twice."""
    pairs = ReadingPairs()
    for _ in range(2):
        pairs.add({"command": Reading(value=1, raw=1)})
    return pairs


def normal_reply(request: Any, codec: Any) -> bytes:
    """Return the reply of a station that executes the request."""
    reply: Any
    if isinstance(request, sunfar.SunfarControl | sunfar.ReadMonitor | sunfar.SunfarReadParameter):
        group, item = getattr(request, "group", 0), getattr(request, "item", 0)
        reply = sunfar.SunfarReply(
            address=request.address,
            response=sunfar.SunfarResponse.OK,
            state=sunfar.SunfarState.STOPPED,
            group=group,
            item=item,
            data=0,
        )
    elif isinstance(request, dzb100.Dzb100Control | dzb100.Dzb100Query | dzb100.Dzb100ReadParameter):
        reply = dzb100.Dzb100Reply(
            head=chr(request.head), address=request.address, index=request.index, data=request.data, accepted=True
        )
    elif isinstance(request, modbus.ReadRegisters):
        reply = modbus.RegisterValues(request.address, 3, (0,) * request.count)
    elif isinstance(request, modbus.Diagnostics):
        reply = modbus.DiagnosticsReply(request.address, request.data)
    else:
        reply = modbus.WriteAck(request.address, 6, request.register, request.value)
    found: bytes = codec.encode_reply(reply)
    return found
