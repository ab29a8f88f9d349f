"""Commands under way of a session that loses control: what was not sent is not sent, what was sent is confirmed."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import pytest

from drivebus.drives.outcome import Outcome
from drivebus.drives.state import DriveState
from drivebus.errors import ArmRequired, Superseded
from drivebus.service.alarms import SystemAlarm
from drivebus.service.auth.rights import Role
from drivebus.service.config.model import OnClientLost, OnServiceStop
from drivebus.service.control.leases import LEASE_TTL_S
from drivebus.testing.virtual_time import run
from drivebus.types import Json
from fixtures.service import DRIVES, GROUPS, ServiceKit, plant_config, remote_actor, running_service

ANN = remote_actor()


@pytest.mark.parametrize("drive", ["fan-1", "pump-1"])
@pytest.mark.parametrize("taken", [False, True], ids=["the user is disabled", "an engineer takes control"])
def test_no_start_frame_is_sent_once_its_user_has_lost_control_and_one_sent_before_is_confirmed(
    drive: str, taken: bool
) -> None:
    """The motor started up to 0.7 s after its user was disabled, and the audit trail named the start as confirmed."""
    found: list[tuple[int, int, str | None]] = []

    async def scenario(after_s: float) -> None:
        async with running_service() as kit:
            starting = await kit.begin(ANN, "drive.run", drive, 20.0)
            await asyncio.sleep(after_s)
            assert not starting.done()
            starts = kit.station(drive).motor.starts
            if taken:
                await kit.call("lease.take", remote_actor("li", Role.ENGINEER), drive=drive)
            else:
                await kit.service.end_control("rights", ANN)
            await asyncio.wait([starting])
            await asyncio.sleep(1)
            state = kit.service.plant.drives[drive].status().state
            assert (state is DriveState.STOPPED) == (starts == 0)
            found.append((starts, kit.station(drive).motor.starts, kit.trail.outcomes("drive.run")[-1]))
            if starts == 0:
                error = starting.exception()
                assert isinstance(error, Superseded) and error.may_be_running is False
                (entry,) = [entry for entry in kit.trail.entries if entry.what == "drive.run" and entry.of is not None]
                assert "control of" in entry.params["error_text"]["en"]
                assert not kit.service.plant.drives[drive].started_by_service

    for after_s in (0.0, 0.2, 0.45, 0.6, 0.65, 0.9):
        run(scenario(after_s))
    assert set(found) == {(0, 0, "plant.control_ended_meanwhile"), (1, 1, "confirmed")}


async def _begin_group_start(kit: ServiceKit) -> asyncio.Task[Any]:
    """Begin to start both fans under Ann's control; the second waits for its turn."""
    await asyncio.sleep(2)
    await kit.grant_waivers()
    for drive in ("fan-1", "fan-2"):
        await kit.call("lease.take", ANN, drive=drive)
    arm = (await kit.call("group.arm", ANN, group="fans"))["arm_token"]
    return asyncio.create_task(kit.call("group.start", ANN, group="fans", frequency_hz=20.0, arm_token=arm))


def test_a_group_start_ends_with_the_drive_whose_frame_had_left_and_tells_the_others() -> None:
    async def scenario() -> None:
        async with running_service(plant_config(groups=(replace(GROUPS[0], start_interval_s=20.0),))) as kit:
            starting = await _begin_group_start(kit)
            while kit.station("fan-1").motor.starts == 0:  # noqa: ASYNC110  the simulated drive has no event
                await asyncio.sleep(0.001)
            await kit.service.end_control("rights", ANN)
            async with asyncio.timeout(5):  # another user may start the group again without waiting for its interval
                outcomes = (await starting)["outcomes"]
            assert (outcomes["fan-1"]["status"], outcomes["fan-2"]["code"]) == ("confirmed", "plant.lease_gone")
            assert kit.station("fan-2").motor.starts == 0
            assert kit.trail.outcomes("group.start")[-1] == "confirmed, plant.lease_gone"

    run(scenario())


def test_a_jog_whose_frame_has_not_left_when_its_user_is_disabled_is_not_sent() -> None:
    async def scenario() -> None:
        async with running_service() as kit:
            jogging = await kit.begin(ANN, "drive.jog", "fan-1", 5.0)
            await asyncio.sleep(0.1)
            await kit.service.end_control("rights", ANN)
            with pytest.raises(Superseded) as withdrawn:
                await jogging
            assert withdrawn.value.key == "plant.control_ended_meanwhile"
            await asyncio.sleep(1)
            assert kit.station("fan-1").motor.starts == 0

    run(scenario())


def test_a_start_after_the_loss_of_control_is_another_command() -> None:
    """Another user's start, or the same user's after a new login, is not withdrawn with the one before."""

    async def scenario() -> None:
        async with running_service() as kit:
            starting = await kit.begin(ANN, "drive.run", "fan-1", 20.0)
            await asyncio.sleep(0)
            assert not starting.done()
            await kit.service.end_control("rights", ANN)
            with pytest.raises(Superseded):
                await starting
            bob = remote_actor("bob")
            await kit.call("lease.take", bob, drive="fan-1")
            arm = (await kit.call("drive.arm", bob, drive="fan-1"))["arm_token"]
            started = await kit.call("drive.run", bob, drive="fan-1", frequency_hz=10.0, arm_token=arm)
            assert started["outcome"]["status"] == "confirmed"
            assert kit.station("fan-1").motor.starts == 1

    run(scenario())


