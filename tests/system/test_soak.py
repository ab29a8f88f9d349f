"""Everything at once, seeded: silent drives, trips, power cuts, pulled adapters, changing weather, people who start and
stop; and the invariants asserted all the way (I1, I2, I4, I6, I10)."""

from __future__ import annotations

import asyncio
import random
from typing import Any

import pytest

from drivebus.drives import Monitor
from drivebus.errors import DrivebusError
from drivebus.simulator.motor import Trip
from drivebus.values import Quality
from fixtures.system_bench import LINE_QUALITIES, SystemBench, SystemVariant, every_family, run_virtual, system_bench

MINUTES = 3
PREPARATION_MAX_S = 5.0
COMMAND_EXPIRY_S = 2.0
"""A frame that moves leaves no later than this after the command, and the command no later than that after the wish."""
STATE_SETTLED_MAX_S = 6.0
"""What has been so for this long must not be reported otherwise."""


class RandomUser:
    """Wishes at random instants, and remembers them: each start or new frequency, and each stop."""

    def __init__(self, here: SystemBench, chance: random.Random) -> None:
        self.here, self.chance = here, chance
        self.commands: dict[int, list[tuple[float, float]]] = {address: [] for address in here.drives}
        """When a motion was wished for, and when that wish had ended."""
        self.runs = dict.fromkeys(here.drives, 0)
        self.tasks: set[asyncio.Task[None]] = set()

    def command(self) -> None:
        """One more wish, whatever becomes of the older ones."""
        task = asyncio.ensure_future(self._issue_command(self.chance.choice(list(self.here.drives))))
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    async def _issue_command(self, address: int) -> None:
        drive, begun = self.here.drives[address], self.here.bus.now()
        command = self.chance.choice(("run", "run", "stop", "stop", "set", "reset"))
        try:
            if command == "run":
                self.runs[address] += 1
                await drive.run(self.chance.choice((5.0, 12.0, 20.0)))
            elif command == "stop":
                await drive.stop(wait=self.chance.random() < 0.5)
            elif command == "set":
                await drive.set_frequency(self.chance.choice((5.0, 12.0, 20.0)))
            else:
                await drive.reset_fault()
        except DrivebusError:
            pass
        if command in ("run", "set"):
            self.commands[address].append((begun, self.here.bus.now()))


def disturb(here: SystemBench, chance: random.Random) -> None:
    """One more thing goes wrong, or right again."""
    station = here.station(chance.choice(list(here.drives)))
    match chance.randrange(9):
        case 0 | 1:
            station.faults.silent = not station.faults.silent
        case 2:
            station.faults.mute = not station.faults.mute
        case 3:
            station.trip(chance.choice(list(Trip)))
        case 4:
            station.power_cycle(chance.uniform(0.5, 5.0))
        case 5:
            here.bench.line_quality = chance.choice(list(LINE_QUALITIES.values()))
        case 6:
            station.keypad_stop()
        case 7:
            here.bench.unplug()
        case _:
            here.bench.replug()


class MotorObserver:
    """Since when each motor has been on or off."""

    def __init__(self, here: SystemBench) -> None:
        self.here = here
        self.since: dict[int, tuple[bool, float]] = {}

    def observe(self) -> None:
        now = self.here.bus.now()
        for address in self.here.drives:
            on = self.here.station(address).motor.energised
            if self.since.get(address, (not on, 0.0))[0] is not on:
                self.since[address] = (on, now)

    def check(self, address: int, monitor: Monitor) -> None:
        """I4: nothing good is old; and no state that has been untrue for long."""
        status, now = monitor.status(), self.here.bus.now()
        signals = self.here.drives[address].profile.signals
        for name, reading in status.readings.items():
            if reading.quality is Quality.GOOD:
                age = reading.age_s(now)
                assert age is not None and age <= max(3 * signals[name].period_s, 1.0) + 0.4
        on, since = self.since[address]
        if now - since > STATE_SETTLED_MAX_S:
            assert status.state != ("stopped" if on else "running")


def check_motion_frames(here: SystemBench, person: RandomUser) -> None:
    """I1, I10: every frame that may start or speed up a motor lies within a wish, and soon after it."""
    for one in here.tap.requests_sent:
        address = address_in(here.kind, one.data)
        if not moves(here.kind, one.data):
            continue
        assert any(
            begun - 1e-9 <= one.start <= min(ended, begun + PREPARATION_MAX_S + COMMAND_EXPIRY_S) + 0.1
            for begun, ended in person.commands[address]
        ), f"nobody wished for {one}"


def address_in(kind: SystemVariant, frame: bytes) -> int:
    """By the manuals' tables."""
    if kind.encoding == "hex":
        return frame[2]
    if kind.encoding == "rtu":
        return frame[0]
    if kind.model == "dzb100":
        return int(frame[3:5])
    return int(frame[1:3], 16)


def moves(kind: SystemVariant, frame: bytes) -> bool:
    """Does this frame start or jog? Starts by the manuals' tables, with no codec."""
    if kind.model == "c320":
        return frame[5] in (b"\x11\x12\x01\x02" if kind.encoding == "hex" else b"") or frame[4:6] in (
            b"11",
            b"12",
            b"01",
        )
    if kind.model == "dzb100":
        return frame[:1] == b"C" and frame[6:7] in b"13"
    words: Any = frame if kind.encoding == "rtu" else bytes.fromhex(frame[1:-2].decode())
    command = words[1] == 6 and words[2:4] == b"\x20\x00"
    return bool(command and (words[5] & 1 if kind.model == "vc660" else words[5] & 3 == 2))


@pytest.mark.parametrize("seed", [1, 2, 18])
@every_family
def test_the_invariants_hold_for_three_minutes_on_a_bad_line(kind: SystemVariant, seed: int) -> None:
    async def scenario() -> None:
        chance = random.Random(seed)
        async with system_bench(kind, "1-4", "clean", seed=seed) as here:
            person, truth = RandomUser(here, chance), MotorObserver(here)
            monitors = {address: drive.monitor() for address, drive in here.drives.items()}
            for step in range(MINUTES * 120):
                await asyncio.sleep(0.5)
                if step % 4 == 0:
                    person.command()
                if step % 10 == 0:
                    disturb(here, chance)
                if step % 60 == 59:
                    here.bench.replug()
                truth.observe()
                for address, monitor in monitors.items():
                    truth.check(address, monitor)
            here.bench.replug()
            here.bench.line_quality = "clean"
            for station in here.bench.stations:
                station.faults.silent = station.faults.mute = False
                station.motor.reset()
            await asyncio.sleep(130.0)
            assert not person.tasks, "every wish has ended"
            check_motion_frames(here, person)
            for address in here.drives:
                assert here.station(address).motor.starts <= person.runs[address], "I2"
            here.tap.check(kind)
            for monitor in monitors.values():
                monitor.close()
            for drive in here.drives.values():
                assert (await drive.stop()).succeeded
            assert all(not here.station(n).motor.energised for n in here.drives) or not kind.reports_running

    run_virtual(scenario())
