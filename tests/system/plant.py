"""A plant for whole-system stories: real Bus, real Drive, pretend drives, virtual time; and a witness on the wire.

The witness (``Tap``) shares no code with the bus: it sees what the simulated copper carried, with the times of the
first and the last bit, and holds the bus to numbers that are written here from the manuals.
"""

from __future__ import annotations

import asyncio
import itertools
from bisect import bisect_right
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

import pytest

from drivebus.bus import Bus
from drivebus.drives import Drive, MemoryStore
from drivebus.errors import DrivebusError
from drivebus.ports import open_port
from drivebus.sim.bench import Bench
from drivebus.testing.virtual import run

T = TypeVar("T")

WEATHERS = {"clean": "clean", "byte by byte": "bytes", "lossy": "lossy,bytes", "late": "late=0.1:0.12,bytes"}
"""The four lines. ``late``: one reply in ten comes up to 120 ms too late, within every family's longest lateness."""

SETTLED = {"setpoint_coding": "hex-0.1", "query_coding": "hex-0.1", "parameter_coding": "hex-0.1"}


@dataclass(frozen=True)
class Kind:
    """One family in one encoding, and what its manual says of times (RELIABILITY 5 where the manual is silent)."""

    name: str
    model: str
    encoding: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    options: Mapping[str, str] = field(default_factory=dict)
    """Options of the bench."""
    gap_characters: float = 3.5
    gap_floor_s: float = 0.0
    patience_s: float = 0.1
    """The host may give up no sooner after its last bit, whatever it asked …"""
    patience_characters: float = 8
    """… plus so many characters."""
    tells: bool = True
    """The drive reports whether it runs."""
    starts: int = 1
    station_s: float = 0.0
    station_characters: float = 0.0
    """The pretend drive's own delay: it answers after the longer of both."""

    def url(self, addresses: str = "1", weather: str = "clean", **options: Any) -> str:
        query = {"weather": weather, "ramp": "2", **self.options, **{k: str(v) for k, v in options.items()}}
        return f"sim://{self.model}@{addresses}?" + "&".join(f"{key}={value}" for key, value in query.items())


C320 = Kind(
    "c320-ascii", "c320", "ascii", gap_characters=5, patience_s=0.0, patience_characters=26, station_characters=4
)
C320_HEX = Kind(
    "c320-hex", "c320", "hex", gap_characters=5, patience_s=0.0, patience_characters=26, station_characters=4
)
DZB100 = Kind("dzb100", "dzb100", "ascii", SETTLED, gap_characters=3.5, patience_characters=11, station_characters=5)
VC660 = Kind("vc660", "vc660", "rtu", gap_floor_s=0.00175, patience_s=0.004, station_s=0.004, station_characters=3.5)
DF800 = Kind(
    "df800-rtu", "df800", "rtu", {"direction_proved": True}, gap_floor_s=0.00175, tells=False, station_s=0.005,
    station_characters=3.5,
)  # fmt: skip
DF800_ASCII = Kind(
    "df800-ascii", "df800", "ascii", {"direction_proved": True}, {"encoding": "ascii"}, gap_characters=3.5,
    patience_characters=15, tells=False, station_s=0.005, station_characters=3.5,
)  # fmt: skip
SISTERS = tuple(
    Kind(name, name, "ascii", gap_characters=5, patience_s=0.0, patience_characters=26, station_characters=4)
    for name in ("c300", "e300", "e500", "e550")
)
FAMILIES = (C320, C320_HEX, DZB100, VC660, DF800, DF800_ASCII)
KINDS = (*FAMILIES, *SISTERS)
TELLING = tuple(kind for kind in KINDS if kind.tells)

on_four_lines = pytest.mark.parametrize("weather", WEATHERS.values(), ids=WEATHERS)
every_family = pytest.mark.parametrize("kind", FAMILIES, ids=lambda kind: kind.name)
every_drive = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
every_telling_drive = pytest.mark.parametrize("kind", TELLING, ids=lambda kind: kind.name)


class Carried(NamedTuple):
    """What the copper carried: seconds of the first and last bit, and whether a host said it."""

    start: float
    end: float
    data: bytes
    by_host: bool
    said: Any
    """The wire's own record: a collision afterwards shows in it."""
    reached: bool
    """False where the weather lost it: nobody heard it."""

    by_bytes: bool
    """Hosts get each byte as it ends; else the frame when all of it has ended."""

    @property
    def heard_end(self) -> float | None:
        """When the last of it reached a host: what collides with an earlier frame is swallowed. None: nothing did."""
        kept = [index for index in range(len(self.data)) if index not in self.said.dropped]
        if not kept or not self.reached:
            return None
        return self.start + (kept[-1] + 1) * float(self.said.character_s) if self.by_bytes else self.end