async def _end_control(kit: ServiceKit, how: str) -> None:
    """End Ann's control of the first fan, without another command of the drive."""
    match how:
        case "release":
            await kit.call("lease.release", ANN, drive="fan-1")
        case "expiry":
            while kit.service.plant.leases.get("fan-1", kit.service.plant.now()) is not None:  # noqa: ASYNC110
                await asyncio.sleep(0.01)
            await asyncio.sleep(0.25)  # one cycle of the supervision
        case "expiry before another takes it":
            while kit.service.plant.leases.get("fan-1", kit.service.plant.now()) is not None:  # noqa: ASYNC110
                await asyncio.sleep(0.0001)
            await kit.call("lease.take", remote_actor("bob"), drive="fan-1")
        case "handover":
            request = (await kit.call("control_request.make", remote_actor("bob"), drive="fan-1"))["control_request"]
            await kit.call("control_request.grant", ANN, drive="fan-1", request=request["id"])


async def _start_before_the_lease_ends(kit: ServiceKit, before_s: float) -> asyncio.Task[Json]:
    await asyncio.sleep(2)
    await kit.grant_waivers()
    await kit.call("lease.take", ANN, drive="fan-1")
    await asyncio.sleep(LEASE_TTL_S - before_s)
    arm = (await kit.call("drive.arm", ANN, drive="fan-1"))["arm_token"]
    return asyncio.create_task(kit.call("drive.run", ANN, drive="fan-1", frequency_hz=20.0, arm_token=arm))


CONTROL_ENDS = ["release", "handover", "expiry", "expiry before another takes it"]


@pytest.mark.parametrize("policy", list(OnClientLost))
@pytest.mark.parametrize("how", CONTROL_ENDS)
def test_a_start_that_has_not_left_when_its_control_ends_is_not_sent_and_raises_no_alarm(
    how: str, policy: OnClientLost
) -> None:
    """The motor started without control, or under that of a user who had not started it."""

    async def scenario() -> None:
        drives = tuple(replace(drive, on_client_lost=policy) for drive in DRIVES)
        async with running_service(plant_config(drives=drives)) as kit:
            starting = await _start_before_the_lease_ends(kit, 0.1)
            await asyncio.sleep(0.05)
            assert not starting.done() and kit.station("fan-1").motor.starts == 0
            await _end_control(kit, how)
            with pytest.raises(Superseded) as withdrawn:
                await starting
            assert (withdrawn.value.key, withdrawn.value.may_be_running) == ("plant.control_ended_meanwhile", False)
            await asyncio.sleep(15)  # a lease that was handed over has ended, too
            assert kit.station("fan-1").motor.starts == 0
            assert not kit.service.plant.drives["fan-1"].started_by_service
            assert [alarm.kind for alarm in kit.service.plant.alarms.active()] == []
            assert [entry for entry in kit.trail.entries if entry.what == "drive.stop"] == []

    run(scenario())


@pytest.mark.parametrize(("how", "alarm"), [("release", False), ("handover", False), ("expiry", True)])
def test_a_start_that_has_left_when_its_control_ends_is_confirmed_and_only_an_expiry_is_an_alarm(
    how: str, alarm: bool
) -> None:
    async def scenario() -> None:
        drives = tuple(replace(drive, on_client_lost=OnClientLost.HOLD) for drive in DRIVES)
        async with running_service(plant_config(drives=drives)) as kit:
            starting = await _start_before_the_lease_ends(kit, 0.8)
            while kit.station("fan-1").motor.starts == 0 and not starting.done():  # noqa: ASYNC110
                await asyncio.sleep(0.001)
            assert not starting.done()
            await _end_control(kit, how)
            assert (await starting)["outcome"]["status"] == "confirmed"
            alarms = [active.kind for active in kit.service.plant.alarms.active()]
            assert alarms == [SystemAlarm.CONTROL_LOST] * alarm

    run(scenario())


@pytest.mark.parametrize("how", CONTROL_ENDS)
def test_the_end_of_control_ends_its_arm_tokens(how: str) -> None:
    """The same session could take control back and start with what it had armed before another had the drive."""

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            await kit.call("lease.take", ANN, drive="fan-1")
            await asyncio.sleep(LEASE_TTL_S - 1)
            arm = (await kit.call("drive.arm", ANN, drive="fan-1"))["arm_token"]
            await _end_control(kit, how)
            await kit.service.end_control("logout", remote_actor("bob"))
            await kit.call("lease.take", ANN, drive="fan-1")
            with pytest.raises(ArmRequired):
                await kit.call("drive.run", ANN, drive="fan-1", frequency_hz=20.0, arm_token=arm)

    run(scenario())


