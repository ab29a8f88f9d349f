"""``late`` (G04, I5): shares of 0 to 20 % of all replies come late, by up to 5 s; none may answer another question.

Stations answer in the order in which they were asked, however late (the wire holds a reply back behind an earlier
one): no fence could tell anything of a drive that does not. So what is shown is ruling 2's: lateness up to the
quarantine, and beyond it in order; the figures tell how many replies came later than the family's longest lateness.

Two judges: the witness (I5: the request that caused the delivered frame), and ``Maker``: between asking and hearing
the station made exactly this reply, and it never shows the same values twice in a row. A naive host on the same line
shows that there were mistakes to be made.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from random import Random
from typing import Any

from drivebus.bus import Poll
from drivebus.lab.campaign import Campaign, Session
from drivebus.lab.kinds import KINDS, Kind
from drivebus.lab.world.lateness import Lateness, Maker
from drivebus.lab.world.loop import Loop, running
from drivebus.lab.world.naive import NaiveHost
from drivebus.lab.world.stand import Stand
from drivebus.ports import open_port
from drivebus.protocols import dzb, modbus, sifang

ADDRESSES = (1, 2, 3, 4, 5)
SHARES = (0.0, 0.001, 0.01, 0.05, 0.1, 0.2)
LATENESS_S = (0.15, 0.5, 2.0, 5.0, 5.0, 5.0)
CHUNK = 2000
"""Transactions of one line; then comes another share and lateness."""
NAIVE_SHARE = 0.05
"""The naive host does so many of the bus's transactions."""
STEP_S = 2.0
LONGEST_S = 3600.0
"""Of virtual time for a chunk: a line on which nobody is asked any more must not hang the campaign."""
READ_PAUSE_S = 0.4
CHECKLESS = frozenset({"dzb100"})
"""Frames without a check value: a character that two stations made together is any digit, and only the second reading
tells. That is damage, no misattribution; it is counted apart."""
PARAMETERS = {
    "c320": ("F0.1", "F0.2", "F1.10", "F4.0", "F9.4"),
    "dzb100": ("00", "01", "10", "23", "77"),
    "vc660": ("F00.00", "F00.01", "F00.02", "F00.03"),
    "df800": ("F1.00", "F1.01", "F1.02", "F1.07", "F1.08"),
}


def questions(kind: Kind, address: int) -> tuple[Any, ...]:
    """Reads of one value each, whose answers look alike; all values change."""
    if kind.model == "c320":
        return tuple(sifang.ReadMonitor(address, item) for item in (0, 2, 3, 5))
    if kind.model == "dzb100":
        return tuple(dzb.Query(address, item) for item in (0, 1, 2))
    registers = (0x3002, 0x3003, 0x300B) if kind.model == "vc660" else (0, 3, 5, 6)
    return tuple(modbus.ReadRegisters(address, register, 1) for register in registers)


