"""Codes with which drives of one register map name their model: INVT Goodrive, 2103H."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.drives import Drive, create_dialect
from drivebus.drives.outcome import OutcomeStatus
from drivebus.errors import StartInhibited
from drivebus.ports import open_port
from drivebus.protocols.modbus import ReadRegisters, RegisterValues
from drivebus.testing.virtual_time import run

GOODRIVES = ("gd10", "gd20", "gd35", "gd100", "gd200", "gd200l", "gd300")


def test_every_code_of_an_included_profile_is_that_of_included_models() -> None:
    known = set(profiles.models())
    codes = [codes for name in known if (codes := profiles.load(name).identity_codes) is not None]
    assert codes and {model for each in codes for models in each.models.values() for model in models} <= known


def test_a_drive_that_names_another_model_is_not_started_but_is_stopped() -> None:
    """A Goodrive100 at the address of a Goodrive300: its ratings and its limits are others, its stop is the same."""

    async def scenario() -> None:
        port: Any = open_port("sim://gd100@3?line_quality=clean")
        async with Bus(port) as bus:
            drive, station = Drive(bus, "gd300", 3), port.simulated_bus.stations[0]
            with pytest.raises(StartInhibited, match="reports code 010BH, which is a gd100, but its profile is gd300"):
                await drive.run(10.0)
            assert station.command == 0 and not station.motor.energised
            station.keypad_run(20.0)
            await asyncio.sleep(1)
            assert (await drive.stop()).status is OutcomeStatus.CONFIRMED
            assert station.command == 5

    run(scenario())


@pytest.mark.parametrize(("model", "simulated"), [("gd200", "gd200l"), ("gd350", "gd100"), ("galt_g200", "gd10")])
def test_models_of_one_code_and_models_without_a_known_code_are_started(model: str, simulated: str) -> None:
    """The code of a Goodrive350 is not published: 010BH proves nothing there."""

    async def scenario() -> None:
        port: Any = open_port(f"sim://{simulated}@3?line_quality=clean")
        async with Bus(port) as bus:
            assert (await Drive(bus, model, 3).run(10.0)).status is OutcomeStatus.CONFIRMED

    run(scenario())


@pytest.mark.parametrize("code", [0x0000, 0x0107, 0xFFFF])
def test_an_unknown_code_names_no_model(code: int) -> None:
    dialect: Any = create_dialect(profiles.load("gd10"), 3)
    identity = dialect.decode_identity((RegisterValues(3, 3, (code,)),))
    assert not identity.reported and identity.models == ()
    codes = dialect.profile.identity_codes
    assert not codes.names_other(code, "gd10")


def test_the_code_is_read_by_the_identity_read_alone() -> None:
    dialect: Any = create_dialect(profiles.load("gd10"), 3)
    assert dialect.identity_reads() == (ReadRegisters(3, 0x2103, 1),)
    polled = [request for request, _ in dialect.polls(tuple(dialect.profile.signals))]
    assert all(0x2103 not in range(read.register, read.register + read.count) for read in polled)
    assert dialect.decode_identity((RegisterValues(3, 3, (0x010C,)),)).models == ("gd200", "gd200l")
    assert dialect.decode_identity((None,)).reported is False


@pytest.mark.parametrize("model", GOODRIVES)
def test_a_goodrive_is_identified_by_its_code(model: str) -> None:
    async def scenario() -> None:
        async with Bus(open_port(f"sim://{model}@3?line_quality=clean")) as bus:
            assert model in (await Drive(bus, model, 3).identify()).models

    run(scenario())
