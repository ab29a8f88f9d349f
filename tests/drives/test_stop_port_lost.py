"""Stop through a port that is lost: never called sent where no frame could leave."""

from __future__ import annotations

import asyncio

import pytest

from drivebus.bus import Bus
from drivebus.drives import Drive
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.errors import StopUnconfirmed
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.motor import Motor
from drivebus.simulator.port import SimulatedBus, simulated_bus_of
from drivebus.testing.bus_script import ScriptedPort, silent_wire
from fixtures.drives import SAFE_HZ, SimulatedDrives, run_virtual

MODELS = ("c320", "vc660", "dzb100", "df800")


async def unconfirmed_stop(drive: Drive, wait: bool = True) -> Outcome:
    with pytest.raises(StopUnconfirmed) as caught:
        await drive.stop(wait=wait)
    outcome: Outcome = caught.value.outcome
    assert outcome.status is OutcomeStatus.UNKNOWN
    return outcome


def line_of(bench: SimulatedDrives) -> SimulatedBus:
    return simulated_bus_of(bench.port)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("wait", [True, False])
def test_a_stop_that_no_open_port_took_is_not_called_sent(model: str, wait: bool) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            await drive.status()
            line_of(bench).unplug()
            await asyncio.sleep(6)
            outcome = await unconfirmed_stop(drive, wait)
            assert (outcome.key, outcome.exchanges) == ("drives.stop_not_sent_port", ())
            name = f"sim://{model}@1"
            assert f"STOP NOT SENT: the port is not open ({name} was unplugged)" in outcome.text("en")
            assert f"停机命令未发送：端口未打开（{name} " in outcome.text("zh")

    run_virtual(scenario())


def test_a_stop_on_a_bus_that_was_never_opened_does_not_call_the_port_lost() -> None:
    async def scenario() -> None:
        drive = Drive(Bus(ScriptedPort(silent_wire)), "c320", 1)
        outcome = await unconfirmed_stop(drive)
        assert outcome.key == "drives.stop_not_sent_port"
        assert outcome.text("en").startswith("STOP NOT SENT: the port is not open (the bus is not open)")

    run_virtual(scenario())


@pytest.mark.parametrize("model", ["c320", "vc660"])
def test_a_port_lost_during_a_stop_is_named_with_the_stops_before_and_the_last_report(
    model: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            await drive.run(SAFE_HZ[model], wait=True)
            monkeypatch.setattr(Motor, "stop", lambda *given: None)
            asyncio.get_running_loop().call_later(0.7, line_of(bench).unplug)
            outcome = await unconfirmed_stop(drive)
            assert outcome.key == "drives.stop_port_lost_after" and outcome.params["sent"] > 1
            assert "before that the drive reported running" in outcome.text("en")
            monkeypatch.undo()

    run_virtual(scenario())


def test_a_port_lost_at_the_first_frame_of_a_stop_leaves_open_whether_it_reached_the_drive() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("c320") as bench:
            drive = bench.drive()
            await drive.status()
            asyncio.get_running_loop().call_later(0.005, line_of(bench).unplug)
            outcome = await unconfirmed_stop(drive)
            assert (outcome.key, outcome.params["sent"]) == ("drives.stop_port_lost", 1)
            assert "whether one reached the drive is not known" in outcome.text("en")

    run_virtual(scenario())


def test_a_port_that_returns_during_a_stop_lets_it_be_sent_and_confirmed() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("c320") as bench:
            drive = bench.drive()
            await drive.run(SAFE_HZ["c320"], wait=True)
            line_of(bench).unplug()
            await asyncio.sleep(1)
            asyncio.get_running_loop().call_later(1.0, line_of(bench).replug)
            assert (await drive.stop()).status is OutcomeStatus.CONFIRMED

    run_virtual(scenario())


def test_a_stop_whose_turn_on_the_bus_does_not_come_in_its_time_is_not_called_sent() -> None:
    """Many silent stations are stopped at once: the last of them waits for the replies of the others."""

    async def scenario() -> None:
        bus = Bus(ScriptedPort(silent_wire, SerialSettings(1200, 8, "E", 1)))
        async with bus:
            drives = [Drive(bus, "c320", address) for address in range(1, 31)]
            outcomes = await asyncio.gather(*(unconfirmed_stop(drive) for drive in drives))
            keys = {outcome.key for outcome in outcomes}
            assert keys == {"drives.stop_no_reply", "drives.stop_not_completed"}
            for outcome in outcomes:
                assert bool(outcome.exchanges) is (outcome.key == "drives.stop_no_reply")

    run_virtual(scenario())
