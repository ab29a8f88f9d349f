"""Deadline of a start: audit record, turn on the bus and checks share five seconds from ticket to first bit."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import pytest

from drivebus.drives.operations import command_age
from drivebus.drives.outcome import Outcome
from drivebus.drives.permissives import COMMAND_TTL_S, CommandKind
from drivebus.errors import Expired, OutcomeUnknown
from drivebus.service.config.model import GroupConfig
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.testing.virtual_time import run
from fixtures.service import ServiceKit, plant_config, running_service

GROUP = GroupConfig(id="fans", drives=("fan-1", "fan-2"), start_interval_s=4.0)
MOTIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "run": ("drive.run", {"drive": "fan-1", "frequency_hz": 20.0}),
    "jog": ("drive.jog", {"drive": "fan-1", "frequency_hz": 5.0}),
    "group": ("group.start", {"group": "fans", "frequency_hz": 20.0}),
}


async def start_delay_s(kit: ServiceKit, name: str, audit_delay_s: float) -> float | None:
    """Return the time from the command to the start of the motor; None where it expired."""
    operation, params = MOTIONS[name]
    kit.trail.delay_s = audit_delay_s
    requested_at, motor = kit.service.plant.now(), kit.station("fan-1").motor
    start = asyncio.create_task(kit.call(operation, **params))
    while not start.done():
        await asyncio.sleep(0.005)
        if motor.phase.value != "off":
            delay_s = kit.service.plant.now() - requested_at
            await start
            return delay_s
    with pytest.raises(Expired):
        await start
    return None


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize(
    ("audit_delay_s", "limit_s", "starts"), [(1.0, 2.0, True), (1.7, 2.0, False), (1.99, 2.5, False)]
)
def test_a_slow_audit_record_leaves_less_time_for_the_checks(
    name: str, audit_delay_s: float, limit_s: float, starts: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The checks of this bus take 0.7 s; neither they nor the record alone take too long."""
    monkeypatch.setattr(command_age, "CHECKS_TIMEOUT_S", limit_s)

    async def scenario() -> None:
        async with running_service(plant_config(groups=(GROUP,))) as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            delay_s = await start_delay_s(kit, name, audit_delay_s)
            assert (delay_s is not None) is starts
            if delay_s is not None:
                assert audit_delay_s < delay_s <= limit_s
            assert kit.station("fan-2").motor.starts == (1 if starts and name == "group" else 0)

    run(scenario())


@pytest.mark.parametrize("start_interval_s", [0.0, 3.0])
def test_each_further_drive_of_a_group_has_its_own_deadline(
    start_interval_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The turn of a further drive comes seconds after the command; the lease shows that the command still stands."""
    monkeypatch.setattr(command_age, "CHECKS_TIMEOUT_S", COMMAND_TTL_S[CommandKind.START])

    async def scenario() -> None:
        group = GroupConfig(
            id="fans", drives=("fan-1", "fan-2", "pump-1"), start_interval_s=start_interval_s, max_concurrent_starts=3
        )
        async with running_service(plant_config(groups=(group,))) as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            started_at = kit.service.plant.now()
            found = await kit.call("group.start", group="fans", frequency_hz=20.0)
            assert [outcome.get("status") for outcome in found["outcomes"].values()] == ["confirmed"] * 3
            assert kit.service.plant.now() - started_at > command_age.CHECKS_TIMEOUT_S

    run(scenario())


def record_ages(kit: ServiceKit) -> dict[str, float]:
    """Return drive → seconds from now to the time from which the age of its next setpoint counts."""
    commanded_at, ages = kit.service.plant.now(), {}

    def record_age(runtime: DriveRuntime) -> None:
        original = runtime.drive.set_frequency

        async def recording(frequency_hz: float, requested_at: float | None = None) -> Outcome:
            ages[runtime.id] = (kit.service.plant.now() if requested_at is None else requested_at) - commanded_at
            return await original(frequency_hz, requested_at)

        runtime.drive.set_frequency = recording  # type: ignore[method-assign]

    for runtime in kit.service.plant.drives.values():
        record_age(runtime)
    return ages


@pytest.mark.parametrize("leader", [None, "fan-1"])
def test_the_age_of_a_setpoint_counts_from_its_command(leader: str | None) -> None:
    """A setpoint expires after five seconds; where its frame may start the motor, after two.

    That of a follower counts from the outcome of its leader, which waited for the audit record.
    """

    async def scenario() -> None:
        group = replace(GROUP, leader=leader)
        async with running_service(plant_config(groups=(group,))) as kit:
            await asyncio.sleep(2)
            kit.trail.delay_s = 1.5
            ages = record_ages(kit)
            if leader is None:
                await kit.call("drive.set_frequency", drive="pump-1", frequency_hz=20.0)
                assert ages == {"pump-1": 0.0}
                ages = record_ages(kit)
            await kit.call("group.set_frequency", group="fans", frequency_hz=20.0)
            assert ages.pop("fan-1") == 0.0
            (follower,) = ages.values()
            assert follower == 0.0 if leader is None else 1.5 < follower < 3.5

    run(scenario())


def test_a_group_start_after_a_stop_has_its_own_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    """The lease of fan-1 is renewed, because it would expire during the start and the stop of the group."""
    monkeypatch.setattr(command_age, "CHECKS_TIMEOUT_S", COMMAND_TTL_S[CommandKind.START])

    async def scenario() -> None:
        async with running_service(plant_config(groups=(GROUP,))) as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            await kit.call("group.start", group="fans", frequency_hz=20.0)
            stop = asyncio.create_task(kit.call("drive.stop", drive="fan-1"))
            await kit.call("lease.renew", drive="fan-1")
            await stop
            started_at = kit.service.plant.now()
            found = await kit.call("group.start", group="fans", frequency_hz=20.0)
            assert found["outcomes"]["fan-1"]["status"] == "confirmed"
            assert kit.service.plant.now() - started_at > command_age.CHECKS_TIMEOUT_S

    run(scenario())


def test_the_documented_time_limits_of_commands() -> None:
    assert COMMAND_TTL_S[CommandKind.START] == COMMAND_TTL_S[CommandKind.JOG] == 2.0
    assert command_age.CHECKS_TIMEOUT_S == COMMAND_TTL_S[CommandKind.SETPOINT] == 5.0


@pytest.mark.parametrize("may_be_running", [None, False])
def test_a_start_without_reply_becomes_an_event_and_one_that_was_not_sent_does_not(
    may_be_running: bool | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fail(*_: Any, **__: Any) -> Outcome:
        error = OutcomeUnknown("plant.internal")
        error.may_be_running = may_be_running
        raise error

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            monkeypatch.setattr(kit.service.plant.drives["fan-1"].drive, "run", fail)
            with pytest.raises(OutcomeUnknown):
                await kit.call("drive.run", drive="fan-1", frequency_hz=20.0)
            found = [event["outcome"] for event in kit.history.events if event["kind"] == "command"]
            assert found == ([] if may_be_running is False else ["unknown"])

    run(scenario())
