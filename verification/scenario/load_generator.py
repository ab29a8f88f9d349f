"""A crowded line: polls as fast as they go, reads that never end, and drives that fall silent, dumb or slow."""

from __future__ import annotations

import asyncio
from math import nextafter

from drivebus.bus import Poll
from drivebus.bus.messages import BusRequest, RequestPriority
from drivebus.testing.virtual_time import running
from verification.campaign import CampaignRun
from verification.drive_variants import DRIVE_VARIANTS, DriveVariant
from verification.scenario.scenario import Scenario
from verification.scenario.user_command import UserCommand

LOAD_LINE_QUALITIES = ("bytes", "lossy,bytes", "late=0.1:0.12,bytes", "late=0.2:1.5", "clean", "noisy,bytes")
LOAD_RAMPS_S = (2.0, 0.5, 8.0)
READER_PRIORITIES = (
    (),
    (RequestPriority.PARAMETER,),
    (RequestPriority.PARAMETER, RequestPriority.COMMAND, RequestPriority.POLL, RequestPriority.PROBE),
)
"""Beside polls as fast as they go: a read of each drive always waits in each of these lanes."""
LOAD_ADDRESSES = range(1, 6)


class LoadGenerator:
    """The ``number`` says which weather, ramp and crowd it is."""

    def __init__(self, session: CampaignRun, kind: DriveVariant, number: int) -> None:
        self.session, self.kind, self.rng = session, kind, session.rng(number)
        turn = number // len(DRIVE_VARIANTS)
        self.ramp_s, self.lanes = (
            LOAD_RAMPS_S[turn % len(LOAD_RAMPS_S)],
            READER_PRIORITIES[turn % len(READER_PRIORITIES)],
        )
        weather = LOAD_LINE_QUALITIES[turn % len(LOAD_LINE_QUALITIES)]
        self.stand = Scenario(
            session,
            kind,
            LOAD_ADDRESSES,
            name=f"{kind.name}/{number}",
            line_quality=weather,
            ramp=self.ramp_s,
            seed=number,
        )
        self.drives_to_stop: set[int] = set()
        """Drives that nobody has started since they were told to stop."""
        self.open_commands: dict[int, list[UserCommand]] = {address: [] for address in LOAD_ADDRESSES}
        """Stops that are under way."""
        self._reader_tasks: list[asyncio.Task[None]] = []

    def start_load(self) -> None:
        """Polls as fast as they go, and reads that never end."""
        with running(self.stand.loop):
            for address, drive in self.stand.drives.items():
                polls = [Poll(request, 0.0) for request, _ in drive.dialect.polls(tuple(drive.profile.signals))]
                self.stand.bus.start_polling(address, polls, lambda answer: None)
                for lane in self.lanes:
                    self._reader_tasks.append(self.stand.loop.create_task(self._read_repeatedly(address, lane)))

    async def _read_repeatedly(self, address: int, lane: RequestPriority) -> None:
        drive = self.stand.drives[address]
        requests = [drive.dialect.read_parameter(p) for p in drive.profile.parameters.values() if p.readable]
        while not self.stand.bus.is_closed:
            await self.stand.bus.transact(BusRequest(address, self.rng.choice(requests), lane))

    def wait_random(self) -> None:
        """A random while; at times to the very moment at which something happens, or just before it."""
        self.stand.run(self.rng.uniform(0.0, 0.4))
        when = self.stand.loop.next_at()
        if when is not None and self.rng.random() < 0.2:
            self.stand.loop.run_until(when if self.rng.random() < 0.5 else nextafter(when, 0.0))

    def disturb_drives(self) -> None:
        """Drives fall silent, dumb or slow and recover; motors are started, at the keypad or over the bus."""
        rng, address = self.rng, self.rng.choice(LOAD_ADDRESSES)
        if rng.random() < 0.1:
            self.fault(address, rng.choice(("silent", "mute", "slow", "", "")))
        if self.open_commands[address] or self.stand.drives[address].stop_pending:
            return
        if rng.random() < 0.5:
            self.drives_to_stop.discard(address)
            self.stand.station(address).keypad_run(rng.choice((5.0, 20.0, 50.0)))
        elif rng.random() < 0.3:
            self.drives_to_stop.discard(address)
            self.stand.command(address, "run", rng.choice((5.0, 20.0)))

    def fault(self, address: int, what: str) -> None:
        faults = self.stand.station(address).faults
        faults.silent, faults.mute = what == "silent", what == "mute"
        faults.added_delay_s = self.rng.uniform(0.0, 0.15) if what == "slow" else 0.0

    def restore_line(self) -> None:
        """The weather clears, nobody reads any more and every drive hears again."""
        self.stand.bench.line_quality = "clean"
        with running(self.stand.loop):
            for task in self._reader_tasks:
                task.cancel()
        for address in LOAD_ADDRESSES:
            self.fault(address, "")
