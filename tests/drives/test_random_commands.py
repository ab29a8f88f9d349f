"""Random commands, trips and keypad actions on bad buses: no outcome of a drive is wrong."""

from __future__ import annotations

import asyncio
import contextlib
import random
from typing import Any

import pytest

from drivebus.drives import Drive, DriveState
from drivebus.errors import DrivebusError
from drivebus.simulator.motor import Trip
from fixtures.drives import MODELS, SAFE_HZ, SimulatedDrives, run_virtual

WEATHERS = ("clean", "loss=0.1", "late=0.1:0.4", "late=0.3:0.5", "loss=0.05,flip=0.002", "loss=0.3")
ACTS = ("run", "run", "stop", "setpoint", "status", "keypad_stop", "trip", "reset", "jog")


def record_commands(bench: SimulatedDrives) -> list[float]:
    """Return a list that records every frequency other than 0 commanded to the motor from now on."""
    motor = bench.station().motor
    found: list[float] = []

    class Watched(type(motor)):  # type: ignore[misc]
        __slots__ = ()

        def run(self, target_hz: float) -> None:
            if target_hz:
                found.append(target_hz)
            super().run(target_hz)

    motor.__class__ = Watched
    return found


class Hammer:
    """Twelve random acts on a drive with a seed; each compares its outcome with the drive itself."""

    def __init__(self, model: str, weather: str, seed: int) -> None:
        self.model, self.hz = model, SAFE_HZ[model]
        self.bench = SimulatedDrives(model, query=f"line_quality={weather}&seed={seed}&ramp=2")
        self.rng = random.Random(seed)
        self.done = 0
        """Number of starts and stops reported as done."""

    async def __call__(self) -> None:
        async with self.bench as bench:
            drive = bench.drive()
            for _ in range(12):
                await getattr(self, self.rng.choice(ACTS))(drive)

    @property
    def running(self) -> bool:
        return bool(self.bench.station().running)

    async def run(self, drive: Drive) -> None:
        stood, starts = not self.running, record_commands(self.bench)
        try:
            outcome = await drive.run(self.hz)
        except DrivebusError as error:
            if error.outcome is None and stood:
                assert not starts, error
            return
        finally:
            if stood:
                assert len(starts) <= 1
        self.done += outcome.succeeded
        if outcome.status == "confirmed":
            assert self.running

    async def stop(self, drive: Drive) -> None:
        try:
            outcome = await drive.stop()
        except DrivebusError as error:
            assert error.outcome.status == "unknown"
        else:
            self.done += 1
            assert outcome.status != "confirmed" or not self.running

    async def setpoint(self, drive: Drive) -> None:
        stood = not self.running
        await self._tried(drive.set_frequency(self.hz / 2))
        assert not (stood and self.running)

    async def status(self, drive: Drive) -> None:
        before = self.running
        try:
            status = await drive.status()
        except DrivebusError:
            return
        if status.state is DriveState.STOPPED:
            assert not (before and self.running)

    async def reset(self, drive: Drive) -> None:
        stood = not self.running
        await self._tried(drive.reset_fault())
        assert not (stood and self.running)

    async def jog(self, drive: Drive) -> None:
        hz = self.hz if self.model in ("c320", "dzb100") else None
        try:
            async with drive.jog(hz) as lease:
                await asyncio.sleep(0.3)
        except DrivebusError:
            return
        assert lease.stop_outcome is not None
        assert lease.stop_outcome.status != "confirmed" or not self.running

    async def keypad_stop(self, drive: Drive) -> None:
        self.bench.station().keypad_stop()
        await asyncio.sleep(3)

    async def trip(self, drive: Drive) -> None:
        self.bench.station().trip(Trip.OVERVOLTAGE)

    async def _tried(self, command: Any) -> None:
        with contextlib.suppress(DrivebusError):
            await command


@pytest.mark.parametrize("weather", WEATHERS)
@pytest.mark.parametrize("model", MODELS)
def test_no_outcome_of_a_drive_is_wrong(model: str, weather: str) -> None:
    hammers = [Hammer(model, weather, seed) for seed in range(8)]
    for hammer in hammers:
        run_virtual(hammer())
    assert any(hammer.done for hammer in hammers) or weather == "loss=0.3", "else nothing could be wrong"
