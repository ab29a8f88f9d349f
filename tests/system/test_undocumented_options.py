"""Questions that no manual settles, against pretend drives of every answer: the DZB100's coding (T08) and the DF800's
direction field. Until a proof was made nothing may depend on the guess."""

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
    command_ending,
    run_virtual,
    system_bench,
)

CODINGS = ("hex-0.1", "hex-0.01", "decimal-0.1", "hex-1")
CAP_HZ = 5.0
OPEN_OPTIONS = {"setpoint_coding": "unknown", "query_coding": "unknown", "parameter_coding": "unknown"}


class HighestSetpoint:
    """The fastest that the motor was ever told to go, looked at on every command that the drive took."""

    def __init__(self, here: SystemBench) -> None:
        self.hz = 0.0
        station, direct = here.station(), here.station().run_towards

        def seen(frequency_hz: float) -> None:
            self.hz = max(self.hz, abs(frequency_hz))
            direct(frequency_hz)

        station.run_towards = seen


@pytest.mark.parametrize("coding", CODINGS)
def test_before_its_coding_is_calibrated_no_dzb100_turns_faster_than_5_hz(coding: str) -> None:
    """T08: whatever is asked for, of a drive of any coding; what could mean more is refused before it is sent."""

    async def scenario() -> None:
        options = {"setpoint_coding": coding, "query_coding": coding, "parameter_coding": coding}
        async with system_bench(DZB100, drive_options=OPEN_OPTIONS, **options) as here:
            highest = HighestSetpoint(here)
            refused = 0
            for hz in (0.1, 0.3, 0.5, 0.6, 1.0, 3.2, 5.0, 10.0, 50.0, 400.0):
                try:
                    await here.drive.run(hz)
                except LimitError:
                    refused += 1
                except DriveError:
                    pass
                for again in (0.2, 0.4, 5.0, 50.0):
                    await command_ending(here.drive.set_frequency(again))
                await asyncio.sleep(3.0)
                await command_ending(here.drive.stop())
                await asyncio.sleep(1.0)
            assert refused == 7, "only 0.1, 0.3 and 0.5 Hz are at most 5 Hz in every coding"
            assert 0.0 < highest.hz <= CAP_HZ

    run_virtual(scenario())


@pytest.mark.parametrize("query", CODINGS)
@pytest.mark.parametrize("setpoint", CODINGS)
def test_calibration_finds_every_coding_below_5_hz_and_then_the_speed_is_right(setpoint: str, query: str) -> None:
    async def scenario() -> None:
        options = {"setpoint_coding": setpoint, "query_coding": query, "parameter_coding": "hex-0.1"}
        async with system_bench(DZB100, drive_options=OPEN_OPTIONS, **options) as here:
            highest = HighestSetpoint(here)
            with pytest.raises(StartInhibited):
                await here.drive.calibrate("setpoint_coding")
            here.station().setpoint_hz = 12.3
            found = await here.drive.calibrate("query_coding", keypad_hz=12.3)
            assert found.options == {"query_coding": query}
            assert here.motor.starts == 0, "this proof moves nothing"
            try:
                proof = await here.drive.calibrate("setpoint_coding")
            except DriveError:
                proof = None
            assert highest.hz <= CAP_HZ and not here.motor.energised
            if proof is None or not proof.options:
                assert query == "hex-1" or (setpoint == "hex-0.01" and query != "hex-0.01"), "the query is too coarse"
                with pytest.raises(LimitError):
                    await here.drive.run(20.0)
                return
            assert proof.options == {"setpoint_coding": setpoint}
            assert (await here.drive.run(20.0)).status == "confirmed"
            await asyncio.sleep(3.0)
            assert here.motor.output_hz == pytest.approx(20.0, abs=0.51 if setpoint == "hex-1" else 0.06)
            await here.drive.stop()

    run_virtual(scenario())


def test_a_calibrated_coding_is_stored_for_that_drive_only() -> None:
    async def scenario() -> None:
        async with system_bench(DZB100, "1-2", drive_options=OPEN_OPTIONS) as here:
            here.station(1).setpoint_hz = 12.3
            await here.drives[1].calibrate("query_coding")
            await here.drives[1].calibrate("setpoint_coding")
            assert (await here.drives[1].run(20.0)).status == "confirmed"
            with pytest.raises(LimitError):
                await here.drives[2].run(20.0)

    run_virtual(scenario())


FIELDS = ("b3b2", "b2b3")


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("kind", [DF800, DF800_ASCII], ids=lambda kind: kind.name)
def test_a_df800_turns_in_the_requested_direction_after_calibration_by_an_observed_jog(
    kind: SystemVariant, field: str
) -> None:
    async def scenario() -> None:
        open_field = {"direction_calibrated": False}
        async with system_bench(kind, drive_options=open_field, direction_field=field) as here:
            for direction in Direction:
                with pytest.raises(StartInhibited):
                    await here.drive.run(10.0, direction)
                with pytest.raises(StartInhibited):
                    async with here.drive.jog(None, direction):
                        pass
            assert here.motor.starts == 0
            turned: list[float] = []

            async def watched() -> Direction | None:
                return Direction.FORWARD if turned[0] > 0 else Direction.REVERSE

            station = here.station()
            direct = station.run_towards

            def seen(hz: float) -> None:
                direct(hz)
                turned.append(here.motor.target_hz)

            station.run_towards = seen
            found = await here.drive.calibrate("direction", watched)
            assert found.outcome is not None and found.outcome.succeeded and here.motor.starts == 1
            assert max(abs(hz) for hz in turned) <= 5.0
            await asyncio.sleep(3.0)
            assert not here.motor.energised, "half a second of jog and no more"
            for direction, sign in ((Direction.FORWARD, 1), (Direction.REVERSE, -1)):
                await here.drive.run(10.0, direction)
                await asyncio.sleep(2.0)
                assert here.motor.output_hz == pytest.approx(sign * 10.0)
                await here.drive.stop()
                await asyncio.sleep(2.0)
                assert not here.motor.energised

    run_virtual(scenario())


@pytest.mark.parametrize("field", FIELDS)
def test_a_run_without_a_direction_never_touches_the_field(field: str) -> None:
    """T16: a drive set to reverse at its keypad goes on in reverse; the toggle is never sent."""

    async def scenario() -> None:
        async with system_bench(DF800, drive_options={"direction_calibrated": False}, direction_field=field) as here:
            here.station().reverse = True
            for _ in range(3):
                assert (await here.drive.run(10.0)).status == "acknowledged"
                await asyncio.sleep(2.0)
                assert here.motor.output_hz == pytest.approx(-10.0)
                await here.drive.stop()
                await asyncio.sleep(2.0)
            commands = [one.data[5] for one in here.tap.requests_sent if one.data[1:4] == b"\x06\x20\x00"]
            assert commands and all(word & 0b1100 == 0 for word in commands)

    run_virtual(scenario())


def test_a_calibration_without_an_observer_changes_nothing() -> None:
    async def scenario() -> None:
        store = MemoryStore()
        async with system_bench(DF800, drive_options={"direction_calibrated": False}) as here:

            async def away() -> Direction | None:
                return None

            await here.drive.calibrate("direction", away)
            with pytest.raises(StartInhibited):
                await here.drive.run(10.0, Direction.FORWARD)
            assert store.get("anything") is None

    run_virtual(scenario())
