"""Options that no manual defines, with simulated drives of every variant.

They are the coding of the DZB100 (T08) and the direction field of the DF800; before calibration no command may depend
on a guess.
"""

from __future__ import annotations

import asyncio

import pytest

from drivebus.drives import Direction, MemoryStore
from drivebus.errors import DriveError, LimitError, StartInhibited
from fixtures.system_bench import (
    DF800,
    DF800_ASCII,
    DZB100,
    SystemBench,
    SystemVariant,
    outcome_or_error,
    run_virtual,
    system_bench,
)

CODINGS = ("hex-0.1", "hex-0.01", "decimal-0.1", "hex-1")
CAP_HZ = 5.0
OPEN_OPTIONS = {"setpoint_coding": "unknown", "query_coding": "unknown", "parameter_coding": "unknown"}


class HighestSetpoint:
    """Highest frequency that any executed command has set."""

    def __init__(self, bench: SystemBench) -> None:
        self.hz = 0.0
        station, run_towards = bench.station(), bench.station().run_towards

        def record(frequency_hz: float) -> None:
            self.hz = max(self.hz, abs(frequency_hz))
            run_towards(frequency_hz)

        station.run_towards = record


@pytest.mark.parametrize("coding", CODINGS)
def test_before_its_coding_is_calibrated_no_dzb100_turns_faster_than_5_hz(coding: str) -> None:
    """A frequency that could mean more than 5 Hz in any coding is rejected before it is sent (T08)."""

    async def scenario() -> None:
        options = {"setpoint_coding": coding, "query_coding": coding, "parameter_coding": coding}
        async with system_bench(DZB100, drive_options=OPEN_OPTIONS, **options) as bench:
            highest = HighestSetpoint(bench)
            rejected = 0
            for hz in (0.1, 0.3, 0.5, 0.6, 1.0, 3.2, 5.0, 10.0, 50.0, 400.0):
                try:
                    await bench.drive.run(hz)
                except LimitError:
                    rejected += 1
                except DriveError:
                    pass
                for new_hz in (0.2, 0.4, 5.0, 50.0):
                    await outcome_or_error(bench.drive.set_frequency(new_hz))
                await asyncio.sleep(3.0)
                await outcome_or_error(bench.drive.stop())
                await asyncio.sleep(1.0)
            assert rejected == 7, "only 0.1, 0.3 and 0.5 Hz are at most 5 Hz in every coding"
            assert 0.0 < highest.hz <= CAP_HZ

    run_virtual(scenario())


@pytest.mark.parametrize("query", CODINGS)
@pytest.mark.parametrize("setpoint", CODINGS)
def test_calibration_finds_every_coding_below_5_hz_and_then_the_speed_is_right(setpoint: str, query: str) -> None:
    async def scenario() -> None:
        options = {"setpoint_coding": setpoint, "query_coding": query, "parameter_coding": "hex-0.1"}
        async with system_bench(DZB100, drive_options=OPEN_OPTIONS, **options) as bench:
            highest = HighestSetpoint(bench)
            with pytest.raises(StartInhibited):
                await bench.drive.calibrate("setpoint_coding")
            bench.station().setpoint_hz = 12.3
            found = await bench.drive.calibrate("query_coding", keypad_hz=12.3)
            assert found.options == {"query_coding": query}
            assert bench.motor.starts == 0, "this calibration moves nothing"
            try:
                calibration = await bench.drive.calibrate("setpoint_coding")
            except DriveError:
                calibration = None
            assert highest.hz <= CAP_HZ and not bench.motor.energised
            if calibration is None or not calibration.options:
                assert query == "hex-1" or (setpoint == "hex-0.01" and query != "hex-0.01"), "the query is too coarse"
                with pytest.raises(LimitError):
                    await bench.drive.run(20.0)
                return
            assert calibration.options == {"setpoint_coding": setpoint}
            assert (await bench.drive.run(20.0)).status == "confirmed"
            await asyncio.sleep(3.0)
            assert bench.motor.output_hz == pytest.approx(20.0, abs=0.51 if setpoint == "hex-1" else 0.06)
            await bench.drive.stop()

    run_virtual(scenario())