class Tap:
    """Writes down everything that anybody says on a bench's wire."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.carried: list[Carried] = []
        bench.now()  # the bench moves into this loop: its wire is a new one
        say = bench.wire.say

        def heard(talker: Any, data: bytes, *more: Any, **named: Any) -> Any:
            said = say(talker, data, *more, **named)
            per_byte = bench.wire.weather.per_byte
            reached = any(event[3] is said for event in bench.wire._events)
            self.carried.append(
                Carried(said.start, said.end, bytes(data), hasattr(talker, "hear"), said, reached, per_byte)
            )
            return said

        bench.wire.say = heard  # type: ignore[method-assign]

    @property
    def asked(self) -> list[Carried]:
        """What hosts said."""
        return [one for one in self.carried if one.by_host]

    @property
    def answered(self) -> list[Carried]:
        return [one for one in self.carried if not one.by_host]

    def requests(self, data: bytes) -> int:
        """How often exactly these bytes left a host."""
        return sum(one.data == data for one in self.asked)

    def check(self, kind: Kind) -> None:
        """I6: never a second request before the first was answered or its time was over; never a gap too short."""
        character = self.bench.line.character_s
        gap = max(kind.gap_characters * character, kind.gap_floor_s)
        asked = self.asked
        assert asked, "nobody said anything"
        ends = sorted(one.end for one in self.answered)
        heard_ends = sorted(end for one in self.answered if (end := one.heard_end) is not None)
        patience = min(kind.patience_s + kind.patience_characters * character, 0.1)
        for earlier, later in itertools.pairwise(asked):
            assert later.start - earlier.end >= gap - 1e-9, f"{later} comes too soon after {earlier}"
            answered = bisect_right(ends, later.start) > bisect_right(ends, earlier.end)
            assert answered or later.start - earlier.end >= patience - 1e-9, (
                f"{later} was said while {earlier} was neither answered nor given up"
            )
        for one in asked:
            before = bisect_right(heard_ends, one.start)
            silence = one.start - heard_ends[before - 1] if before else gap
            assert silence >= gap - 1e-9, f"{one} comes {silence} s after an answer"


class Plant:
    """One bus, its drives, its bench and the witness."""

    def __init__(self, kind: Kind, bus: Bus, tap: Tap, drives: Mapping[int, Drive]) -> None:
        self.kind, self.bus, self.tap, self.drives = kind, bus, tap, drives
        self.bench: Bench = tap.bench

    @property
    def drive(self) -> Drive:
        return next(iter(self.drives.values()))

    def station(self, address: int | None = None) -> Any:
        return self.bench.station(next(iter(self.drives)) if address is None else address)

    @property
    def motor(self) -> Any:
        return self.station().motor

    def link(self, address: int = 1) -> Any:
        return self.drives[address].dialect.link


@asynccontextmanager
async def plant(
    kind: Kind,
    addresses: str = "1",
    weather: str = "clean",
    *,
    drives: bool = True,
    settings: Any = None,
    **options: Any,
) -> AsyncIterator[Plant]:
    """An open bus on a bench of pretend drives, a Drive for each where wanted."""
    port: Any = open_port(kind.url(addresses, weather, **options))
    bench: Bench = port.bench
    tap = Tap(bench)
    for station in bench.stations:
        station.memory.eeprom_writes.clear()  # the ramps were set at the keypad
        station.memory.ram_writes.clear()
    bus = Bus(port, name=kind.name)
    chosen = dict(kind.settings) | dict(settings or {})
    made = {
        station.address: Drive(
            bus, kind.model, station.address, encoding=kind.encoding, settings=chosen, store=MemoryStore()
        )
        for station in (bench.stations if drives else ())
    }
    await bus.open()
    try:
        yield Plant(kind, bus, tap, made)
    finally:
        await bus.close()


async def until(condition: Callable[[], bool], step_s: float = 0.05) -> None:
    """Wait in virtual time; a day at most."""
    for _ in range(int(86400 / step_s)):
        if condition():
            return
        await asyncio.sleep(step_s)
    raise AssertionError("it never came about")


async def ending(wish: Coroutine[Any, Any, Any]) -> Any:
    """The Outcome of a command, also where it is carried by an error; the error itself where it carries none."""
    try:
        return await wish
    except DrivebusError as error:
        return error if error.outcome is None else error.outcome


def story(coroutine: Coroutine[Any, Any, T]) -> T:
    """Run a story in virtual time."""
    return run(coroutine, longest_s=3 * 86400.0)
