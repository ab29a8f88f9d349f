"""Dispatcher of operations: right, parameters, state of the service, audit record, handler.

The checks are made in this order. A command is recorded before its first frame is sent and after it is done. A stop
waits for no record: it is recorded while it is sent, and again after it is done.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

from drivebus.errors import (
    AuditUnavailable,
    DrivebusError,
    Expired,
    InvalidParameters,
    NotFound,
    PermissionDenied,
    ServiceError,
    ServiceUnavailable,
    TooManyCommands,
    before_motion,
)
from drivebus.service.alarms import Alarm
from drivebus.service.api.audit_aggregator import COUNTED, AuditAggregator, RecordKind
from drivebus.service.api.command_records import record, record_or_queue
from drivebus.service.api.errors import error_to_json, params_error, to_plain
from drivebus.service.api.operations import OPERATIONS, Audit, Operation, OperationParams
from drivebus.service.api.operations.alarms import AlarmParams, AlarmSelectionParams
from drivebus.service.api.operations.drives import ParameterWriteParams, RunParams, SetFrequencyParams
from drivebus.service.api.operations.operation import NoParams
from drivebus.service.api.operations.selections import SelectionParams
from drivebus.service.api.record_budget import RecordBudget
from drivebus.service.audit import AuditEntry
from drivebus.service.audit.records import ERROR_TEXT, ERROR_TEXTS, MAX_ERROR_TEXTS, record_octets
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import RequiredAccess, Right
from drivebus.service.control.tickets import (
    CommandTicket,
    MotionHandler,
    OperationHandler,
    check_not_superseded,
    issue_ticket,
)
from drivebus.service.live.views import text_json
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant
from drivebus.types import Json

MAX_RECORDING_S = 2.0  # a command whose audit record took longer is expired
STOP_AUDIT_TIMEOUT_S = 1.0  # a stop never waits longer for its audit record
TARGET_PARAMS = ("drive", "group", "alarm", "bus", "incident")  # the first that is given is the target of the record
MAX_SHORT_OCTETS = 1_000  # the record of a denied or counted request that is longer has only its target


class Dispatcher:
    """Dispatcher of a service. ``handlers``: by the name of their operation."""

    def __init__(self, plant: Plant, handlers: Mapping[str, Callable[..., Awaitable[Json]]]) -> None:
        self.plant, self._handlers = plant, handlers
        self.aggregator = AuditAggregator(self, plant.now)
        self._command_budget, self._stop_budget = RecordBudget(), RecordBudget()
        self._counting: set[asyncio.Task[None]] = set()

    async def call(self, name: str, params: Json, actor: Actor) -> Json:
        """Run an operation and return its result. Raises the reason why it was not done, or how it failed."""
        operation = OPERATIONS.get(name)
        if operation is None:
            raise NotFound("plant.no_operation", id=name)
        await self._check_right(operation, operation.right, params, actor)
        parsed = operation.validate(params)
        if isinstance(parsed, ParameterWriteParams) and parsed.save:
            await self._check_right(operation, Right.SAVE, params, actor)
        self._check_accepting(operation)
        handler = self._handlers.get(name)
        if handler is None:
            raise NotFound("plant.no_operation", id=name)
        if operation.mutates:
            if not (operation.is_stop or operation.reduces_hazard):
                await self._check_budget(operation, params, actor)
            changed = self._changed_drives(parsed)  # before it: an alarm may be gone afterwards
            try:
                return await self._run_command(operation, parsed, actor, handler)
            finally:
                self.plant.record_command(changed)
        try:
            return await handler(parsed, actor)
        except InvalidParameters as error:
            raise params_error(name, error.params["faults"]) from error

    async def _run_command(
        self, operation: Operation, params: OperationParams, actor: Actor, handler: Callable[..., Awaitable[Json]]
    ) -> Json:
        if operation.moves_motors:
            return await self._run_recorded(operation, params, actor, handler)
        if operation.is_stop:
            return await self._stop_and_record(operation, params, actor, handler)
        if operation.reduces_hazard and self._command_budget.wait_s(actor, self.plant.now()) > 0:
            self._count_soon(operation, params, actor)
            return await handler(params, actor)
        return await self._run_recorded(operation, params, actor, lambda params, actor, ticket: handler(params, actor))

    def _check_accepting(self, operation: Operation) -> None:
        """Raise ServiceUnavailable for commands while the service is stopping, for everything once it has ended."""
        starts = operation.mutates and not operation.is_stop
        if self.plant.state == "ended" or (starts and self.plant.state == "stopping"):
            raise ServiceUnavailable("plant.stopping")

    def check_may_view(self, actor: Actor) -> None:
        """Raise PermissionDenied unless the actor may see live values."""
        if not actor.may(Right.VIEW):
            raise PermissionDenied("plant.forbidden", name=actor.name, operation="live", right=Right.VIEW)

    async def _check_right(self, operation: Operation, right: RequiredAccess, params: Json, actor: Actor) -> None:
        if actor.may(right):
            return
        error = PermissionDenied("plant.forbidden", name=actor.name, operation=operation.name, right=right)
        await self._record_denial(operation, params, actor, error.key)
        raise error

    async def _check_budget(self, operation: Operation, params: Json, actor: Actor) -> None:
        """Raise TooManyCommands while the actor's commands that sent nothing have used up their part of the trail."""
        try:
            self._command_budget.check(actor, self.plant.now())
        except TooManyCommands as error:
            await self._record_denial(operation, params, actor, error.key)
            raise

    async def _record_denial(self, operation: Operation, params: Json, actor: Actor, reason: str) -> None:
        """Record a denied request, or count it where one of its kind has just been recorded."""
        if await self.aggregator.count(RecordKind.of("refused", f"{operation.method} {operation.path}", reason, actor)):
            self._record_nowait(_short_entry(operation, params, actor, reason))

    async def _stop_and_record(
        self, operation: Operation, params: OperationParams, actor: Actor, handler: OperationHandler
    ) -> Json:
        """Stop, record the request meanwhile, then the outcome.

        No frame waits for a record; the client waits at most ``STOP_AUDIT_TIMEOUT_S`` for that of the outcome.
        """
        if self._stop_budget.wait_s(actor, self.plant.now()) > 0:
            self._count_soon(operation, params, actor)
            return await handler(params, actor)
        entry = _audit_entry(operation, params.model_dump(), actor)
        # A task begins when the handler waits for the first time. The frame of a single drive is queued by then; those
        # of several drives are queued by tasks that begin after this one has queued the entry for the writer's thread.
        requested = asyncio.ensure_future(record_or_queue(self.plant, replace(entry, outcome="requested")))
        try:
            result = await handler(params, actor)
        except Exception as error:
            failed = self._charge(self._stop_budget, actor, _failed_entry(entry, error))
            await self._record_soon(failed, requested, params)
            raise
        except BaseException as error:
            requested.cancel()  # where it has not begun: it would follow its outcome
            self._record_nowait(_failed_entry(entry, error))
            raise
        completed = self._charge(self._stop_budget, actor, _completed_entry(entry, result))
        await self._record_soon(completed, requested, params)
        return result

    def _count_soon(self, operation: Operation, params: OperationParams, actor: Actor) -> None:
        """Count a command of an actor whose commands have used up their part of the trail; it waits for nothing.

        One that names a drive or group that the plant does not have counts as a denied request.
        """
        entry = _short_entry(operation, params.model_dump(), actor, "requested")

        async def count() -> None:
            try:
                self._affected_drives(params)
            except ServiceError as error:
                await self._record_denial(operation, params.model_dump(), actor, error.key)
                return
            if await self.aggregator.count(RecordKind.of(entry.what, entry.target, COUNTED, actor)):
                self._record_nowait(entry)

        task = asyncio.ensure_future(count())
        self._counting.add(task)
        task.add_done_callback(self._counting.discard)

    async def _run_recorded(
        self, operation: Operation, params: OperationParams, actor: Actor, handler: MotionHandler
    ) -> Json:
        ticket = issue_ticket(self.plant, self._affected_drives(params), actor)
        alarms = self._affected_alarms(params)
        recorded_params = params.model_dump() | _alarm_names(alarms)
        if isinstance(params, AlarmSelectionParams):  # not the names that a client invents
            recorded_params["alarms"] = list(dict.fromkeys(alarm.id for alarm in alarms))
        drives = dict.fromkeys(alarm.drive for alarm in alarms if alarm.drive) if alarms else ticket.stop_counts
        entry = _audit_entry(operation, recorded_params, actor, drives=drives)
        try:
            number = await record(self.plant, replace(entry, outcome="requested"))
        except AuditUnavailable:
            if operation.audit is Audit.REQUIRED:
                self._record_nowait(self._charge_unsent(actor, _unrecorded_entry(entry)))
                raise
            number = None
        except BaseException as error:  # the record may have reached the disk
            self._record_nowait(_failed_entry(entry, error))
            raise
        entry = replace(entry, of=number)
        try:
            with before_motion():
                self._check_ticket(ticket)
            result = await handler(params, actor, ticket)
        except Exception as error:
            await record_or_queue(self.plant, self._charge_unsent(actor, _failed_entry(entry, error)))
            raise
        except BaseException as error:  # a cancelled task must not wait for a disk
            self._record_nowait(self._charge_unsent(actor, _failed_entry(entry, error)))
            raise
        await record_or_queue(self.plant, self._charge_unsent(actor, _completed_entry(entry, result)))
        return result

    def _check_ticket(self, ticket: CommandTicket) -> None:
        """Raise Superseded for a ticket that is no longer valid, Expired after a record that took too long."""
        check_not_superseded(self.plant, ticket)
        age_s = self.plant.now() - ticket.issued_at
        if age_s > MAX_RECORDING_S:
            raise Expired("plant.record_too_slow", age_s=round(age_s, 2), limit_s=MAX_RECORDING_S)

    def _affected_drives(self, params: OperationParams) -> list[DriveRuntime]:
        """Return the drives that a command affects: with a leader its followers, which get a share of its frequency."""
        if isinstance(params, SelectionParams):
            return self.plant.selected(params.drives, params.group, everything=params.all)
        drive, group = getattr(params, "drive", None), getattr(params, "group", None)
        drives = [drive] if drive is not None else [] if group is None else self.plant.group(group).drives
        followers = self.plant.followers(params.drive) if isinstance(params, RunParams | SetFrequencyParams) else ()
        return [*(self.plant.drive_runtime(id) for id in drives), *(follower for _, follower in followers)]

    def _changed_drives(self, params: OperationParams) -> set[str]:
        """Return the drives whose views a command may have changed, members of their groups included; empty: any."""
        try:
            named = {drive.id for drive in self._affected_drives(params)}
        except ServiceError:
            return set()
        named.update(alarm.drive for alarm in self._affected_alarms(params) if alarm.drive)
        return named.union(*(group.drives for drive in named for group in self.plant.groups_of(drive)))

    def _affected_alarms(self, params: OperationParams) -> list[Alarm]:
        """Return the active alarms that a command affects."""
        single = [params.alarm] if isinstance(params, AlarmParams) else []
        ids = params.alarms if isinstance(params, AlarmSelectionParams) else single
        return [alarm for id in ids if (alarm := self.plant.alarms.find(id)) is not None]

    # --- audit records ---------------------------------------------------------------------------------------------

    async def record(self, event: Json, actor: Actor) -> None:
        """Record an event that is no operation: ``what``, ``target``, ``params``, ``outcome``.

        Raises AuditUnavailable; what has happened is written later then, and a request is recorded as refused.
        """
        entry = AuditEntry.from_json(event, actor)
        try:
            await record(self.plant, entry)
        except AuditUnavailable:
            self._record_nowait(_unrecorded_entry(entry) if entry.outcome == "requested" else entry)
            raise

    def _record_nowait(self, entry: AuditEntry) -> None:
        self.plant.audit.record_nowait(entry)

    def _charge(self, budget: RecordBudget, actor: Actor, entry: AuditEntry) -> AuditEntry:
        """Charge the records of a command to the actor's budget; return the entry of its outcome."""
        budget.charge(actor, entry, self.plant.now())
        return entry

    def _charge_unsent(self, actor: Actor, entry: AuditEntry) -> AuditEntry:
        """Charge a command of which no frame was sent; the records of the others are limited by the speed of a bus."""
        return entry if entry.frames else self._charge(self._command_budget, actor, entry)

    async def _record_soon(self, entry: AuditEntry, requested: Awaitable[int | None], params: OperationParams) -> None:
        """Write the entry of a stop after that of its request; a disk that hangs does not delay its result."""

        async def write() -> None:
            number = await requested
            for runtime in self._stopped_drives(params):
                if runtime.drive.stop_pending:
                    runtime.stop_record = number
            await record_or_queue(self.plant, replace(entry, of=number))

        await asyncio.wait([asyncio.ensure_future(write())], timeout=STOP_AUDIT_TIMEOUT_S)

    def _stopped_drives(self, params: OperationParams) -> Collection[DriveRuntime]:
        """Return the drives that a stop affects; none where it names one that the plant does not have."""
        if isinstance(params, NoParams):
            return self.plant.drives.values()
        with suppress(ServiceError):
            return self._affected_drives(params)
        return ()


