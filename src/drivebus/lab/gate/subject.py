"""What the gate campaign is about: one model and one intent, with the real dialect, conversation and frames."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from drivebus import profiles
from drivebus.drives.book import Book
from drivebus.drives.dialect import Dialect, Frame, Stop
from drivebus.drives.gate import Kind
from drivebus.drives.make import make_dialect
from drivebus.drives.memory import Memory
from drivebus.drives.operation import Talk
from drivebus.drives.state import Direction
from drivebus.drives.store import MemoryStore
from drivebus.drives.wear import Wear
from drivebus.lab.gate.bytes import Act
from drivebus.lab.gate.grid import Grid
from drivebus.lab.gate.monitor import LIVES_S
from drivebus.message import Effect
from drivebus.protocols import dzb, modbus, sifang
from drivebus.reading import Reading

MODELS = ("c320", "dzb100", "vc660", "df800")
OURS, OTHER = 1, 2
"""Two stations of the model: the one commanded, and one whose permits must not count."""
HZ = {"dzb100": 0.5}
"""Below the DZB100's cap; 20 Hz elsewhere."""
WAYS = {"vc660": Direction.REVERSE, "df800": None}
"""Reverse where the direction is a level that every later word must repeat; DF800 takes none until it is proved."""


@dataclass(slots=True)
class Subject:
    """Shared by all states of one exploration; what changes in it (the levels a VC660 holds) is put back each time."""

    model: str
    kind: Kind
    grid: Grid
    dialect: Dialect
    other: Dialect
    talk: Talk
    frames: tuple[Frame, ...]
    foreign: Any
    """The same request to the other station."""
    known: dict[tuple[int, tuple[Any, ...]], bool] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return f"{self.model}/{self.kind.value}"

    def limit_s(self, act: Act) -> float:
        """Rulings 12: how long the wish lives for a frame that does this."""
        life_s = LIVES_S[self.kind.value]
        return min(life_s, LIVES_S["start"]) if act is Act.MOVES else life_s

    @property
    def shadow(self) -> tuple[Any, ...]:
        word = getattr(self.dialect, "word", None)
        return () if word is None else (word.levels, word._began)

    @shadow.setter
    def shadow(self, held: tuple[Any, ...]) -> None:
        if held:
            word: Any = getattr(self.dialect, "word", None)
            word.levels, word._began = held

    def acts(self, place: int, shadow: tuple[Any, ...]) -> bool:
        """Is this frame more than a stop to a drive that holds these levels? A stop needs no leave."""
        found = self.known.get((place, shadow))
        if found is None:
            self.shadow = shadow
            frame = self.dialect.codec.encode_request(self.frames[place].request)
            found = self.known[place, shadow] = self.dialect.link.effect(frame) is not Effect.STOP
        return found

    def stops(self, how: Stop) -> Any:
        """The request that stops now."""
        return self.dialect.stop(how)[0]


def subject(model: str, kind: Kind, grid: Grid) -> Subject:
    """Raises what the dialect raises."""
    settings = {"direction_proved": True} if model == "df800" and kind is Kind.JOG else {}
    ours, other = (
        make_dialect(profiles.load(model), address, settings=settings, timing=grid.timing) for address in (OURS, OTHER)
    )
    talk = Talk(Memory(ours, Wear(MemoryStore(), "lab/1")))
    frames, foreign = _frames(ours, kind, talk), _frames(other, kind, talk)[0].request
    return Subject(model, kind, grid, ours, other, talk, frames, foreign)


def _frames(dialect: Dialect, kind: Kind, talk: Talk) -> tuple[Frame, ...]:
    model = dialect.profile.model
    word = talk.memory.check_frequency(HZ.get(model, 20.0))[0]
    if kind is Kind.START:
        return dialect.start(WAYS.get(model, Direction.FORWARD), word)
    if kind is Kind.JOG:
        return dialect.jog(Direction.FORWARD, None if dialect.profile.family == "modbus" else word)
    return dialect.reset() if kind is Kind.RESET else dialect.set_frequency(word, _runs_forward())


def _runs_forward() -> Book:
    """What a DZB100 that runs shows: its last command, read twice."""
    book = Book()
    for _ in range(2):
        book.note({"command": Reading(1, raw=1)})
    return book


def reply_to(request: Any, codec: Any) -> bytes:
    """The bytes of a station that does what it is told."""
    reply: Any
    if isinstance(request, sifang.Control | sifang.ReadMonitor | sifang.ReadParameter):
        group, item = getattr(request, "group", 0), getattr(request, "item", 0)
        reply = sifang.Reply(request.address, sifang.Response.OK, sifang.State.STOPPED, group, item, 0)
    elif isinstance(request, dzb.Control | dzb.Query | dzb.ReadParameter):
        reply = dzb.Reply(chr(request.head), request.address, request.index, request.data, True)
    elif isinstance(request, modbus.ReadRegisters):
        reply = modbus.Registers(request.address, 3, (0,) * request.count)
    elif isinstance(request, modbus.Loopback):
        reply = modbus.Looped(request.address, request.data)
    else:
        reply = modbus.Written(request.address, 6, request.register, request.value)
    found: bytes = codec.encode_reply(reply)
    return found