def test_a_calibrated_coding_is_stored_for_that_drive_only() -> None:
    async def scenario() -> None:
        async with system_bench(DZB100, "1-2", drive_options=OPEN_OPTIONS) as bench:
            bench.station(1).setpoint_hz = 12.3
            await bench.drives[1].calibrate("query_coding")
            await bench.drives[1].calibrate("setpoint_coding")
            assert (await bench.drives[1].run(20.0)).status == "confirmed"
            with pytest.raises(LimitError):
                await bench.drives[2].run(20.0)

    run_virtual(scenario())


FIELDS = ("b3b2", "b2b3")


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("variant", [DF800, DF800_ASCII], ids=lambda variant: variant.name)
def test_a_df800_turns_in_the_requested_direction_after_calibration_by_an_observed_jog(
    variant: SystemVariant, field: str
) -> None:
    async def scenario() -> None:
        open_field = {"direction_calibrated": False}
        async with system_bench(variant, drive_options=open_field, direction_field=field) as bench:
            for direction in Direction:
                with pytest.raises(StartInhibited):
                    await bench.drive.run(10.0, direction)
                with pytest.raises(StartInhibited):
                    async with bench.drive.jog(None, direction):
                        pass
            assert bench.motor.starts == 0
            turned: list[float] = []

            async def observe() -> Direction | None:
                return Direction.FORWARD if turned[0] > 0 else Direction.REVERSE

            station = bench.station()
            run_towards = station.run_towards

            def record(hz: float) -> None:
                run_towards(hz)
                turned.append(bench.motor.target_hz)

            station.run_towards = record
            found = await bench.drive.calibrate("direction", observe)
            assert found.outcome is not None and found.outcome.succeeded and bench.motor.starts == 1
            assert max(abs(hz) for hz in turned) <= 5.0
            await asyncio.sleep(3.0)
            assert not bench.motor.energised, "half a second of jog and no more"
            for direction, sign in ((Direction.FORWARD, 1), (Direction.REVERSE, -1)):
                await bench.drive.run(10.0, direction)
                await asyncio.sleep(2.0)
                assert bench.motor.output_hz == pytest.approx(sign * 10.0)
                await bench.drive.stop()
                await asyncio.sleep(2.0)
                assert not bench.motor.energised

    run_virtual(scenario())


@pytest.mark.parametrize("field", FIELDS)
def test_a_run_without_a_direction_never_touches_the_field(field: str) -> None:
    """A drive set to reverse at its keypad keeps reverse, and the toggle is never sent (T16)."""

    async def scenario() -> None:
        async with system_bench(DF800, drive_options={"direction_calibrated": False}, direction_field=field) as bench:
            bench.station().reverse = True
            for _ in range(3):
                assert (await bench.drive.run(10.0)).status == "acknowledged"
                await asyncio.sleep(2.0)
                assert bench.motor.output_hz == pytest.approx(-10.0)
                await bench.drive.stop()
                await asyncio.sleep(2.0)
            commands = [frame.data[5] for frame in bench.tap.requests_sent if frame.data[1:4] == b"\x06\x20\x00"]
            assert commands and all(word & 0b1100 == 0 for word in commands)

    run_virtual(scenario())


def test_a_calibration_without_an_observer_changes_nothing() -> None:
    async def scenario() -> None:
        store = MemoryStore()
        async with system_bench(DF800, drive_options={"direction_calibrated": False}) as bench:

            async def no_observer() -> Direction | None:
                return None

            await bench.drive.calibrate("direction", no_observer)
            with pytest.raises(StartInhibited):
                await bench.drive.run(10.0, Direction.FORWARD)
            assert store.get("anything") is None

    run_virtual(scenario())