def test_two_starts_of_a_drive_that_were_not_sent_leave_it_not_started() -> None:
    """The second took the first for a start by the service: the end of the lease was an alarm of a drive at rest."""

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            runtime = kit.service.plant.drives["fan-1"]
            rejected = Superseded("plant.stopped_meanwhile", drive="fan-1")
            rejected.may_be_running = False

            async def start(seconds: float) -> Outcome:
                await asyncio.sleep(seconds)
                raise rejected

            starts = [kit.service.commands.run_motion(runtime, start(seconds)) for seconds in (0.1, 0.2)]
            for result in await asyncio.gather(*starts, return_exceptions=True):
                assert result is rejected
            assert not runtime.started_by_service

    run(scenario())


def test_a_group_start_whose_control_was_released_does_not_wait_for_the_turns_of_its_other_drives() -> None:
    """It counted as being started, so that no other user could start it."""

    async def scenario() -> None:
        async with running_service(plant_config(groups=(replace(GROUPS[0], start_interval_s=20.0),))) as kit:
            starting = await _begin_group_start(kit)
            await asyncio.sleep(2)
            assert not starting.done()
            await kit.call("lease.release", ANN, drive="fan-2")
            async with asyncio.timeout(1):
                outcomes = (await starting)["outcomes"]
            assert (outcomes["fan-1"]["status"], outcomes["fan-2"]["code"]) == ("confirmed", "plant.lease_gone")

    run(scenario())


def test_a_start_that_has_not_left_when_the_service_ends_is_not_sent_to_a_drive_that_it_would_leave_running() -> None:
    """An event named it as running, and it started where the stop of another drive took longer."""

    async def scenario() -> None:
        policies = {"fan-1": OnServiceStop.HOLD, "fan-2": OnServiceStop.STOP}
        drives = tuple(replace(drive, on_service_stop=policies.get(drive.id, OnServiceStop.STOP)) for drive in DRIVES)
        async with running_service(plant_config(drives=drives)) as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            await kit.call("drive.run", drive="fan-2", frequency_hz=20.0)
            starting = await kit.begin(ANN, "drive.run", "fan-1", 20.0)
            await asyncio.sleep(0.05)
            motor = kit.station("fan-1").motor
            assert not starting.done() and motor.starts == 0
            await kit.service.stop()
            with pytest.raises(Superseded) as withdrawn:
                await starting
            assert (withdrawn.value.key, withdrawn.value.may_be_running) == ("plant.stopping", False)
            assert motor.starts == 0
            assert [event["drive"] for event in kit.history.events if event["kind"] == "not_stopped"] == []

    run(scenario())


RECORDED_COMMANDS: dict[str, Json] = {
    "drive.set_frequency": {"frequency_hz": 15.0},
    "drive.reset": {},
    "parameters.write": {"values": {"F1.10": 1.0}},
    "drive.run": {"frequency_hz": 15.0},
}


@pytest.mark.parametrize("operation", RECORDED_COMMANDS)
def test_a_command_is_not_sent_whose_session_gave_up_control_and_took_it_again_while_it_was_recorded(
    operation: str,
) -> None:
    """With control given up, the command before it was to be void: it was sent."""
    engineer = remote_actor("li", Role.ENGINEER)

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            await kit.grant_waivers()
            await kit.call("lease.take", engineer, drive="fan-1")
            params = RECORDED_COMMANDS[operation]
            if operation == "drive.run":
                params = params | await kit.call("drive.arm", engineer, drive="fan-1")
                del params["expires_s"]
            station = kit.station("fan-1")
            before = _state(station)
            kit.trail.delay_s = 0.5
            command = asyncio.create_task(kit.call(operation, engineer, drive="fan-1", **params))
            await asyncio.sleep(0.1)
            kit.trail.delay_s = 0.0
            for lease in ("lease.release", "lease.take"):
                await kit.call(lease, engineer, drive="fan-1")
            with pytest.raises(Superseded) as withdrawn:
                await command
            assert withdrawn.value.key == "plant.control_ended_meanwhile"
            assert _state(station) == before

    run(scenario())


def _state(station: Any) -> tuple[Any, ...]:
    """Return what a command changes in a simulated drive."""
    return station.setpoint_hz, station.motor.starts, repr(vars(station.memory))


def test_the_end_of_control_ends_no_command_that_needs_none() -> None:
    """A waiver is recorded by anyone with the right to it; taking control again is no command of the time before."""
    engineer = remote_actor("li", Role.ENGINEER)

    async def scenario() -> None:
        async with running_service() as kit:
            await asyncio.sleep(2)
            kit.trail.delay_s = 0.5
            taking = asyncio.create_task(kit.call("lease.take", engineer, drive="fan-1"))
            waiving = asyncio.create_task(kit.call("waiver.grant", engineer, drive="fan-1", reason="test bench"))
            await asyncio.sleep(0.1)
            kit.trail.delay_s = 0.0
            for lease in ("lease.take", "lease.release"):
                await kit.call(lease, engineer, drive="fan-1")
            await asyncio.gather(taking, waiving)
            assert kit.service.plant.leases.get("fan-1", kit.service.plant.now()) is not None

    run(scenario())
