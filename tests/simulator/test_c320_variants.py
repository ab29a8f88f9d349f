"""Simulated C320 in each variant that its manual leaves open, read by a master with and without the setting."""

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
from drivebus.simulator.port import simulated_bus_of
from drivebus.testing.virtual_time import run
from fixtures.simulator import SimulatorClient


def test_each_encoding_is_the_one_in_the_manual() -> None:
    """The digit ten is 3AH, and the checksum is of the changed digits."""
    strict = sunfar.SunfarCodec().encode_reply(
        sunfar.SunfarReply(
            address=5,
            response=sunfar.SunfarResponse.OK,
            state=sunfar.SunfarState.STOPPED,
            group=1,
            item=0x0A,
            data=0x0016,
        )
    )
    tolerant = c320.tolerant_digits(strict)
    assert b"A" in strict[1:-5] and b":" in tolerant[1:-5] and b"A" not in tolerant[1:-5]
    assert len(tolerant) == len(strict)


@pytest.mark.parametrize("encoding", ["ascii", "hex"])
@pytest.mark.parametrize("digits", ["strict", "tolerant"])
@pytest.mark.parametrize("nibble", [False, True])
def test_a_drive_of_any_encoding_runs_at_the_frequency_of_the_configured_master(
    encoding: str, digits: str, nibble: bool
) -> None:
    async def scenario() -> None:
        port = open_port(f"sim://c320@1?ramp=1&digits={digits}&nibble={'on' if nibble else 'off'}")
        async with Bus(port) as bus:
            drive = Drive(bus, "c320", 1, encoding=encoding, options={"digits": digits, "nibble": nibble})
            assert (await drive.run(30.0, wait=True)).status == "confirmed"
            status = await drive.status()
            assert status.state == "running"
            assert status.readings["output_frequency"].value == pytest.approx(30.0, abs=0.05)
            assert (await drive.write({"F9.4": 0x0ABC})).status == "confirmed"
            assert (await drive.read(["F9.4"]))["F9.4"].value == 0x0ABC
            assert (await drive.stop()).status == "confirmed"

    run(scenario())


@pytest.mark.parametrize(("encoding", "variant"), [("ascii", "digits=tolerant"), ("hex", "nibble=on")])
def test_a_strict_master_publishes_nothing_of_the_other_encoding(encoding: str, variant: str) -> None:
    async def scenario() -> None:
        port = open_port(f"sim://c320@1?{variant}")
        async with Bus(port) as bus:
            drive = Drive(bus, "c320", 1, encoding=encoding)
            simulated_bus_of(port).station(1).keypad_set(0x0904, 0x0ABC)
            with contextlib.suppress(ProtocolError, NoReply):
                assert (await drive.read(["F9.4"]))["F9.4"].value is None
            assert set(bus.statistics().errors) & {"AlphabetError", "ChecksumError"}

    run(scenario())


@pytest.mark.parametrize(("watchdog", "runs"), [("own", False), ("all", True)])
def test_foreign_frames_restart_the_comm_loss_timer_in_one_variant_only(watchdog: str, runs: bool) -> None:
    async def scenario() -> None:
        async with SimulatorClient(f"sim://c320@1,2?watchdog={watchdog}") as client:
            await client.request(sunfar.SunfarWriteParameter(2, 9, 4, 20))
            await client.request(sunfar.SunfarControl(2, sunfar.SunfarOperation.RUN_FORWARD_AT, 3000))
            for _ in range(12):
                await client.request(sunfar.ReadMonitor(1, 0), 1.0)
            assert client.station(2).running is runs
            await asyncio.sleep(20.0)
            assert not client.station(2).running

    run(scenario())


async def identify_in_a_fault(url: str, encoding: str) -> tuple[Identity, Identity, int | None, int]:
    """Return the identity in a fault and without it, the reported fault code and the true one."""
    port = open_port(url)
    async with Bus(port) as bus:
        station = simulated_bus_of(port).station(1)
        drive = Drive(bus, "c320", 1, encoding=encoding)
        station.trip(Trip.OVERHEAT)
        in_fault = await drive.identify()
        fault = (await drive.status()).fault
        station.motor.reset()
        return in_fault, await drive.identify(), fault and fault.code, station.trip_code(Trip.OVERHEAT)


@pytest.mark.parametrize("encoding", ["ascii", "hex"])
@pytest.mark.parametrize("variant", ["code", "information"])
def test_an_identity_in_a_fault_is_reported_only_as_far_as_both_variants_agree(variant: str, encoding: str) -> None:
    """Digits 7-8 are the fault code or the voltage class: they are reported as neither, the digits after them are."""
    in_fault, complete, code, true_code = run(identify_in_a_fault(f"sim://c320@1?class0_fault={variant}", encoding))
    assert code == true_code
    assert (in_fault.voltage_class_v, in_fault.host_controls, in_fault.host_sets_frequency) == (None, None, None)
    assert in_fault.power_kw == complete.power_kw == 2.2
    assert (complete.voltage_class_v, complete.host_controls, complete.host_sets_frequency) == (380, True, True)
    assert [(part, "--" + digits[2:]) for part, digits in complete.digits] == list(in_fault.digits)


@pytest.mark.parametrize("variant", ["code", "information"])
def test_the_two_variants_of_an_identity_in_a_fault_differ_on_the_wire(variant: str) -> None:
    async def scenario() -> None:
        async with SimulatorClient(f"sim://c320@1?class0_fault={variant}") as client:
            client.station().trip(Trip.OVERHEAT)
            frame = await client.raw(client.codec.encode_request(sunfar.ReadIdentity(1, 0)))
            code = b"%02X" % client.station().trip_code(Trip.OVERHEAT)
            assert code != b"40"
            assert (frame[4:6], frame[7:9]) == (b"20", code if variant == "code" else b"40")

    run(scenario())
