"""Commands to single drives. The dispatcher has checked rights and parameters before a handler is called."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

from drivebus.drives.context import DriveLimits
from drivebus.drives.operations.parameter_write import check_writes, may_move
from drivebus.drives.operations.parameters import written_texts
from drivebus.drives.outcome import Outcome, OutcomeStatus, raise_for_status
from drivebus.errors import (
    ControlNotHeld,
    DrivebusError,
    LimitError,
    ServiceError,
    StartInhibited,
    StopUnconfirmed,
    Superseded,
    before_motion,
)
from drivebus.service.alarms import SystemAlarm
from drivebus.service.api.errors import error_to_json, outcome_json
from drivebus.service.api.handlers import handles
from drivebus.service.api.operations.drives import (
    DRIVE_ARM,
    DRIVE_HOLD_RAMP,
    DRIVE_LIMITS,
    DRIVE_PAUSE,
    DRIVE_RESET,
    DRIVE_RUN,
    DRIVE_SET_FREQUENCY,
    DRIVE_STOP,
    PARAMETERS_WRITE,
    START_INHIBIT_RELEASE,
    WAIVER_GRANT,
    WAIVER_REVOKE,
    ArmParams,
    DriveParams,
    LimitsParams,
    ParameterWriteParams,
    RampHoldParams,
    RunParams,
    SetFrequencyParams,
    StopParams,
    WaiverParams,
)
from drivebus.service.auth.actor import SERVICE_NAME, Actor
from drivebus.service.config.model import GroupConfig
from drivebus.service.control.leases import ARM_TTL_S, arm_target_of_test
from drivebus.service.control.start_blockers import check_start, check_test_start
from drivebus.service.control.tickets import CommandTicket
from drivebus.service.control.waivers import CommLossWaiver, waiver_key
from drivebus.service.live.views import StopKind
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant, narrow_limits
from drivebus.service.storage.settings import DriveIdentity, limits_key, limits_to_json
from drivebus.types import Json
from drivebus.values import Text


class DriveCommands:
    """Arms, motion, parameters, waivers and limits of single drives."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self._settings_lock = asyncio.Lock()
        """Held while a setting is stored and applied: of two changes the same one is the last on disk and in force."""

    def require_control(self, drive: str, actor: Actor) -> DriveRuntime:
        """Return a drive that the actor controls. Raises NotFound, ControlNotHeld."""
        runtime = self.plant.drive_runtime(drive)
        self.plant.leases.require(drive, actor, self.plant.now())
        return runtime

    def require_control_with_followers(self, drive: str, actor: Actor) -> DriveRuntime:
        """Require control of a drive and of every drive that follows its frequency.

        Raises ControlNotHeld before anything is sent.
        """
        runtime = self.require_control(drive, actor)
        for _, follower in self.plant.followers(drive):
            try:
                self.require_control(follower.id, actor)
            except ControlNotHeld as error:
                raise ControlNotHeld("plant.follower_not_owned", drive=follower.id, leader=drive, why=error) from error
        return runtime

    @handles(DRIVE_ARM)
    async def arm_start(self, params: ArmParams, actor: Actor) -> Json:
        """Issue the token of a start. Fails for every reason for which the start itself would."""
        runtime = self.require_control(params.drive, actor)
        is_test = params.purpose == "comm_loss_test"
        (check_test_start if is_test else check_start)(self.plant, runtime)
        target = arm_target_of_test(runtime.id) if is_test else runtime.id
        return {"arm_token": self.plant.arm_tokens.issue(target, actor, self.plant.now()), "expires_s": ARM_TTL_S}

    # --- motion ---------------------------------------------------------------------------------------------------

    @handles(DRIVE_RUN)
    async def run(self, params: RunParams, actor: Actor, ticket: CommandTicket) -> Json:
        with before_motion():
            runtime = self.require_control_with_followers(params.drive, actor)
            check_start(self.plant, runtime)
            runtime.drive.check_frequency(params.frequency_hz)
            self.plant.arm_tokens.consume(params.arm_token, runtime.id, actor, self.plant.now())
        answer = await self.start_drive(runtime, params.frequency_hz, params.direction, actor, ticket.issued_at)
        return answer | {"followers": await self.update_followers(runtime, params.frequency_hz, actor)}

    async def start_drive(
        self, runtime: DriveRuntime, frequency_hz: float, direction: str | None, actor: Actor, requested_at: float
    ) -> Json:
        """Start a drive after all checks. It counts as started by the service once a frame may have left."""
        start = runtime.drive.run(frequency_hz, direction, requested_at=requested_at)
        try:
            outcome = await self.run_motion(runtime, start)
        except DrivebusError as error:
            self.publish_failed_start(runtime, "run", error, actor, frequency_hz=frequency_hz)
            raise
        runtime.commanded_hz = frequency_hz
        return self.publish_outcome(runtime, "run", outcome, actor, frequency_hz=frequency_hz)

    async def run_motion(self, runtime: DriveRuntime, motion: Awaitable[Outcome]) -> Outcome:
        """Await a motion. One that failed before any motor can run by it leaves ``started_by_service`` unchanged."""
        runtime.begin_start()
        last_stop, may_be_running = runtime.last_stop, False
        try:
            outcome = await motion
            may_be_running = True
            return outcome
        except DrivebusError as error:
            may_be_running = error.may_be_running is not False
            raise
        finally:
            was_stopped = runtime.last_stop is not last_stop
            if may_be_running and not was_stopped:
                runtime.last_stop = None
            # Of two stops, the one before the start may have been confirmed meanwhile; one during it ends the motion.
            started = may_be_running and (not was_stopped or runtime.started_by_service)
            runtime.end_start(self.plant.now(), started=started)

    @handles(DRIVE_SET_FREQUENCY)
    async def set_frequency(self, params: SetFrequencyParams, actor: Actor, ticket: CommandTicket) -> Json:
        runtime = self.require_control_with_followers(params.drive, actor)
        _check_limits_known(runtime)
        outcome = await runtime.drive.set_frequency(params.frequency_hz, ticket.issued_at)
        runtime.commanded_hz = params.frequency_hz
        answer = self.publish_outcome(runtime, "set_frequency", outcome, actor, frequency_hz=params.frequency_hz)
        return answer | {"followers": await self.update_followers(runtime, params.frequency_hz, actor)}

    @handles(DRIVE_PAUSE)
    async def pause(self, params: DriveParams, actor: Actor) -> Json:
        runtime = self._require_no_followers(params.drive, actor)
        return self.publish_outcome(runtime, "pause", await runtime.drive.pause(), actor)

    @handles(DRIVE_HOLD_RAMP)
    async def hold_ramp(self, params: RampHoldParams, actor: Actor, ticket: CommandTicket) -> Json:
        runtime = self._require_no_followers(params.drive, actor)
        _check_limits_known(runtime)
        runtime.ramp_holds += 1
        try:
            outcome = await runtime.drive.hold_ramp(params.seconds, ticket.issued_at)
        finally:
            runtime.ramp_holds -= 1
        return self.publish_outcome(runtime, "hold_ramp", outcome, actor, seconds=params.seconds)

    def _require_no_followers(self, drive: str, actor: Actor) -> DriveRuntime:
        """Return a drive that the actor controls and that leads no running drive. Raises StartInhibited."""
        runtime = self.require_control(drive, actor)
        for _, follower in self.plant.followers(drive):
            raise StartInhibited("plant.leader_holds", drive=drive, follower=follower.id)
        return runtime

    # --- followers ------------------------------------------------------------------------------------------------

    async def update_followers(self, leader: DriveRuntime, frequency_hz: float, actor: Actor) -> Json:
        """Give the running followers of a drive their share of its new frequency; return the outcome of each."""
        return {
            drive.id: await self.set_follower(group, drive, frequency_hz, actor)
            for group, drive in self.plant.followers(leader.id)
        }

    async def set_follower(
        self,
        group: GroupConfig,
        drive: DriveRuntime,
        frequency_hz: float,
        actor: Actor,
        requested_at: float | None = None,
    ) -> Json:
        """Give a follower its share, unless its lease ended while the leader was commanded."""
        try:
            self.require_control(drive.id, actor)
        except ControlNotHeld as error:
            self.plant.publish_event("command", drive.id, "plant.does_not_follow", actor=actor.name, why=error)
            return error_to_json(error)
        return await self.set_drive_frequency(drive, follower_hz(group, drive.id, frequency_hz), actor, requested_at)

    async def set_drive_frequency(
        self, drive: DriveRuntime, frequency_hz: float, actor: Actor, requested_at: float | None
    ) -> Json:
        """Return the outcome, or the error, of a setpoint. Its age counts from ``requested_at``, None: from now."""
        try:
            _check_limits_known(drive)
            outcome = await drive.drive.set_frequency(frequency_hz, requested_at)
        except DrivebusError as error:
            return error_to_json(error)
        drive.commanded_hz = frequency_hz
        answer = self.publish_outcome(drive, "set_frequency", outcome, actor, frequency_hz=frequency_hz)
        result: Json = answer["outcome"]
        return result

    # --- stops and resets -----------------------------------------------------------------------------------------

    @handles(DRIVE_STOP)
    async def stop(self, params: StopParams, actor: Actor) -> Json:
        """Stop a drive: without lease, arming or audit record, and queued before anything is awaited."""
        runtime = self.plant.drive_runtime(params.drive)
        kind: StopKind = "automatic" if actor.name == SERVICE_NAME else "drive"
        self.plant.record_stop_request(runtime, by=actor.name, kind=kind)
        if params.assume_model:
            runtime.drive.assume_model()
        joint = self.plant.bus_of(runtime).automatic_stops if kind == "automatic" else None
        stops: dict[str, Callable[[], Awaitable[Outcome]]] = {
            "stop": partial(runtime.drive.stop, joint=joint),
            "coast": runtime.drive.coast,
            "quick_stop": runtime.drive.quick_stop,
        }
        return self.publish_outcome(runtime, "stop", await self.finish_stop(runtime, stops[params.how]()), actor)

    async def finish_stop(self, runtime: DriveRuntime, stop: Awaitable[Outcome]) -> Outcome:
        """Await a stop. An unconfirmed one raises an alarm and is repeated by ``Drive``. Raises StopUnconfirmed."""
        try:
            outcome = await stop
        except StopUnconfirmed as error:
            self.plant.raise_alarm(SystemAlarm.STOP_UNCONFIRMED, runtime.id)
            if error.outcome is not None:
                raise_for_status(repeated_stop(runtime, error.outcome), stop=True)
            raise
        self.record_stopped(runtime, outcome)
        return outcome

    async def report_stop(self, runtime: DriveRuntime, stop: Awaitable[Outcome], actor: Actor) -> None:
        """Await a stop and publish its outcome; an unconfirmed one has raised its alarm and is being repeated."""
        with suppress(DrivebusError):
            self.publish_outcome(runtime, "stop", await self.finish_stop(runtime, stop), actor)

    def record_stopped(self, runtime: DriveRuntime, outcome: Outcome) -> None:
        """Record a stop that was confirmed, or acknowledged by a drive that reports no run state."""
        self.plant.stop_statistics.count_outcome(outcome)
        self.end_motion(runtime)

    def end_motion(self, runtime: DriveRuntime) -> None:
        """End the motion of a drive that has confirmed or acknowledged a stop, and the alarm about the stop."""
        runtime.end_motion()
        runtime.commanded_hz = None
        self.plant.clear_alarm(SystemAlarm.STOP_UNCONFIRMED, runtime.id)

    @handles(DRIVE_RESET)
    async def reset_fault(self, params: DriveParams, actor: Actor) -> Json:
        runtime = self.require_control(params.drive, actor)
        return self.publish_outcome(runtime, "reset", await runtime.drive.reset_fault(), actor)

    @handles(START_INHIBIT_RELEASE)
    async def release_start_inhibit(self, params: DriveParams, actor: Actor) -> Json:
        """Permit starts again after a bus stop; nothing is sent."""
        self.release_start(self.plant.drive_runtime(params.drive), actor)
        return {}

    def release_start(self, runtime: DriveRuntime, actor: Actor) -> None:
        """Permit starts of one drive again, where a bus stop inhibits them. Raises ControlNotHeld."""
        self.require_control(runtime.id, actor)
        if not runtime.bus.start_inhibited(runtime.config.address):
            return
        runtime.bus.release_start([runtime.config.address])
        self.plant.publish_event("command", runtime.id, "plant.released", actor=actor.name)

    def publish_failed_start(
        self, runtime: DriveRuntime, command: str, error: DrivebusError, actor: Actor, **params: Any
    ) -> None:
        """Publish an event of a start that failed after a frame that moves may have left: the motor may be running."""
        if error.may_be_running is not False:
            status = error.outcome.status if isinstance(error.outcome, Outcome) else OutcomeStatus.UNKNOWN
            self.plant.publish_event(
                "command",
                runtime.id,
                f"plant.did_{command}",
                actor=actor.name,
                outcome=str(status),
                **params,
                how=error,
            )

    def publish_outcome(
        self, runtime: DriveRuntime, command: str, outcome: Outcome, actor: Actor, **params: Any
    ) -> Json:
        """Publish the outcome of a command as an event and return it as JSON."""
        answer = outcome_json(outcome, self.plant.command_id(command))
        self.plant.publish_event(
            "stop" if command == "stop" else "command",
            runtime.id,
            f"plant.did_{command}",
            actor=actor.name,
            outcome=str(outcome.status),
            **params,
            how=outcome,
        )
        return {"outcome": answer}

    @handles(PARAMETERS_WRITE)
    async def write_parameters(self, params: ParameterWriteParams, actor: Actor) -> Json:
        """Write parameters to RAM, or with ``save`` to EEPROM, and read each back; a parameter may move a motor."""
        runtime = self.require_control(params.drive, actor)
        dialect = runtime.drive.dialect
        starts = any(may_move(dialect, write) for write in check_writes(dialect, params.values))
        if starts:
            check_start(self.plant, runtime)
        runtime.comm_loss.invalidate()
        write = runtime.drive.write(params.values, save=params.save, force=params.force)
        try:
            outcome = await (self.run_motion(runtime, write) if starts else write)
        except DrivebusError as error:
            self._publish_partial_write(runtime, error, actor)
            raise
        finally:
            runtime.comm_loss.invalidate()  # what was read meanwhile may have been the old value
        self.plant.publish_event(
            "configuration", runtime.id, "plant.did_write", actor=actor.name, outcome=str(outcome.status)
        )
        return {"outcome": outcome_json(outcome, self.plant.command_id("write"))}

    def _publish_partial_write(self, runtime: DriveRuntime, error: DrivebusError, actor: Actor) -> None:
        """Publish an event with what a command wrote before it failed."""
        outcome = error.outcome
        written = written_texts(outcome) if isinstance(outcome, Outcome) else []
        if isinstance(outcome, Outcome) and written:
            self.plant.publish_event(
                "configuration",
                runtime.id,
                "plant.did_write_part",
                actor=actor.name,
                outcome=str(outcome.status),
                written=Text.join(written, "items"),
                how=outcome,
            )

    # --- waivers and limits -----------------------------------------------------------------------------------------

    @handles(WAIVER_GRANT)
    async def grant_waiver(self, params: WaiverParams, actor: Actor) -> Json:
        return {"waiver": await self.record_waiver(self.plant.drive_runtime(params.drive), params.reason, actor)}

    async def record_waiver(self, runtime: DriveRuntime, reason: str, actor: Actor) -> str:
        """Record a waiver and return its text. Raises ConfigurationError; Superseded where it was for another motor."""
        text = f"{reason} ({actor.name})"
        waiver = CommLossWaiver.for_drive(text, runtime.config, self.plant.bus_of(runtime).config)
        async with self._settings_lock:
            present = await self._store_value(runtime, waiver_key(runtime.id), waiver.to_json())
            if present is not runtime:
                await self._erase_waiver(present)  # a restart, or this reload, would put it in force
                raise Superseded("plant.another_meanwhile", drive=runtime.id)
            runtime.comm_loss.waiver = text
        self.plant.publish_event("waiver", runtime.id, "plant.waived", actor=actor.name, reason=reason)
        return text

    async def _store_value(self, runtime: DriveRuntime, key: str, value: str) -> DriveRuntime:
        """Store a value durably, in a thread. Raises ConfigurationError.

        Return the drive that has this name by then: a reload that replaced it has read the value of before.
        """
        await asyncio.to_thread(self.plant.store.put, key, value)
        return self.plant.drives.get(runtime.id, runtime)

    async def _erase_waiver(self, runtime: DriveRuntime) -> None:
        """Erase the waiver of a drive, stored and in force. Raises ConfigurationError."""
        runtime = await self._store_value(runtime, waiver_key(runtime.id), "")
        runtime.comm_loss.waiver, runtime.comm_loss.waiver_of_another = None, None

    @handles(WAIVER_REVOKE)
    async def revoke_waiver(self, params: DriveParams, actor: Actor) -> Json:
        runtime = self.plant.drive_runtime(params.drive)
        async with self._settings_lock:
            await self._erase_waiver(runtime)
        self.plant.publish_event("waiver", runtime.id, "plant.unwaived", actor=actor.name)
        return {}

    @handles(DRIVE_LIMITS)
    async def set_limits(self, params: LimitsParams, actor: Actor) -> Json:
        """Set limits narrower than those of the configuration. Raises LimitError for wider ones."""
        runtime = self.plant.drive_runtime(params.drive)
        own = DriveLimits(params.minimum_hz, params.maximum_hz, params.forward, params.reverse)
        lowest, highest = max(own.minimum_hz, runtime.configured_range_hz[0]), runtime.configured_range_hz[1]
        maximum = highest if own.maximum_hz is None else own.maximum_hz
        if maximum > highest or own.minimum_hz > maximum or lowest > maximum:
            raise LimitError(
                "plant.limits", drive=runtime.id, minimum_hz=runtime.configured_range_hz[0], maximum_hz=highest
            )
        async with self._settings_lock:
            identity = DriveIdentity.of(runtime.config, self.plant.bus_of(runtime).config)
            runtime = await self._store_value(runtime, limits_key(runtime.id), limits_to_json(own, identity))
            runtime.limits_lost = False
            runtime.set_limits(narrow_limits(own, runtime.config.limits))
        self.plant.report_lost_limits()
        self.plant.publish_event("configuration", runtime.id, "plant.limited", actor=actor.name)
        low, high = runtime.drive.range_hz
        return {"minimum_hz": low, "maximum_hz": high, "note": self.plant.report_above_limit(runtime)}


_REPEATED_STOP_KEYS = {
    f"drives.{name}": f"plant.{name}" for name in ("stop_not_sent_port", "stop_port_lost", "stop_port_lost_after")
}
"""Key of the outcome of a stop whose port is lost → key with which it also says that the service repeats the stop."""


def repeated_stop(runtime: DriveRuntime, outcome: Outcome) -> Outcome:
    """Return the outcome of a stop; one whose port is lost states that the service still repeats it."""
    repeats = runtime.drive.stop_pending and not runtime.bus.is_closed
    key = _REPEATED_STOP_KEYS.get(outcome.key)
    return replace(outcome, key=key) if key is not None and repeats else outcome


def _check_limits_known(runtime: DriveRuntime) -> None:
    if runtime.limits_lost:
        raise ServiceError("plant.limits_lost", drive=runtime.id)


def follower_hz(group: GroupConfig, drive: str, frequency_hz: float) -> float:
    """Return the frequency of a drive when its group or leader gets ``frequency_hz``."""
    return frequency_hz * group.ratios.get(drive, 1.0)
