"""Random disturbances at once, seeded: silent drives, trips, power cuts, unplugged adapters, bad lines, users.

The invariants I1, I2, I4, I6 and I10 are checked throughout.
"""

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
"""Longest time of the reads between the call of a command and its frame."""
COMMAND_EXPIRY_S = 2.0
"""Expiry of a command: a frame that moves is sent at most this long after its command."""
STATE_SETTLED_MAX_S = 6.0
"""A motor state that has lasted this long must not be reported otherwise."""


class RandomUser:
    """User who issues commands at random instants, with a record of starts and new frequencies."""

    def __init__(self, bench: SystemBench, rng: random.Random) -> None:
        self.bench, self.rng = bench, rng
        self.commands: dict[int, list[tuple[float, float]]] = {address: [] for address in bench.drives}
        """Start and end time of each command that may move the motor."""
        self.runs = dict.fromkeys(bench.drives, 0)
        self.tasks: set[asyncio.Task[None]] = set()

    def command(self) -> None:
        """Issue a random command without waiting for earlier ones."""
        task = asyncio.ensure_future(self._issue_command(self.rng.choice(list(self.bench.drives))))
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    async def _issue_command(self, address: int) -> None:
        drive, started_at = self.bench.drives[address], self.bench.bus.now()
        command = self.rng.choice(("run", "run", "stop", "stop", "set", "reset"))
        try:
            if command == "run":
                self.runs[address] += 1
                await drive.run(self.rng.choice((5.0, 12.0, 20.0)))
            elif command == "stop":
                await drive.stop(wait=self.rng.random() < 0.5)
            elif command == "set":
                await drive.set_frequency(self.rng.choice((5.0, 12.0, 20.0)))
            else:
                await drive.reset_fault()
        except DrivebusError:
            pass
        if command in ("run", "set"):
            self.commands[address].append((started_at, self.bench.bus.now()))


def disturb(bench: SystemBench, rng: random.Random) -> None:
    """Inject or clear a random fault."""
    station = bench.station(rng.choice(list(bench.drives)))
    match rng.randrange(9):
        case 0 | 1:
            station.faults.silent = not station.faults.silent
        case 2:
            station.faults.mute = not station.faults.mute
        case 3:
            station.trip(rng.choice(list(Trip)))
        case 4:
            station.power_cycle(rng.uniform(0.5, 5.0))
        case 5:
            bench.simulated_bus.line_quality = rng.choice(list(LINE_QUALITIES.values()))
        case 6:
            station.keypad_stop()
        case 7:
            bench.simulated_bus.unplug()
        case _:
            bench.simulated_bus.replug()


class MotorObserver:
    """State of each motor, on or off, and the time of its last change."""

    def __init__(self, bench: SystemBench) -> None:
        self.bench = bench
        self.since: dict[int, tuple[bool, float]] = {}

    def observe(self) -> None:
        now = self.bench.bus.now()
        for address in self.bench.drives:
            on = self.bench.station(address).motor.energised
            if self.since.get(address, (not on, 0.0))[0] is not on:
                self.since[address] = (on, now)

    def check(self, address: int, monitor: Monitor) -> None:
        """Check that no good value is old and that no reported state has been wrong for long (I4)."""
        status, now = monitor.status(), self.bench.bus.now()
        signals = self.bench.drives[address].profile.signals
        for name, reading in status.readings.items():
            if reading.quality is Quality.GOOD:
                age = reading.age_s(now)
                assert age is not None and age <= max(3 * signals[name].period_s, 1.0) + 0.4
        on, since = self.since[address]
        if now - since > STATE_SETTLED_MAX_S:
            assert status.state != ("stopped" if on else "running")


def check_motion_frames(bench: SystemBench, user: RandomUser) -> None:
    """Check that every frame that may start or accelerate a motor belongs to a recent command (I1, I10)."""
    for frame in bench.tap.requests_sent:
        address = address_in(bench.variant, frame.data)
        if not moves(bench.variant, frame.data):
            continue
        assert any(
            started_at - 1e-9 <= frame.start <= min(ended, started_at + PREPARATION_MAX_S + COMMAND_EXPIRY_S) + 0.1
            for started_at, ended in user.commands[address]
        ), f"no command for {frame}"


def address_in(variant: SystemVariant, frame: bytes) -> int:
    """Return the address of a frame by the tables of the manuals."""
    if variant.encoding == "hex":
        return frame[2]
    if variant.encoding == "rtu":
        return frame[0]
    if variant.model == "dzb100":
        return int(frame[3:5])
    return int(frame[1:3], 16)


def moves(variant: SystemVariant, frame: bytes) -> bool:
    """Return whether a frame starts a motor, by the tables of the manuals and without a codec."""
    if variant.model == "c320":
        return frame[5] in (b"\x11\x12\x01\x02" if variant.encoding == "hex" else b"") or frame[4:6] in (
            b"11",
            b"12",
            b"01",
        )
    if variant.model == "dzb100":
        return frame[:1] == b"C" and frame[6:7] in b"13"
    words: Any = frame if variant.encoding == "rtu" else bytes.fromhex(frame[1:-2].decode())
    command = words[1] == 6 and words[2:4] == b"\x20\x00"
    return bool(command and (words[5] & 1 if variant.model == "vc660" else words[5] & 3 == 2))


@pytest.mark.parametrize("seed", [1, 2, 18])
@every_family
def test_the_invariants_hold_for_three_minutes_on_a_bad_line(variant: SystemVariant, seed: int) -> None:
    async def scenario() -> None:
        rng = random.Random(seed)
        async with system_bench(variant, "1-4", "clean", seed=seed) as bench:
            user, observer = RandomUser(bench, rng), MotorObserver(bench)
            monitors = {address: drive.monitor() for address, drive in bench.drives.items()}
            for step in range(MINUTES * 120):
                await asyncio.sleep(0.5)
                if step % 4 == 0:
                    user.command()
                if step % 10 == 0:
                    disturb(bench, rng)
                if step % 60 == 59:
                    bench.simulated_bus.replug()
                observer.observe()
                for address, monitor in monitors.items():
                    observer.check(address, monitor)
            bench.simulated_bus.replug()
            bench.simulated_bus.line_quality = "clean"
            for station in bench.simulated_bus.stations:
                station.faults.silent = station.faults.mute = False
                station.motor.reset()
            await asyncio.sleep(130.0)
            assert not user.tasks, "every command has ended"
            check_motion_frames(bench, user)
            for address in bench.drives:
                assert bench.station(address).motor.starts <= user.runs[address], "I2"
            bench.tap.check(variant)
            for monitor in monitors.values():
                monitor.close()
            for drive in bench.drives.values():
                assert (await drive.stop()).succeeded
            assert all(not bench.station(n).motor.energised for n in bench.drives) or not variant.reports_running

    run_virtual(scenario())
