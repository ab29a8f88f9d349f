"""Dead stations on a full line: the living keep their cycle, and whoever comes back is found (G08, ruling 12)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from random import Random
from typing import Any

from drivebus.bus import Poll
from drivebus.lab.bounds import Times
from drivebus.lab.campaign import Campaign, Session
from drivebus.lab.kinds import C320, C320_HEX, KINDS, VC660, Kind
from drivebus.lab.manual import request
from drivebus.lab.world.loop import running
from drivebus.lab.world.stand import Stand
from drivebus.message import Answer, Ask

STATIONS = 31
STRETCH = 1.112
"""Ruling 12: the most that any number of dead stations may cost the living."""
PROBE_SHARE = 0.1
FOUND_S = 60.0
ASKED_S = 2.0
"""A station that somebody asks by hand is found within this time; DF800, whose fences are alike, that much later."""
LIVES_S, DIES_S, SETTLES_S, WATCHED_S = 5.0, 10.0, 20.0, 60.0
STEP_S = 0.01
MISSED_S = 0.03
"""Longer than any question is on the wire."""
SLICE = ((VC660, 1), (VC660, 5), (VC660, 15), (VC660, 30)) + tuple(
    (kind, 4 + 5 * place) for place, kind in enumerate(kind for kind in KINDS if kind is not VC660)
)


def addresses_of(kind: Kind) -> range:
    """31 stations: C320 has the addresses 0 to 30, 31 is its broadcast."""
    return range(31) if kind in (C320, C320_HEX) else range(1, 32)


class Line:
    """31 stations that are polled as fast as the bus goes; some of them die or were never there."""

    def __init__(self, session: Session, kind: Kind, dead: int) -> None:
        self.session, self.kind, self.number = session, kind, dead
        self.rng: Random = session.rng(kind.name, dead)
        self.stand = Stand(session, kind, addresses_of(kind), name=f"{kind.name}, {dead} dead", seed=1 + dead)
        self.stations = {station.address: station for station in self.stand.bench.stations}
        self.dead = self.rng.sample(addresses_of(kind), dead)
        self.heard: dict[int, list[float]] = defaultdict(list)
        """When each station answered a poll."""
        self._asked = -1
        """Whom the host spoke to last."""
        self._replied: dict[int, int] = {}
        self._poll()
        self._tap()

    def _poll(self) -> None:
        with running(self.stand.loop):
            for address, drive in self.stand.drives.items():
                self.stand.bus.watch(address, [Poll(drive.dialect.plain_read(), 0.0)], self._heard)

    def _heard(self, answer: Answer) -> None:
        if answer.error is None and answer.received_at is not None:
            self.heard[answer.ask.station].append(answer.received_at)

    def _tap(self) -> None:
        wire: Any = self.stand.bench.wire
        say = wire.say

        def on_say(talker: Any, data: bytes, *more: Any, **named: Any) -> Any:
            if hasattr(talker, "hear"):
                self._asked = request(self.kind.model, self.kind.encoding, data)[0]
            return say(talker, data, *more, **named)

        wire.say = on_say

    def die(self) -> None:
        """Every other case: they were never there; else they die one after the other at random instants."""
        if self.number % 2:
            self._silence(*self.dead)
        self.stand.run(LIVES_S)
        for at, address in sorted((self.rng.uniform(0.0, DIES_S), address) for address in self.dead):
            self.stand.run(max(0.0, LIVES_S + at - self.stand.loop.time()))
            self._silence(address)
        self.stand.run(LIVES_S + DIES_S + SETTLES_S - self.stand.loop.time())

    def _silence(self, *addresses: int) -> None:
        for address in addresses:
            self.stations[address].faults.silent = True
            self.stand.witness.note(f"{address} is silent")

    def cycles_s(self) -> list[float]:
        """Mean time between two answers of each living station."""
        since = self.stand.loop.time()
        self.stand.run(WATCHED_S)
        living = [address for address in self.stand.drives if address not in self.dead]
        times = [[at for at in self.heard[address] if at >= since] for address in living]
        return [(one[-1] - one[0]) / (len(one) - 1) for one in times]

    # --- coming back -----------------------------------------------------------------------------------------------

    def _back(self, address: int) -> float:
        """The station hears again; when that was."""
        station = self.stations[address]
        station.faults.silent, self._replied[address] = False, station.replies
        self.stand.witness.note(f"{address} hears again")
        return self.stand.loop.time()

    def _tick(self) -> None:
        """A short while, without the look around that ``stand.run`` ends with."""
        self.stand.loop.run_until(self.stand.loop.time() + STEP_S)

    def _found_s(self, address: int, at: float, within_s: float) -> float:
        """Seconds until it was asked and answered; twice ``within_s`` is watched, and no more."""
        while self.stand.loop.time() < at + 2 * within_s:
            if self.stations[address].replies > self._replied[address]:
                return self.stand.loop.time() - at
            self._tick()
        return float("inf")

    def revive_one(self, within_s: float) -> float:
        """One station comes back while the others stay dead, just when it has been asked in vain."""
        address = self.dead.pop()
        self._asked = -1
        while self._asked != address:
            self._tick()
        self.stand.run(MISSED_S)
        return self._found_s(address, self._back(address), within_s)

    def revive_asked(self) -> float:
        """One comes back, and somebody asks it at once. Seconds until the answer is there."""
        address = self.dead.pop()
        at, drive = self._back(address), self.stand.drives[address]
        with running(self.stand.loop):
            asking = self.stand.loop.create_task(self.stand.bus.transact(Ask(address, drive.dialect.plain_read())))
        while not asking.done():
            self._tick()
        answer: Answer = asking.result()
        return float("inf") if answer.received_at is None else answer.received_at - at

    def revive_all(self, within_s: float) -> float:
        """All the others come back at once; the last one counts."""
        at = max([self._back(address) for address in self.dead], default=0.0)
        return max([self._found_s(address, at, within_s) for address in self.dead], default=0.0)


def run(session: Session) -> None:
    alone: dict[str, float] = {}
    worst: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    for kind, dead in list(_cases())[: session.budget]:
        if kind.name not in alone:
            alone[kind.name] = _mean(_living(session, kind)) / STATIONS
        _case(session, Line(session, kind, dead), alone[kind.name], worst[kind.name])
        session.did()
    for name, found in worst.items():
        session.figures[name] = {what: round(most, 4) for what, most in found.items()}


def _cases() -> Iterator[tuple[Kind, int]]:
    """Those of the slice first."""
    yield from SLICE
    yield from ((kind, dead) for dead in range(1, STATIONS) for kind in KINDS if (kind, dead) not in SLICE)


def _living(session: Session, kind: Kind) -> list[float]:
    """The cycles of a line on which nobody is dead."""
    line = Line(session, kind, 0)
    line.stand.run(LIVES_S)
    cycles = line.cycles_s()
    line.stand.close()
    return cycles


def _case(session: Session, line: Line, alone_s: float, worst: dict[str, float]) -> None:
    """``alone_s``: what one poll costs on a line on which nobody is dead."""
    line.die()
    cycles = line.cycles_s()
    stretch = _mean(cycles) / (alone_s * len(cycles))
    _note(line, worst, "stretch", stretch, STRETCH)
    worst["stretch of a single drive"] = max(worst["stretch of a single drive"], max(cycles) / (alone_s * len(cycles)))
    probe_s = Times(line.kind, line.stand.bench.line).probe_s
    within_s = max(FOUND_S, line.number * probe_s / PROBE_SHARE)
    _note(line, worst, "found after s", line.revive_one(within_s), within_s)
    if line.dead:
        asked_s = line.revive_asked()
        session.count("asked by hand: later than 2 s", int(asked_s > ASKED_S))
        _note(line, worst, "asked and found after s", asked_s, ASKED_S + line.kind.alike_s)
    _note(line, worst, "all found after s", line.revive_all(within_s), within_s)
    session.count("stations revived", line.number)
    line.stand.close()


def _note(line: Line, worst: dict[str, float], what: str, value: float, most: float) -> None:
    line.stand.witness.note(f"{what}: {value:.4f}")
    worst[what] = max(worst[what], value)
    if value > most:
        line.stand.witness.violation(f"G08 {what}: {value:.4f}, more than {most:.4f}")


def _mean(values: list[float]) -> float:
    return sum(values) / len(values)


CAMPAIGN = Campaign("fairness", "cases", ("G08",), len(KINDS) * (STATIONS - 1), len(SLICE), run)
