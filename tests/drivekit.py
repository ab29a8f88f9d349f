"""What tests of drives share: a world of paper for pure conversations, and a bus with simulated drives in virtual time.

The paper world enforces the bus's own rule on every frame: nothing that may act leaves without a valid permit.
"""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.drives import Drive, DriveLimits, MemoryStore, make_dialect
from drivebus.drives.dialect import Dialect
from drivebus.drives.memory import Memory
from drivebus.drives.operation import Talk
from drivebus.drives.talk import Conversation, Keep, Look, Step, Surroundings, Wait, play
from drivebus.drives.wear import Wear
from drivebus.errors import NoReply, NotPermitted
from drivebus.message import Answer, Ask, Effect
from drivebus.ports import open_port
from drivebus.protocols import modbus, sifang
from drivebus.testing.virtual import run

T = TypeVar("T")
MODELS = ("c320", "vc660", "dzb100", "df800")
SAFE_HZ = {"c320": 20.0, "vc660": 20.0, "dzb100": 0.5, "df800": 20.0}
"""A frequency that each model's drive accepts out of the box (DZB100: below its cap)."""


def dialect_of(model: str, address: int = 1, **settings: Any) -> Dialect:
    return make_dialect(profiles.load(model), address, settings=settings)


def memory_of(dialect: Dialect, limits: DriveLimits | None = None, store: MemoryStore | None = None) -> Memory:
    return Memory(dialect, Wear(store or MemoryStore(), "test/1"), limits or DriveLimits())


@dataclass
class World:
    """Performs steps: ``station`` answers a request with a reply, an exception, or None for silence."""

    dialect: Dialect
    station: Callable[[Any], Any]
    store: MemoryStore = field(default_factory=MemoryStore)
    around: Surroundings = field(default_factory=lambda: Surroundings(0.0, "2026-01-02"))
    transaction_s: float = 0.03
    silence_s: float = 0.3
    asks: list[Ask] = field(default_factory=list)
    on_ask: Callable[[Ask], None] | None = None

    @property
    def now(self) -> float:
        return self.around.now

    def __call__(self, step: Step) -> Any:
        if isinstance(step, Wait):
            self.pass_time(step.seconds)
            return self.now
        if isinstance(step, Look):
            return self.around
        if isinstance(step, Keep):
            return self.store.update(step.key, step.change)
        return self.transact(step)

    def pass_time(self, seconds: float) -> None:
        self.around = replace(self.around, now=self.now + seconds)

    def transact(self, ask: Ask) -> Answer:
        """What the bus does: rights first, then the wire."""
        data = self.dialect.codec.encode_request(ask.request)
        effect = self.dialect.link.effect(data)
        if effect not in (Effect.NONE, Effect.STOP):
            permit = ask.permit
            assert permit is not None and permit.effect is effect and permit.station == ask.station
            assert permit.generation == self.around.generation and self.now <= permit.expires_at
        if effect is Effect.STOP:
            self.around = replace(self.around, generation=self.around.generation + 1)
        self.asks.append(ask)
        sent_at = self.now
        found = self.station(ask.request)
        if self.on_ask is not None:
            self.on_ask(ask)
        if found is None:
            self.pass_time(self.silence_s)
            return Answer(ask, None, NoReply("bus.no_reply", station=ask.station), data, b"", sent_at, None, 1)
        self.pass_time(self.transaction_s)
        if isinstance(found, Exception):
            sent = b"" if isinstance(found, NotPermitted) else data
            return Answer(ask, None, found, sent, b"", sent_at, None, 1)
        return Answer(ask, found, None, data, b"\x00", sent_at, self.now, 1)

    def play(self, conversation: Conversation[T]) -> T:
        return play(conversation, self)

    def sent(self, kind: type, **fields: Any) -> list[Any]:
        """Requests of a kind that left, with these fields."""
        requests = [ask.request for ask in self.asks if isinstance(ask.request, kind)]
        return [r for r in requests if all(getattr(r, name) == value for name, value in fields.items())]

    def effects(self) -> list[Effect]:
        """Effects of everything that left and is no read."""
        found = [self.dialect.link.effect(self.dialect.codec.encode_request(ask.request)) for ask in self.asks]
        return [effect for effect in found if effect is not Effect.NONE]


@dataclass
class PaperC320:
    """A C320 on paper: answers reads, and does with control frames what ``obey`` says."""

    state: int = sifang.State.STOPPED
    output: int = 0
    fault_code: int | None = None
    parameters: dict[tuple[int, int], int] = field(default_factory=lambda: {(0, 1): 2})
    obey: Callable[[PaperC320, sifang.Control], Any] | None = None
    silent: bool = False

    def __call__(self, request: Any) -> Any:
        if self.silent:
            return None
        if isinstance(request, sifang.Control):
            return self.obey(self, request) if self.obey is not None else self.ok()
        if isinstance(request, sifang.WriteParameter):
            self.parameters[request.group, request.item] = request.data
            return self.ok(request.group, request.item, request.data)
        if isinstance(request, sifang.ReadMonitor):
            return self.ok(0, request.item, self.output)
        if isinstance(request, sifang.ReadParameter):
            return self.ok(request.group, request.item, self.parameters.get((request.group, request.item), 0))
        return self.ok()

    def ok(self, group: int = 0, item: int | None = None, data: int = 0) -> sifang.Reply:
        fault = self.fault_code if self.state == sifang.State.FAULT else None
        shown = None if fault is not None else item
        return sifang.Reply(1, sifang.Response.OK, sifang.State(self.state), group, shown, data, fault)


@dataclass
class PaperModbus:
    """Registers on paper; a write to the command register is handed to ``obey``."""

    registers: dict[int, int] = field(default_factory=dict)
    obey: Callable[[PaperModbus, int], bool] | None = None
    written: list[tuple[int, int]] = field(default_factory=list)
    silent: bool = False

    def __call__(self, request: Any) -> Any:
        if self.silent:
            return None
        if isinstance(request, modbus.Loopback):
            return modbus.Looped(request.address, request.data)
        if isinstance(request, modbus.ReadRegisters):
            span = range(request.register, request.register + request.count)
            return modbus.Registers(request.address, 3, tuple(self.registers.get(r, 0) for r in span))
        self.written.append((request.register, request.value))
        if request.register == 0x2000 and self.obey is not None and not self.obey(self, request.value):
            return None
        if request.register == 0x2001:
            self.registers[0x3001] = request.value
        elif request.register < 0x2000:
            self.registers[request.register & 0x7FFF] = request.value
        return modbus.Written(request.address, 6, request.register, request.value)


def talk_of(dialect: Dialect, **more: Any) -> Talk:
    """A conversation with a drive whose pre-flight was not read yet."""
    return Talk(memory_of(dialect, **more))


class Bench:
    """A bus with simulated drives of one model, in virtual time."""

    def __init__(self, model: str, addresses: str = "1", query: str = "", **options: Any) -> None:
        self.model = model
        self.port: Any = open_port(f"sim://{model}@{addresses}" + (f"?{query}" if query else ""))
        self.bus = Bus(self.port)
        self.options = options

    async def __aenter__(self) -> Bench:
        await self.bus.open()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.bus.close()

    def drive(self, address: int = 1, **options: Any) -> Drive:
        return Drive(self.bus, self.model, address, **(self.options | options))

    def station(self, address: int = 1) -> Any:
        return self.port.bench.station(address)


def story(coroutine: Coroutine[Any, Any, T]) -> T:
    """Run a story in virtual time."""
    return run(coroutine)
