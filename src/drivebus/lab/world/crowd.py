"""A crowded line: polls as fast as they go, reads that never end, and drives that fall silent, dumb or slow."""

from __future__ import annotations

import asyncio
from math import nextafter

from drivebus.bus import Poll
from drivebus.lab.campaign import Session
from drivebus.lab.kinds import KINDS, Kind
from drivebus.lab.world.loop import running
from drivebus.lab.world.stand import Stand
from drivebus.lab.world.wishes import Wish
from drivebus.message import Ask, Lane

WEATHERS = ("bytes", "lossy,bytes", "late=0.1:0.12,bytes", "late=0.2:1.5", "clean", "noisy,bytes")
RAMPS_S = (2.0, 0.5, 8.0)
CROWDS = ((), (Lane.PARAMETER,), (Lane.PARAMETER, Lane.COMMAND, Lane.POLL, Lane.PROBE))
"""Beside polls as fast as they go: a read of each drive always waits in each of these lanes."""
ADDRESSES = range(1, 6)


class Crowd:
    """The ``number`` says which weather, ramp and crowd it is."""

    def __init__(self, session: Session, kind: Kind, number: int) -> None:
        self.session, self.kind, self.rng = session, kind, session.rng(number)
        turn = number // len(KINDS)
        self.ramp_s, self.lanes = RAMPS_S[turn % len(RAMPS_S)], CROWDS[turn % len(CROWDS)]
        weather = WEATHERS[turn % len(WEATHERS)]
        self.stand = Stand(
            session, kind, ADDRESSES, name=f"{kind.name}/{number}", weather=weather, ramp=self.ramp_s, seed=number
        )
        self.to_stand: set[int] = set()
        """Drives that nobody has started since they were told to stop."""
        self.open: dict[int, list[Wish]] = {address: [] for address in ADDRESSES}
        """Stops that are under way."""
        self._reading: list[asyncio.Task[None]] = []

    def begin(self) -> None:
        """Polls as fast as they go, and reads that never end."""
        with running(self.stand.loop):
            for address, drive in self.stand.drives.items():
                polls = [Poll(request, 0.0) for request, _ in drive.dialect.polls(tuple(drive.profile.signals))]
                self.stand.bus.watch(address, polls, lambda answer: None)
                for lane in self.lanes:
                    self._reading.append(self.stand.loop.create_task(self._reads(address, lane)))

    async def _reads(self, address: int, lane: Lane) -> None:
        drive = self.stand.drives[address]
        requests = [drive.dialect.read_parameter(p) for p in drive.profile.parameters.values() if p.readable]
        while not self.stand.bus.is_closed:
            await self.stand.bus.transact(Ask(address, self.rng.choice(requests), lane))

    def wait(self) -> None:
        """A random while; at times to the very moment at which something happens, or just before it."""
        self.stand.run(self.rng.uniform(0.0, 0.4))
        when = self.stand.loop.next_at()
        if when is not None and self.rng.random() < 0.2:
            self.stand.loop.run_until(when if self.rng.random() < 0.5 else nextafter(when, 0.0))

    def disturb(self) -> None:
        """Drives fall silent, dumb or slow and recover; motors are started, at the keypad or over the bus."""
        rng, address = self.rng, self.rng.choice(ADDRESSES)
        if rng.random() < 0.1:
            self.fault(address, rng.choice(("silent", "mute", "slow", "", "")))
        if self.open[address] or self.stand.drives[address].stop_pending:
            return
        if rng.random() < 0.5:
            self.to_stand.discard(address)
            self.stand.station(address).press_run(rng.choice((5.0, 20.0, 50.0)))
        elif rng.random() < 0.3:
            self.to_stand.discard(address)
            self.stand.wish(address, "run", rng.choice((5.0, 20.0)))

    def fault(self, address: int, what: str) -> None:
        faults = self.stand.station(address).faults
        faults.silent, faults.mute = what == "silent", what == "mute"
        faults.slow_s = self.rng.uniform(0.0, 0.15) if what == "slow" else 0.0

    def calm(self) -> None:
        """The weather clears, nobody reads any more and every drive hears again."""
        self.stand.bench.weather = "clean"
        with running(self.stand.loop):
            for task in self._reading:
                task.cancel()
        for address in ADDRESSES:
            self.fault(address, "")