def _audit_entry(
    operation: Operation, params: Any, actor: Actor, outcome: str | None = None, drives: Iterable[str] = ()
) -> AuditEntry:
    """Return the entry of a command. ``drives`` that it affects are a parameter of it where they are not its target."""
    plain = to_plain(params)
    known = plain if isinstance(plain, dict) else {}
    target = next((known[name] for name in TARGET_PARAMS if isinstance(known.get(name), str)), "")
    others = [drive for drive in drives if drive != target]
    return AuditEntry.by(
        actor,
        operation.name,
        target=target,
        params=known | ({"drives": others} if others else {}),
        outcome=outcome,
    )


def _short_entry(operation: Operation, params: Any, actor: Actor, outcome: str) -> AuditEntry:
    """Return the entry of a request that is denied or counted, with its parameters where they are short."""
    entry = _audit_entry(operation, params, actor, outcome)
    if record_octets(entry) <= MAX_SHORT_OCTETS:
        return entry
    return replace(entry, target=entry.target[:100], params={})


def _alarm_names(alarms: Sequence[Alarm]) -> Json:
    """Return parameters of the audit record of alarms: their title where all have the same, and what no drive names."""
    titles = {alarm.title for alarm in alarms}
    subjects = [*dict.fromkeys(alarm.subject for alarm in alarms if alarm.subject and not alarm.drive)]
    return ({"alarm_title": text_json(titles.pop())} if len(titles) == 1 else {}) | (
        {"alarm_subjects": subjects} if subjects else {}
    )


