"""A pretend C320 in each reading of what its manual leaves open, read by the host with and without the setting."""

from __future__ import annotations

import asyncio
import contextlib

import pytest

from drivebus import Bus, Drive
from drivebus.drives.dialects.base import Identity
from drivebus.errors import NoReply, ProtocolError
from drivebus.ports import open_port
from drivebus.protocols import sunfar
from drivebus.simulator.models import c320
from drivebus.simulator.motor import Trip
from drivebus.testing.virtual_time import run as story
from fixtures.simulator import SimulatorClient


def test_the_spelling_is_the_one_that_the_manual_prints() -> None:
    """The ten as 3AH, and the equals sign in the sum."""
    plain = sunfar.SunfarCodec().encode_reply(
        sunfar.SunfarReply(5, sunfar.SunfarResponse.OK, sunfar.SunfarState.STOPPED, 1, 0x0A, 0x0016)
    )
    odd = c320.tolerant_digits(plain)
    assert b"A" in plain[1:-5] and b":" in odd[1:-5] and b"A" not in odd[1:-5]
    assert len(odd) == len(plain)


@pytest.mark.parametrize("encoding", ["ascii", "hex"])
@pytest.mark.parametrize("digits", ["strict", "tolerant"])
@pytest.mark.parametrize("nibble", [False, True])
def test_a_drive_of_any_spelling_runs_where_the_host_was_told(encoding: str, digits: str, nibble: bool) -> None:
    async def scenario() -> None:
        port = open_port(f"sim://c320@1?ramp=1&digits={digits}&nibble={'on' if nibble else 'off'}")
        async with Bus(port) as bus:
            drive = Drive(bus, "c320", 1, encoding=encoding, settings={"digits": digits, "nibble": nibble})
            assert (await drive.run(30.0, wait=True)).status == "confirmed"
            status = await drive.status()
            assert status.state == "running"
            assert status.readings["output_frequency"].value == pytest.approx(30.0, abs=0.05)
            assert (await drive.write({"F1.10": 0x0ABC})).status == "confirmed"
            assert (await drive.read(["F1.10"]))["F1.10"].value == 0x0ABC
            assert (await drive.stop()).status == "confirmed"

    story(scenario())


@pytest.mark.parametrize(("encoding", "odd"), [("ascii", "digits=tolerant"), ("hex", "nibble=on")])
def test_the_strict_host_publishes_nothing_of_the_other_spelling(encoding: str, odd: str) -> None:
    async def scenario() -> None:
        port = open_port(f"sim://c320@1?{odd}")
        async with Bus(port) as bus:
            drive = Drive(bus, "c320", 1, encoding=encoding)
            port.simulated_bus.station(1).keypad_set(0x010A, 0x0ABC)  # type: ignore[attr-defined]
            with contextlib.suppress(ProtocolError, NoReply):
                assert (await drive.read(["F1.10"]))["F1.10"].value is None
            assert set(bus.statistics().errors) & {"AlphabetError", "ChecksumError"}

    story(scenario())


@pytest.mark.parametrize(("watchdog", "runs"), [("own", False), ("all", True)])
def test_frames_for_others_feed_the_comm_loss_timer_of_one_reading_only(watchdog: str, runs: bool) -> None:
    async def scenario() -> None:
        async with SimulatorClient(f"sim://c320@1,2?watchdog={watchdog}") as desk:
            await desk.request(sunfar.SunfarWriteParameter(2, 9, 4, 20))
            await desk.request(sunfar.SunfarControl(2, sunfar.SunfarOperation.RUN_FORWARD_AT, 3000))
            for _ in range(12):
                await desk.request(sunfar.ReadMonitor(1, 0), 1.0)
            assert desk.station(2).running is runs
            await asyncio.sleep(20.0)
            assert not desk.station(2).running

    story(scenario())


async def identified(link: str, encoding: str) -> tuple[Identity, Identity, int | None, int]:
    """Who a drive in a fault says that it is, then without the fault; the fault that is believed, and the true one."""
    port = open_port(link)
    async with Bus(port) as bus:
        station = port.simulated_bus.station(1)  # type: ignore[attr-defined]
        drive = Drive(bus, "c320", 1, encoding=encoding)
        station.trip(Trip.OVERHEAT)
        faulty = await drive.identify()
        fault = (await drive.status()).fault
        station.motor.reset()
        return faulty, await drive.identify(), fault and fault.code, station.trip_code(Trip.OVERHEAT)


@pytest.mark.parametrize("encoding", ["ascii", "hex"])
@pytest.mark.parametrize("reading", ["code", "information"])
def test_of_an_identity_in_a_fault_nothing_is_told_that_one_reading_makes_untrue(reading: str, encoding: str) -> None:
    """Digits 7-8 are the fault's code or the voltage class: neither is believed of them, what stands behind them is."""
    faulty, whole, code, true_code = story(identified(f"sim://c320@1?class0_fault={reading}", encoding))
    assert code == true_code
    assert (faulty.voltage_class_v, faulty.host_controls, faulty.host_sets_frequency) == (None, None, None)
    assert faulty.power_kw == whole.power_kw == 2.2
    assert (whole.voltage_class_v, whole.host_controls, whole.host_sets_frequency) == (380, True, True)
    assert [(part, "--" + digits[2:]) for part, digits in whole.digits] == list(faulty.digits)


@pytest.mark.parametrize("reading", ["code", "information"])
def test_the_two_readings_of_an_identity_in_a_fault_differ_on_the_wire(reading: str) -> None:
    async def scenario() -> None:
        async with SimulatorClient(f"sim://c320@1?class0_fault={reading}") as desk:
            desk.station().trip(Trip.OVERHEAT)
            frame = await desk.raw(desk.codec.encode_request(sunfar.ReadIdentity(1, 0)))
            code = b"%02X" % desk.station().trip_code(Trip.OVERHEAT)
            assert code != b"40"
            assert (frame[4:6], frame[7:9]) == (b"20", code if reading == "code" else b"40")

    story(scenario())
