"""Test of a drive's behaviour at communication loss: run it slowly, send it nothing, read what it did, stop it.

Only this drive gets no requests, which is the harder case: where a drive stops although other stations are addressed,
it also stops when the whole bus is silent. Any frame to the drive ends the silence, so that an adapter that is pulled
and plugged in again is measured as well.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

from drivebus.commissioning.acceptance import COMM_LOSS_MARGIN_S, UNKNOWN_COMM_LOSS_S
from drivebus.drives.dialects.base import UNNAMED_FAULT_CODE
from drivebus.drives.state import DriveState, DriveStatus, Fault
from drivebus.errors import DrivebusError, ServiceError, Superseded
from drivebus.service.api.errors import localized
from drivebus.service.api.handlers import handles
from drivebus.service.api.operations.comm_loss import (
    COMM_LOSS_TEST,
    COMM_LOSS_TEST_DISCARD,
    COMM_LOSS_TEST_READ,
    CommLossTestParams,
)
from drivebus.service.api.operations.drives import DriveParams
from drivebus.service.audit import AuditEntry
from drivebus.service.auth.actor import Actor
from drivebus.service.control.comm_loss_record import CommLossRecord, CommLossResult, record_key
from drivebus.service.control.drive_commands import DriveCommands
from drivebus.service.control.leases import arm_target_of_test
from drivebus.service.control.start_blockers import check_test_start
from drivebus.service.control.tickets import CommandTicket, check_not_superseded
from drivebus.service.live.views import CommLossTestObject
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant
from drivebus.types import Json

CHECK_INTERVAL_S = 0.1  # between two checks of the conditions of the test
TURNING_TIME_S = 3.0  # the motor turns this long before the silence, so that its user sees that it turns
ACCELERATION_TIMEOUT_S = 60.0  # a drive that does not run steadily by then ends the test
OUTPUT_OFF_TIMEOUT_S = 5.0  # a drive whose output is off for this long after its start has stopped by itself
LAST_POLLS_S = 0.5  # polls that were under way when polling ended are answered by then
READ_TIMEOUT_S = 120.0  # time to plug in again an adapter that was pulled for the test
READ_RETRY_INTERVAL_S = 0.5  # between two reads after the silence


@dataclass(slots=True, eq=False)
class ActiveTest:
    """A test that is under way."""

    runtime: DriveRuntime
    actor: Actor
    ticket: CommandTicket
    silence_s: float
    read_now: asyncio.Event
    """Set where the user saw the motor stop: the silence ends early."""


class CommLossTests:
    """Tests under way, at most one for each drive, and their records."""

    def __init__(self, plant: Plant, commands: DriveCommands) -> None:
        self.plant, self.commands = plant, commands
        self._active: dict[str, tuple[ActiveTest, asyncio.Task[None]]] = {}

    # --- operations ---------------------------------------------------------------------------------------------

    @handles(COMM_LOSS_TEST)
    async def start(self, params: CommLossTestParams, actor: Actor, ticket: CommandTicket) -> Json:
        """Start the drive, and the test after it. A missing waiver is the only start blocker that does not count."""
        runtime = self.commands.require_control(params.drive, actor)
        if runtime.comm_loss.test is not None:
            raise ServiceError("plant.comm_loss_testing", drive=runtime.id)
        runtime.comm_loss.test, runtime.comm_loss.no_result = CommLossTestObject("starting", None), None
        try:
            await self._read_parameters(runtime)
            silence_s = params.silence_s or default_silence_s(runtime)
            test = ActiveTest(runtime, actor, ticket, silence_s, asyncio.Event())
            answer = await self._start_drive(test, params)
        except BaseException:
            runtime.comm_loss.test = None
            raise
        task = asyncio.create_task(self._run(test), name=f"communication-loss test {runtime.id}")
        self._active[runtime.id] = test, task
        return answer | {"silence_s": silence_s}

    async def _start_drive(self, test: ActiveTest, params: CommLossTestParams) -> Json:
        """Start the drive, unless it was stopped since the request; stop it where the start fails half-way."""
        runtime, actor = test.runtime, test.actor
        self._check_goes_on(test)
        self._check_testable(runtime)
        runtime.drive.check_frequency(params.frequency_hz)
        self.plant.arm_tokens.consume(params.arm_token, arm_target_of_test(runtime.id), actor, self.plant.now())
        try:
            return await self.commands.start_drive(runtime, params.frequency_hz, None, actor, test.ticket.issued_at)
        except DrivebusError:
            if runtime.started_by_service:
                await self._stop(test)
            raise

    @handles(COMM_LOSS_TEST_READ)
    async def read_now(self, params: DriveParams, actor: Actor) -> Json:
        """End the silence of a test: its user saw the motor stop. Raises ControlNotHeld, ServiceError."""
        runtime = self.commands.require_control(params.drive, actor)
        if runtime.id not in self._active:
            raise ServiceError("plant.comm_loss_no_test", drive=runtime.id)
        self._active[runtime.id][0].read_now.set()
        return {}

    @handles(COMM_LOSS_TEST_DISCARD)
    async def discard(self, params: DriveParams, actor: Actor) -> Json:
        runtime = self.plant.drive_runtime(params.drive)
        await asyncio.to_thread(self.plant.store.put, record_key(runtime.id), "")
        runtime.comm_loss.record = None
        self.plant.publish_event("waiver", runtime.id, "plant.comm_loss_discarded", actor=actor.name)
        return {}

    def _check_testable(self, runtime: DriveRuntime) -> None:
        """Raise the reason why a drive can't be tested now."""
        if not runtime.drive.dialect.reports_run_state:
            raise ServiceError("plant.comm_loss_no_state", drive=runtime.id, model=runtime.profile.model)
        check_test_start(self.plant, runtime)
        if not runtime.status().state.output_off:
            raise ServiceError("plant.comm_loss_not_at_rest", drive=runtime.id)

    async def _read_parameters(self, runtime: DriveRuntime) -> Mapping[str, int]:
        """Read the communication-loss parameters, which may have been changed at the keypad. Raises ServiceError."""
        writes = runtime.comm_loss.write_count
        report = await runtime.drive.comm_loss_behaviour()
        runtime.comm_loss.set_read(report, runtime.profile.comm_loss, self.plant.now(), writes)
        if runtime.comm_loss.present_values is None or report.key == "drives.comm_loss_unread":
            raise ServiceError("plant.comm_loss_parameters_not_read", drive=runtime.id)
        return runtime.comm_loss.present_values

    # --- the test -----------------------------------------------------------------------------------------------

    async def _run(self, test: ActiveTest) -> None:
        """Run one test. Whatever happens, the drive is polled again and stopped; only a conclusive test is recorded."""
        runtime = test.runtime
        try:
            await self._record(test, await self._observe_and_stop(test))
        except DrivebusError as error:
            runtime.comm_loss.no_result = localized("plant.comm_loss_void", {"why": error})
            self.plant.publish_event_text("waiver", runtime.id, runtime.comm_loss.no_result, test.actor.name, None)
        finally:
            runtime.comm_loss.test = None
            self._active.pop(runtime.id, None)

    async def _observe_and_stop(self, test: ActiveTest) -> CommLossRecord:
        try:
            return await self._observe(test)
        finally:
            if self.plant.drives.get(test.runtime.id) is test.runtime and not test.runtime.bus.is_closed:
                test.runtime.start_monitor()
                await self._stop(test)

    async def _stop(self, test: ActiveTest) -> None:
        """Stop the drive, also where it has tripped: the start command of some models would outlive the fault."""
        if self._was_stopped(test):
            return
        self.plant.record_stop_request(test.runtime, by=test.actor.name, kind="test")
        await self.commands.report_stop(test.runtime, test.runtime.drive.stop(), test.actor)

    def _was_stopped(self, test: ActiveTest) -> bool:
        counts = self.plant.stop_counts
        return counts[test.runtime.id] != test.ticket.stop_counts[test.runtime.id]

    async def _observe(self, test: ActiveTest) -> CommLossRecord:
        """Return what the drive did. Raises Superseded, ControlNotHeld; ServiceError where that is not conclusive."""
        runtime = test.runtime
        await self._wait_until_turning(test)
        parameters = await self._read_parameters(runtime)
        runtime.stop_monitor()
        await asyncio.sleep(LAST_POLLS_S)
        silent_since = runtime.bus.health(runtime.config.address).last_reply_at
        if silent_since is None:
            raise ServiceError("plant.comm_loss_not_turning", drive=runtime.id)
        was_whole = await self._keep_silent(test, silent_since)
        runtime.comm_loss.test = CommLossTestObject("reading", None)
        first, status = await self._read(test)
        silence_s = (first.at or silent_since) - silent_since
        result = _result_of(first, status)
        if result is CommLossResult.RUNS_ON and not was_whole:
            raise ServiceError("plant.comm_loss_too_short", drive=runtime.id, seconds=round(silence_s, 1))
        return CommLossRecord(
            result=result,
            silence_s=round(silence_s, 1),
            time_ms=self.plant.wall_ms(),
            user=test.actor.name,
            model=runtime.config.model,
            port=self.plant.bus_of(runtime).config.port,
            address=runtime.config.address,
            parameters=parameters,
            fault=_short_name(status.fault),
        )

    def _check_goes_on(self, test: ActiveTest) -> None:
        """Raise where the drive was stopped or replaced meanwhile, or its user no longer controls it."""
        check_not_superseded(self.plant, test.ticket)
        if test.runtime.id not in self.plant.drives:
            raise Superseded("plant.another_meanwhile", drive=test.runtime.id)
        self.plant.leases.require(test.runtime.id, test.actor, self.plant.now())

    async def _wait_until_turning(self, test: ActiveTest) -> None:
        """Wait until the drive has reported a steady run for a while."""
        runtime, now = test.runtime, self.plant.now
        runtime.comm_loss.test = CommLossTestObject("turning", None)
        steady_since, off_since, timeout = None, None, now() + ACCELERATION_TIMEOUT_S
        while steady_since is None or now() - steady_since < TURNING_TIME_S:
            await asyncio.sleep(CHECK_INTERVAL_S)
            self._check_goes_on(test)
            state = runtime.status().state
            steady_since = None if state is not DriveState.RUNNING else now() if steady_since is None else steady_since
            off_since = None if not state.output_off else now() if off_since is None else off_since
            if off_since is not None and now() - off_since >= OUTPUT_OFF_TIMEOUT_S:
                raise ServiceError("plant.comm_loss_off_before", drive=runtime.id)
            if now() > timeout:
                raise ServiceError("plant.comm_loss_not_turning", drive=runtime.id)

    async def _keep_silent(self, test: ActiveTest, silent_since: float) -> bool:
        """Wait while nothing is sent to the drive; return whether the silence was as long as it should be."""
        runtime, address = test.runtime, test.runtime.config.address
        ends_at = silent_since + test.silence_s
        until_ms = self.plant.wall_ms() + round((ends_at - self.plant.now()) * 1000)
        runtime.comm_loss.test = CommLossTestObject("silent", until_ms)
        sent = runtime.bus.statistics().stations[address].transactions
        while self.plant.now() < ends_at and not test.read_now.is_set():
            await asyncio.sleep(CHECK_INTERVAL_S)
            self._check_goes_on(test)
            if runtime.bus.statistics().stations[address].transactions != sent:
                return False
        return self.plant.now() >= ends_at

    async def _read(self, test: ActiveTest) -> tuple[DriveStatus, DriveStatus]:
        """Return the first status after the silence, and the one after a deceleration has ended."""
        first, deadline = None, self.plant.now() + READ_TIMEOUT_S
        while self.plant.now() < deadline:
            self._check_goes_on(test)
            status = None
            with suppress(DrivebusError):  # the adapter may still be pulled
                status = await test.runtime.drive.status(())
            if status is not None and status.state is not DriveState.UNKNOWN:
                first = first or status
                if status.state is not DriveState.DECELERATING:
                    self._check_goes_on(test)
                    return first, status
            await asyncio.sleep(READ_RETRY_INTERVAL_S)
        raise ServiceError("plant.comm_loss_no_reply", drive=test.runtime.id, seconds=READ_TIMEOUT_S)

    async def _record(self, test: ActiveTest, record: CommLossRecord) -> None:
        """Record a result in the audit trail, then in the settings. Raises AuditUnavailable, ConfigurationError."""
        runtime = test.runtime
        entry = AuditEntry.by(
            test.actor, "comm_loss.result", target=runtime.id, params=record.as_json(), outcome=str(record.result)
        )
        await self.plant.audit.record(entry)
        await asyncio.to_thread(self.plant.store.put, record_key(runtime.id), record.to_json())
        runtime.comm_loss.record = record
        text = localized(record.message_key, record.message_params)
        self.plant.publish_event_text("waiver", runtime.id, text, test.actor.name, str(record.result))

    async def close(self) -> None:
        """End all tests; the stops of an ending service have been sent."""
        tasks = [task for _, task in self._active.values()]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def default_silence_s(runtime: DriveRuntime) -> float:
    """Return the drive's communication-loss time with a margin, or a long time where it can't be read."""
    after_s = runtime.comm_loss.last_read.after_s
    return (after_s or UNKNOWN_COMM_LOSS_S) + COMM_LOSS_MARGIN_S


def _result_of(first: DriveStatus, last: DriveStatus) -> CommLossResult:
    """Return the result from the first status after the silence, and the one after a deceleration."""
    if last.state is DriveState.FAULT:
        return CommLossResult.TRIPS
    stops = last.state.output_off and not first.state.driven
    return CommLossResult.STOPS if stops else CommLossResult.RUNS_ON


def _short_name(fault: Fault | None) -> str | None:
    """Return the label of a fault, else its code; empty where the drive names neither, None without a fault."""
    if fault is None:
        return None
    return fault.label or ("" if fault.code == UNNAMED_FAULT_CODE else str(fault.code))
