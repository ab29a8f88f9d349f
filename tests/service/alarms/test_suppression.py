"""A lost port is one alarm: that its drives do not answer is suppressed as an effect (ISA-18.2)."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import pytest

from drivebus.drives.state import DriveState
from drivebus.service.alarms import AlarmEngine, SystemAlarm
from drivebus.service.alarms.model import AlarmChange
from drivebus.service.config.model import AlarmKind
from drivebus.testing.virtual_time import run
from fixtures.service import BUSES, ServiceKit, plant_config, running_service


def uncleared(kit: ServiceKit) -> list[tuple[str, str]]:
    """Return kind and drive, or other subject, of the alarms whose condition holds."""
    return sorted(
        (alarm.kind, alarm.drive or alarm.subject)
        for alarm in kit.service.plant.alarms.active()
        if alarm.cleared_ms is None
    )


def test_a_lost_port_is_one_alarm_and_not_one_of_each_drive() -> None:
    """A bus of 31 drives raised 32 alarms. A drive that is silent once the port is back raises its own."""

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            plant = kit.service.plant
            port = kit.simulated_bus("fan-1")
            port.unplug()
            await asyncio.sleep(30)
            assert uncleared(kit) == [("port_lost", "a")]
            assert {alarm.kind for alarm in plant.alarms.active()} == {SystemAlarm.PORT_LOST}
            view = plant.views["fan-1"]
            assert (view.presence, view.state) == ("offline", DriveState.UNKNOWN)
            kit.station("fan-2").faults.silent = True
            port.replug()
            await asyncio.sleep(30)
            assert uncleared(kit) == [("no_response", "fan-2")]

    run(scenario())


def test_a_drive_that_was_silent_before_keeps_its_alarm_while_the_port_is_lost() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            kit.station("fan-1").faults.silent = True
            await asyncio.sleep(20)
            port = kit.simulated_bus("fan-1")
            port.unplug()
            await asyncio.sleep(20)
            assert uncleared(kit) == [("no_response", "fan-1"), ("port_lost", "a")]
            kit.station("fan-1").faults.silent = False
            port.replug()
            await asyncio.sleep(20)
            assert uncleared(kit) == []

    run(scenario())


def test_the_alarm_of_a_lost_port_is_not_made_again_for_each_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its texts were made four times a second for each drive of the bus."""
    made: list[str] = []
    raise_alarm = AlarmEngine.raise_alarm

    def counted(alarms: AlarmEngine, kind: SystemAlarm, *args: Any, **more: Any) -> list[AlarmChange]:
        made.extend([kind] if kind is SystemAlarm.PORT_LOST else [])
        return raise_alarm(alarms, kind, *args, **more)

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            monkeypatch.setattr(AlarmEngine, "raise_alarm", counted)
            kit.simulated_bus("fan-1").unplug()
            await asyncio.sleep(10)
            assert uncleared(kit) == [("port_lost", "a")]
            assert len(made) <= 11

    run(scenario())


def test_a_port_that_is_absent_at_the_start_is_one_alarm() -> None:
    async def scenario() -> None:
        buses = (replace(BUSES[0], port="/dev/absent"), *BUSES[1:])
        async with running_service(plant_config(buses=buses)) as kit:
            await asyncio.sleep(30)
            assert uncleared(kit) == [("port_lost", "a")]
            assert AlarmKind.NO_RESPONSE not in {alarm.kind for alarm in kit.service.plant.alarms.active()}

    run(scenario())


def test_a_shelved_alarm_of_a_lost_port_does_not_hide_drives_that_do_not_answer() -> None:
    """The port was lost again while its alarm was shelved: no alarm counted that the drives did not answer."""

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            plant = kit.service.plant
            port = kit.simulated_bus("fan-1")
            port.unplug()
            await asyncio.sleep(5)
            (alarm,) = plant.alarms.active()
            await kit.call("alarm.shelve", alarm=alarm.id, minutes=60, reason="adapter is exchanged")
            port.replug()
            await asyncio.sleep(30)
            assert uncleared(kit) == []
            port.unplug()
            await asyncio.sleep(30)
            assert uncleared(kit) == [("no_response", "fan-1"), ("no_response", "fan-2"), ("port_lost", "a")]
            assert plant.alarms.counts("fan-1") == {"high": 1}

    run(scenario())