class Line:
    """One stand under one weather, with as many same-shaped questions as it bears."""

    def __init__(self, session: Session, kind: Kind, name: str, chance: Random) -> None:
        self.kind, self.chance, self.session = kind, chance, session
        self.share, self.late_s = chance.choice(SHARES), chance.choice(LATENESS_S)
        self.seed, self.bytes = chance.randrange(2**31), chance.random() < 0.1
        self.counts: Counter[str] = Counter()
        self.stand = stand = Stand(session, kind, ADDRESSES, name=name, seed=self.seed)
        stand.bench.weather = self.weather
        self.maker, self.lateness = Maker(stand.bench), Lateness(stand, self.counts)
        self._accept, self.accepted = stand.bus.core._accept, 0
        stand.bus.core._accept = self._accepting  # type: ignore[method-assign]
        stand.monitor(chance.choice(ADDRESSES))
        with running(stand.loop):
            for address in ADDRESSES:
                polls = [Poll(question, 0.0) for question in questions(kind, address)]
                stand.bus.watch(address, polls, lambda answer: None)
            stand.loop.create_task(self._reader())

    @property
    def weather(self) -> str:
        return f"late={self.share}:{self.late_s}" + (",bytes" if self.bytes else "")

    async def _reader(self) -> None:
        """A user who reads parameters now and then."""
        while True:
            await asyncio.sleep(self.chance.expovariate(1 / READ_PAUSE_S))
            names = self.chance.sample(PARAMETERS[self.kind.model], 2)
            await self.stand.drives[self.chance.choice(ADDRESSES)].read(names)

    def _accepting(self, flight: Any, now: float) -> None:
        """Whatever the bus believes, the answers of its own fences too."""
        self.accepted += 1
        self.lateness.believed(flight.heard_at)
        times = flight.job.station.address, flight.sent_at, flight.heard_at
        if self.maker.right(*times, bytes(flight.buffer)):
            pass
        elif self.kind.model in CHECKLESS and self._spoilt(flight, *times):
            self.counts["the right answer, spoilt by another station's late one, believed"] += 1
        else:
            self.stand.witness.violation(f"G04 {flight.buffer.hex()} is no answer to {flight.job.data.hex()}")
        self._accept(flight, now)

    def _spoilt(self, flight: Any, address: int, sent_at: float, heard_at: float) -> bool:
        """The one answer to this question, but another station's late reply fell into it."""
        made = self.maker.between(address, sent_at, heard_at)
        return [len(said) for said in made] == [len(flight.buffer)] and self.lateness.spoilt(heard_at)

    def do(self, frames: int) -> None:
        """So many transactions at least."""
        end = self.stand.loop.time() + LONGEST_S
        while self.stand.witness.frames < frames and self.stand.loop.time() < end:
            self.stand.run(STEP_S)
        witness = self.stand.witness
        if witness.frames < frames or not 0 < witness.accepted <= self.accepted:
            answers = f"{witness.accepted} or {self.accepted} answers"
            witness.violation(
                f"{witness.frames} requests and {answers} in {LONGEST_S} s: nobody asks, or nobody judges"
            )
        self.stand.close()

    def do_naively(self, frames: int) -> Counter[str]:
        """The control, under the same weather and seed."""
        loop, counts = Loop(), Counter[str]()
        asked = [
            (address, self.stand.drives[address].dialect.codec.encode_request(question))
            for address in ADDRESSES
            for question in questions(self.kind, address)
        ]
        with running(loop):
            options = {"baud": self.kind.baud, "seed": self.seed, **self.kind.options}
            query = "&".join(f"{name}={value}" for name, value in options.items())
            port: Any = open_port(f"sim://{self.kind.model}@{','.join(map(str, ADDRESSES))}?{query}")
            port.bench.weather = self.weather
            port.bench.now()
            maker = Maker(port.bench)

            def believed(address: int, sent_at: float, now: float, data: bytes) -> None:
                counts["believed"] += 1
                counts["misattributed"] += not maker.right(address, sent_at, now, data)

            host = NaiveHost(self.kind, port, loop, asked, believed)
        loop.run(host.open())
        while host.frames < frames:
            loop.run_until(loop.time() + STEP_S)
        counts["transactions"] += host.frames
        return counts


def run(session: Session) -> None:
    """All kinds in turn, a chunk each, until each has done the budget."""
    found: dict[str, Counter[str]] = {kind.name: Counter() for kind in KINDS}
    naive: dict[str, Counter[str]] = {kind.name: Counter() for kind in KINDS}
    number = 0
    while session.left:
        frames = min(CHUNK, session.left)
        for kind in KINDS:
            line = Line(session, kind, f"{kind.name}/{number}", session.rng(kind.name, number))
            line.do(frames)
            found[kind.name].update(line.counts, transactions=line.stand.witness.frames)
            naive[kind.name].update(line.do_naively(max(1, int(frames * NAIVE_SHARE))))
        number += 1
        session.did(frames)
    _tell(session, found, naive)


def _tell(session: Session, found: dict[str, Counter[str]], naive: dict[str, Counter[str]]) -> None:
    session.figures["order"] = "stations answer in the order in which they were asked, however late"
    for kind in KINDS:
        shown: dict[str, object] = {"longest_lateness_s": kind.lateness_s, **dict(sorted(found[kind.name].items()))}
        session.figures[kind.name] = shown | {"naive_host": dict(sorted(naive[kind.name].items()))}
        session.line(f"{kind.name}: {session.figures[kind.name]}")


CAMPAIGN = Campaign("late", "transactions of each kind", ("G04", "I5", "I4", "F01", "T04"), 10**6, 4000, run)
