"""What the gate campaign is about: one model and one intent, with the real dialect, conversation and frames."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from drivebus import profiles
from drivebus.drives.context import DriveContext, EepromBudget
from drivebus.drives.dialects.base import CommandFrame, Dialect, StopMode
from drivebus.drives.dialects.create import create_dialect
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.permissives import CommandKind
from drivebus.drives.readings import ReadingPairs
from drivebus.drives.state import Direction
from drivebus.drives.store import MemoryStore
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.protocols.codec import Effect
from drivebus.values import Reading
from verification.model_check.permit_monitor import COMMAND_LIFETIMES_S
from verification.model_check.time_grid import TimeGrid
from verification.reference.request_effects import RequestEffect

MODEL_NAMES = ("c320", "dzb100", "vc660", "df800")
OUR_ADDRESS, OTHER_ADDRESS = 1, 2
"""Two stations of the model: the one commanded, and one whose permits must not count."""
START_FREQUENCY_HZ = {"dzb100": 0.5}
"""Below the DZB100's cap; 20 Hz elsewhere."""
START_DIRECTION = {"vc660": Direction.REVERSE, "df800": None}
"""Reverse where the direction is a level that every later word must repeat; DF800 takes none until it is proved."""


@dataclass(slots=True)
class ModelSubject:
    """Shared by all states of one exploration; what changes in it (the levels a VC660 holds) is put back each time."""

    model: str
    kind: CommandKind
    grid: TimeGrid
    dialect: Dialect
    other: Dialect
    talk: OperationContext
    frames: tuple[CommandFrame, ...]
    foreign: Any
    """The same request to the other station."""
    permit_needs: dict[tuple[int, tuple[Any, ...]], bool] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return f"{self.model}/{self.kind.value}"

    def limit_s(self, act: RequestEffect) -> float:
        """How long the wish lives for a frame that does this."""
        life_s = COMMAND_LIFETIMES_S[self.kind.value]
        return min(life_s, COMMAND_LIFETIMES_S["start"]) if act is RequestEffect.MOTION else life_s

    @property
    def command_word(self) -> tuple[Any, ...]:
        word = getattr(self.dialect, "command_word", None)
        return () if word is None else (word.levels, word._last_was_edge)

    @command_word.setter
    def command_word(self, held: tuple[Any, ...]) -> None:
        if held:
            word: Any = getattr(self.dialect, "command_word", None)
            word.levels, word._last_was_edge = held

    def needs_permit(self, place: int, shadow: tuple[Any, ...]) -> bool:
        """Is this frame more than a stop to a drive that holds these levels? A stop needs no leave."""
        found = self.permit_needs.get((place, shadow))
        if found is None:
            self.command_word = shadow
            frame = self.dialect.codec.encode_request(self.frames[place].request)
            found = self.permit_needs[place, shadow] = self.dialect.station_config.effect_of(frame) is not Effect.STOP
        return found

    def stop_request(self, how: StopMode) -> Any:
        """The request that stops now."""
        return self.dialect.stop(how)[0]


def model_subject(model: str, kind: CommandKind, grid: TimeGrid) -> ModelSubject:
    """Raises what the dialect raises."""
    options = {"direction_calibrated": True} if model == "df800" and kind is CommandKind.JOG else {}
    ours, other = (
        create_dialect(profiles.load(model), address, options=options, timing=grid.timing)
        for address in (OUR_ADDRESS, OTHER_ADDRESS)
    )
    talk = OperationContext(DriveContext(ours, EepromBudget(MemoryStore(), "lab/1")))
    frames, foreign = _command_frames(ours, kind, talk), _command_frames(other, kind, talk)[0].request
    return ModelSubject(model, kind, grid, ours, other, talk, frames, foreign)


def _command_frames(dialect: Dialect, kind: CommandKind, talk: OperationContext) -> tuple[CommandFrame, ...]:
    model = dialect.profile.model
    word = talk.drive.check_frequency(START_FREQUENCY_HZ.get(model, 20.0))[0]
    if kind is CommandKind.START:
        return dialect.start(START_DIRECTION.get(model, Direction.FORWARD), word)
    if kind is CommandKind.JOG:
        return dialect.jog(Direction.FORWARD, None if dialect.profile.family == "modbus" else word)
    return dialect.reset() if kind is CommandKind.RESET else dialect.set_frequency(word, _runs_forward())


def _runs_forward() -> ReadingPairs:
    """What a DZB100 that runs shows: its last command, read twice."""
    book = ReadingPairs()
    for _ in range(2):
        book.add({"command": Reading(1, raw=1)})
    return book


def normal_reply(request: Any, codec: Any) -> bytes:
    """The bytes of a station that does what it is told."""
    reply: Any
    if isinstance(request, sunfar.SunfarControl | sunfar.ReadMonitor | sunfar.SunfarReadParameter):
        group, item = getattr(request, "group", 0), getattr(request, "item", 0)
        reply = sunfar.SunfarReply(
            request.address, sunfar.SunfarResponse.OK, sunfar.SunfarState.STOPPED, group, item, 0
        )
    elif isinstance(request, dzb100.Dzb100Control | dzb100.Dzb100Query | dzb100.Dzb100ReadParameter):
        reply = dzb100.Dzb100Reply(chr(request.head), request.address, request.index, request.data, True)
    elif isinstance(request, modbus.ReadRegisters):
        reply = modbus.RegisterValues(request.address, 3, (0,) * request.count)
    elif isinstance(request, modbus.Diagnostics):
        reply = modbus.DiagnosticsReply(request.address, request.data)
    else:
        reply = modbus.WriteAck(request.address, 6, request.register, request.value)
    found: bytes = codec.encode_reply(reply)
    return found
