"""Drive that runs faster than asked after a start, as with a wrong factor of its setpoint: it is stopped."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.commissioning.profile_simulator import ProfileStation
from drivebus.drives.drive import Drive
from drivebus.drives.outcome import OutcomeStatus
from drivebus.errors import TargetNotReached
from drivebus.profiles.model import DriveProfile
from drivebus.simulator.bus import SimulatedBus
from drivebus.simulator.port import SimPort
from drivebus.testing.virtual_time import run
from drivebus.values import Scale
from fixtures.system_bench import wait_until

RIGHT = profiles.load("gd200")
TEN_TIMES = replace(
    RIGHT,
    setpoint_scale=Scale(0.001, decimals=2),
    signals={name: signal for name, signal in RIGHT.signals.items() if name != "set_frequency"},  # a read-back shows it
)


class ShownStation(ProfileStation):
    """Simulated drive that can show another output frequency than it has, and record the highest that it had."""

    show: Callable[[], float] | None = None
    highest_hz = 0.0

    def elapse(self, dt: float) -> None:
        super().elapse(dt)
        self.highest_hz = max(self.highest_hz, self.motor.output_hz)

    def _signal_word(self, signal: Any) -> int:
        if self.show is None or signal.name != "output_frequency" or not self.motor.energised:
            return super()._signal_word(signal)
        return round(self.show() * 100)


def bus_of(stations: list[ShownStation]) -> Bus:
    simulated = SimulatedBus(stations, line_quality="clean", seed=7)
    port: Any = SimPort(simulated, simulated.settings, "sim://overspeed", "off")
    return Bus(port)


@asynccontextmanager
async def bench(profile: DriveProfile) -> AsyncIterator[tuple[Drive, ShownStation]]:
    """Yield the drive of this profile on a simulated drive of the right one, with ramps of 4 s to 50 Hz."""
    station = ShownStation(1, profile=RIGHT)
    station.set_ramps(4.0, 4.0)
    async with bus_of([station]) as bus:
        yield Drive(bus, profile, 1), station


def test_a_drive_that_counts_its_setpoint_ten_times_as_fast_is_stopped_and_the_sentence_says_why() -> None:
    async def scenario() -> None:
        async with bench(TEN_TIMES) as (drive, station):
            with pytest.raises(TargetNotReached) as caught:
                await drive.run(5.0, wait=True)
            error = caught.value
            assert error.key == "drives.overspeed" and error.outcome.status is OutcomeStatus.FAILED
            assert str(error).startswith("the drive runs faster than asked: ") and str(error).endswith(
                "reports stopped"
            )
            assert error.params["expected_hz"] == 5.0 and error.params["found_hz"] > 8.0
            assert not station.motor.energised and 8.0 < station.highest_hz < 20.0

    run(scenario())


def test_an_overspeed_is_stopped_within_8_s_while_eight_drives_of_the_bus_ramp_down() -> None:
    """Reads of stops that always go first delay the detection to 39 s."""

    async def scenario() -> float:
        stations = [ShownStation(address, profile=RIGHT) for address in range(1, 10)]
        for station in stations:
            station.set_ramps(4.0, 20.0)
        async with bus_of(stations) as bus:
            *others, started = [Drive(bus, RIGHT, a) for a in range(1, 9)] + [Drive(bus, TEN_TIMES, 9)]
            await asyncio.gather(*(drive.run(45.0, wait=True) for drive in others))
            start = asyncio.ensure_future(started.run(5.0, wait=True))
            await wait_until(lambda: stations[-1].motor.energised, 0.01)
            began = bus.now()
            stops = [asyncio.ensure_future(drive.stop()) for drive in others]
            with pytest.raises(TargetNotReached):
                await start
            took_s = bus.now() - began
            assert {outcome.key for outcome in await asyncio.gather(*stops)} == {"drives.stop_confirmed"}
            return took_s

    assert run(scenario()) < 8.0  # 4.6 s alone on the bus


def test_a_stop_that_the_drive_ignores_leaves_the_outcome_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    execute = ShownStation._execute
    stop_word = RIGHT.commands.values["stop"] if RIGHT.commands else 0
    monkeypatch.setattr(ShownStation, "_execute", lambda self, word: 0 if word == stop_word else execute(self, word))

    async def scenario() -> None:
        async with bench(TEN_TIMES) as (drive, station):
            with pytest.raises(TargetNotReached) as caught:
                await drive.run(5.0, wait=True)
            assert caught.value.key == "drives.overspeed"
            assert caught.value.outcome.status is OutcomeStatus.UNKNOWN and station.motor.energised

    run(scenario())


@pytest.mark.parametrize(
    ("asked_hz", "shown_hz", "is_stopped"),
    [(5.0, 8.0, False), (5.0, 8.02, True), (40.0, 48.0, False), (40.0, 48.02, True)],
)
def test_three_hertz_and_a_fifth_are_tolerated(asked_hz: float, shown_hz: float, is_stopped: bool) -> None:
    """Slip compensation, and a lowest frequency that the drive keeps."""

    async def scenario() -> None:
        async with bench(RIGHT) as (drive, station):
            station.show = lambda: shown_hz
            with pytest.raises(TargetNotReached) as caught:
                await drive.run(asked_hz, wait=True, timeout_s=3.0)
            assert (caught.value.key == "drives.overspeed") is is_stopped
            assert station.motor.energised is not is_stopped

    run(scenario())


def test_a_frequency_that_falls_to_the_set_one_is_overshoot_or_a_motor_that_was_caught() -> None:
    async def scenario() -> None:
        async with bench(RIGHT) as (drive, station):
            begun = asyncio.get_running_loop().time()
            station.show = lambda: max(10.0, 30.0 - 5.0 * (asyncio.get_running_loop().time() - begun))
            assert (await drive.run(10.0, wait=True)).status is OutcomeStatus.CONFIRMED
            assert station.motor.energised

    run(scenario())


def test_a_lower_frequency_of_a_running_drive_is_no_overspeed() -> None:
    async def scenario() -> None:
        async with bench(RIGHT) as (drive, station):
            await drive.run(40.0, wait=True)
            station.show = lambda: 40.0
            with pytest.raises(TargetNotReached) as caught:
                await drive.run(5.0, wait=True, timeout_s=3.0)
            assert caught.value.key == "drives.not_reached" and station.motor.energised

    run(scenario())


def test_a_frequency_of_uncertain_scale_stops_nothing() -> None:
    signals = dict(RIGHT.signals)
    signals["output_frequency"] = replace(signals["output_frequency"], uncertain="drives.scale_unknown")
    uncertain = replace(RIGHT, signals=signals)

    async def scenario() -> None:
        async with bench(uncertain) as (drive, station):
            station.show = lambda: 50.0
            with pytest.raises(TargetNotReached) as caught:
                await drive.run(5.0, wait=True, timeout_s=3.0)
            assert caught.value.key == "drives.not_reached" and station.motor.energised

    run(scenario())