def _unrecorded_entry(entry: AuditEntry) -> AuditEntry:
    """Return the entry of a command that was not done because it could not be recorded."""
    return replace(entry, what="audit.refused", params={"what": entry.what}, frames=(), outcome=None)


def _failed_entry(entry: AuditEntry, error: BaseException) -> AuditEntry:
    """Return the entry with the error and its sentence; after an unexpected one the sent frames are not known."""
    if not isinstance(error, DrivebusError):
        return replace(entry, outcome="unknown", params={**entry.params, "error": type(error).__name__})
    failure = error_to_json(error)
    return replace(
        entry,
        outcome=failure["code"],
        params={**entry.params, ERROR_TEXT: failure["text"]},
        frames=(failure["outcome"] or {}).get("frames", ()),
    )


def _completed_entry(entry: AuditEntry, result: Json) -> AuditEntry:
    """Return the entry with the statuses and frames of its outcomes, and with the status of each of several drives."""
    by_drive = {**result.get("outcomes", {}), **result.get("followers", {})}
    outcome = result.get("outcome")
    outcomes = [*([outcome] if outcome else ()), *by_drive.values()]
    statuses = {drive: _status_of(item) for drive, item in by_drive.items()}
    more = {"outcomes": statuses, ERROR_TEXTS: _error_texts(by_drive)} if statuses else {}
    return replace(
        entry,
        outcome=", ".join(dict.fromkeys(map(_status_of, outcomes))) or "done",
        params={**entry.params, **{name: values for name, values in more.items() if values}},
        frames=[frame for item in outcomes for frame in item.get("frames", ())],
    )


def _error_texts(by_drive: Json) -> Json:
    """Return the sentence of each drive's error; of one that an earlier drive has too, the id of that drive."""
    by_code: dict[str, Json] = {}
    found: Json = {}
    for drive, item in by_drive.items():
        if "status" in item or "text" not in item:
            continue
        texts = by_code.setdefault(_status_of(item), {})
        first = next((first for first, text in texts.items() if text == item["text"]), None)
        if first is not None:
            found[drive] = first
        elif len(texts) < MAX_ERROR_TEXTS:
            found[drive] = texts[drive] = item["text"]
    return found


def _status_of(item: Json) -> str:
    return str(item.get("status") or item.get("code") or "done")
