"""Port that is lost during a stop, a start, a write or a status: nothing is called sent, or known, that is not."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from drivebus.bus import Bus
from drivebus.drives import Drive
from drivebus.drives.outcome import Outcome, OutcomeStatus
from drivebus.errors import OutcomeUnknown, PortLost, StartInhibited, StopUnconfirmed, Superseded
from drivebus.protocols.sunfar import SunfarWriteParameter
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.motor import Motor, OutputPhase
from drivebus.simulator.port import SimulatedBus, simulated_bus_of
from drivebus.testing.bus_script import ScriptedPort, silent_wire
from fixtures.drives import SAFE_HZ, SimulatedDrives, run_virtual

MODELS = ("c320", "vc660", "dzb100", "df800")
JOG_HZ = {"c320": 5.0, "vc660": None}


async def unconfirmed_stop(drive: Drive, wait: bool = True) -> Outcome:
    with pytest.raises(StopUnconfirmed) as caught:
        await drive.stop(wait=wait)
    outcome: Outcome = caught.value.outcome
    assert outcome.status is OutcomeStatus.UNKNOWN
    return outcome


def line_of(bench: SimulatedDrives) -> SimulatedBus:
    return simulated_bus_of(bench.port)


def lose_the_port_at_motion(bench: SimulatedDrives, monkeypatch: pytest.MonkeyPatch) -> None:
    """Unplug the port when a drive executes a start or jog, before its reply."""
    start = Motor.run

    def start_and_unplug(motor: Motor, target_hz: float) -> None:
        start(motor, target_hz)
        line_of(bench).unplug()

    monkeypatch.setattr(Motor, "run", start_and_unplug)


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


@pytest.mark.parametrize("model", ["c320", "vc660"])
def test_a_port_lost_before_the_start_frame_reports_that_no_start_was_sent(model: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            await drive.status()
            asyncio.get_running_loop().call_later(0.02, line_of(bench).unplug)
            with pytest.raises(PortLost) as caught:
                await drive.run(SAFE_HZ[model])
            assert caught.value.key == "drives.start_not_sent_port"
            assert str(caught.value) == f"no start was sent: sim://{model}@1 was unplugged"
            assert bench.station().motor.phase is OutputPhase.OFF

    run_virtual(scenario())


@pytest.mark.parametrize("model", ["c320", "vc660"])
def test_a_port_lost_at_the_start_frame_is_not_called_a_newer_stop(model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            lose_the_port_at_motion(bench, monkeypatch)
            with pytest.raises(Superseded) as caught:
                await drive.run(SAFE_HZ[model])
            assert caught.value.key == "drives.command_port_lost"
            assert "it is unknown whether the drive executed it" in str(caught.value)
            assert caught.value.outcome.status is OutcomeStatus.UNKNOWN

    run_virtual(scenario())


@pytest.mark.parametrize("model", ["c320", "vc660"])
def test_a_jog_whose_port_is_lost_at_its_frame_is_not_called_stopped(
    model: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was called *unknown; a stop was sent*: none had left."""

    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            lose_the_port_at_motion(bench, monkeypatch)
            with pytest.raises(OutcomeUnknown) as caught:
                await bench.drive().jog(JOG_HZ[model]).start()
            assert caught.value.key == "drives.jog_unknown"
            assert "Its stop: STOP NOT SENT: the port is not open" in str(caught.value)
            assert "随后的停机：停机命令未发送" in caught.value.outcome.text("zh")

    run_virtual(scenario())


@pytest.mark.parametrize("model", ["c320", "vc660"])
def test_a_jog_is_not_renewed_while_its_port_is_lost(model: str) -> None:
    """A held key kept a motor turning that no stop could reach, without a word, and went on when the port was back."""

    async def scenario() -> None:
        async with SimulatedDrives(model) as bench:
            jog = bench.drive().jog(JOG_HZ[model])
            await jog.start()
            await asyncio.sleep(0.2)
            jog.renew()
            line_of(bench).unplug()
            with pytest.raises(StartInhibited) as caught:
                jog.renew()
            assert caught.value.key == "drives.jog_port_lost"
            await asyncio.sleep(1.0)
            line_of(bench).replug()
            await asyncio.sleep(10.0)
            assert bench.station().motor.phase is OutputPhase.OFF

    run_virtual(scenario())


def test_a_port_lost_after_a_write_is_its_reason_and_the_writes_after_it_are_named() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("c320") as bench:
            drive = bench.drive()
            await drive.status()
            write = bench.bus.transact

            async def lose_the_port_after_a_write(request: Any) -> Any:
                result = await write(request)
                if isinstance(request.request, SunfarWriteParameter):
                    line_of(bench).unplug()
                return result

            bench.bus.transact = lose_the_port_after_a_write
            with pytest.raises(OutcomeUnknown) as caught:
                await drive.write({"F1.10": 1, "F9.4": 5})
            assert caught.value.key == "drives.write_port_lost"
            assert "was given to the port, and the port was lost" in str(caught.value)
            assert [key for key, _ in caught.value.outcome.notes] == ["drives.write_unsent"]

    run_virtual(scenario())


def test_a_status_whose_port_is_lost_in_the_middle_is_an_error_and_no_state() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("c320") as bench:
            drive = bench.drive()
            await drive.status()
            asyncio.get_running_loop().call_later(0.3, line_of(bench).unplug)
            with pytest.raises(PortLost):
                await drive.status()

    run_virtual(scenario())
