"""Where every operation comes in: is there such a one, may the actor, are the parameters right; what is done is
recorded before its first frame leaves and after (6.5, G14).
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from pydantic import ValidationError

from drivebus.errors import (
    AuditUnavailable,
    DrivebusError,
    Expired,
    InvalidParameters,
    NotFound,
    PermissionDenied,
    ServiceUnavailable,
)
from drivebus.service.alarms import SystemAlarm
from drivebus.service.api.errors import error_to_json, os_reason, to_plain
from drivebus.service.api.operations import (
    OPERATIONS,
    Operation,
    OperationParams,
    ParameterWriteParams,
    RunParams,
    SetFrequencyParams,
)
from drivebus.service.api.param_errors import params_error, pydantic_faults
from drivebus.service.audit import AuditEntry
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.rights import Right
from drivebus.service.control.tickets import (
    CommandTicket,
    MotionHandler,
    OperationHandler,
    check_not_superseded,
    issue_ticket,
)
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.plant import Plant

Json = dict[str, Any]
MAX_RECORDING_S = 2.0
"""A command whose record took so long is another wish (I1); for a start it is the same clock that goes on."""
AUDIT_BEST_EFFORT = frozenset(
    {
        "drive.set_frequency",
        "group.set_frequency",
        "drive.reset",
        "drive.release",
        "lease.take",
        "lease.release",
        "alarm.acknowledge",
        "alarm.shelve",
        "alarm.unshelve",
    }
)
"""Control goes on where the trail can't be written; starts and changes of settings do not (G14). Stops come before
their record anyway."""
AUDIT_FILE = "audit.jsonl"
TARGET_PARAMS = ("drive", "group", "alarm", "bus")
STOP_AUDIT_TIMEOUT_S = 1.0
"""Whoever stopped something waits no longer for its record."""


class Dispatcher:
    """Takes requests in."""

    def __init__(
        self, plant: Plant, handlers: Mapping[str, OperationHandler], motions: Mapping[str, MotionHandler]
    ) -> None:
        self.plant, self._handlers, self._motions = plant, handlers, motions

    async def call(self, name: str, params: Json, actor: Actor) -> Json:
        """Raises whatever speaks against it, or what became of it."""
        operation = OPERATIONS.get(name)
        if operation is None:
            raise NotFound("plant.no_operation", id=name)
        await self._check_right(operation, operation.right, params, actor)
        parsed = validate_params(operation, params)
        if isinstance(parsed, ParameterWriteParams) and parsed.save:
            await self._check_right(operation, Right.SAVE, params, actor)
        self._check_accepting(operation)
        if name in self._motions:
            return await self._run_recorded(operation, parsed, actor, self._motions[name])
        handler = self._handlers.get(name)
        if handler is None:
            raise NotFound("plant.no_operation", id=name)
        if operation.is_stop:
            return await self._stop_then_record(operation, parsed, actor, handler)
        if operation.mutates:
            return await self._run_recorded(
                operation, parsed, actor, lambda params, actor, wish: handler(params, actor)
            )
        try:
            return await handler(parsed, actor)
        except InvalidParameters as error:
            raise params_error(name, error.params["faults"]) from error

    def _check_accepting(self, operation: Operation) -> None:
        """A plant that ends takes stops only, one that has ended nothing. Raises ServiceUnavailable."""
        starts = operation.mutates and not operation.is_stop
        if self.plant.state == "ended" or (starts and self.plant.state == "stopping"):
            raise ServiceUnavailable("plant.stopping")

    def check_may_view(self, actor: Actor) -> None:
        """Raises Forbidden."""
        if not actor.may(Right.VIEW):
            raise PermissionDenied("plant.forbidden", name=actor.name, operation="live", right=Right.VIEW)

    async def _check_right(self, operation: Operation, right: Right, params: Json, actor: Actor) -> None:
        if actor.may(right):
            return
        error = PermissionDenied("plant.forbidden", name=actor.name, operation=operation.name, right=right)
        self._record_nowait(_audit_entry(operation, params, actor, error.key))
        raise error

    async def _stop_then_record(
        self, operation: Operation, params: OperationParams, actor: Actor, handler: OperationHandler
    ) -> Json:
        """A stop goes; it is recorded when it has gone, and nobody waits long for that."""
        entry = _audit_entry(operation, params.model_dump(), actor)
        try:
            found = await handler(params, actor)
        except Exception as error:
            await self._record_soon(_failed_entry(entry, error))
            raise
        except BaseException as error:
            self._record_nowait(_failed_entry(entry, error))
            raise
        await self._record_soon(_completed_entry(entry, found))
        return found

    async def _run_recorded(
        self, operation: Operation, params: OperationParams, actor: Actor, handler: MotionHandler
    ) -> Json:
        wish = issue_ticket(self.plant, self._affected_drives(params))
        entry = _audit_entry(operation, params.model_dump(), actor, drives=wish.stop_counts)
        try:
            number = await self._record(replace(entry, outcome="asked"))
        except AuditUnavailable:
            if operation.name not in AUDIT_BEST_EFFORT:
                self._record_nowait(_unrecorded_entry(entry))
                raise
            number = None
        except BaseException as error:  # it may be on the disk all the same
            self._record_nowait(_failed_entry(entry, error))
            raise
        entry = replace(entry, of=number)
        try:
            self._check_not_stopped(wish)
            found = await handler(params, actor, wish)
        except Exception as error:
            await self._record_after(_failed_entry(entry, error))
            raise
        except BaseException as error:  # whoever is cancelled does not wait for a disk
            self._record_nowait(_failed_entry(entry, error))
            raise
        await self._record_after(_completed_entry(entry, found))
        return found

    def _check_not_stopped(self, wish: CommandTicket) -> None:
        """While it was recorded nobody has stopped one of its drives, and it has not become another wish."""
        check_not_superseded(self.plant, wish)
        age_s = self.plant.now() - wish.issued_at
        if age_s > MAX_RECORDING_S:
            raise Expired("plant.record_too_slow", age_s=round(age_s, 2), limit_s=MAX_RECORDING_S)

    def _affected_drives(self, params: OperationParams) -> list[DriveRuntime]:
        """The drives that it does something to: followers get their share of their leader's frequency."""
        drive, group = getattr(params, "drive", None), getattr(params, "group", None)
        drives = [drive] if drive is not None else [] if group is None else self.plant.group(group).drives
        followers = self.plant.followers(params.drive) if isinstance(params, RunParams | SetFrequencyParams) else ()
        return [*(self.plant.drive(id) for id in drives), *(unit for _, unit in followers)]

    # --- the record -----------------------------------------------------------------------------------------------

    async def record(self, found: Json, actor: Actor) -> None:
        """Something that is no operation: ``what``, ``target``, ``params``, ``outcome``. Raises AuditUnavailable."""
        who = {"who": actor.name, "session": actor.session, "address": actor.address}
        entry = AuditEntry.from_json({**found, **who})
        try:
            await self._record(entry)
        except AuditUnavailable:
            self._record_nowait(_unrecorded_entry(entry))
            raise

    async def _record(self, entry: AuditEntry) -> int:
        """Raises AuditUnavailable, after which every start is refused until an entry can be written again: whoever
        calls it notes what comes of it."""
        try:
            number = await self.plant.audit.record(entry)
        except AuditUnavailable as error:
            self.plant.raise_alarm(SystemAlarm.STORAGE_FAILURE, subject=AUDIT_FILE, reason=os_reason(error))
            raise
        self.plant.clear_alarm(SystemAlarm.STORAGE_FAILURE, subject=AUDIT_FILE)
        return number

    def _record_nowait(self, entry: AuditEntry) -> None:
        self.plant.audit.record_nowait(entry)

    async def _record_after(self, entry: AuditEntry) -> None:
        """What was done is done: a trail that can't be written is an alarm, and is written later; no failure."""
        try:
            await self._record(entry)
        except AuditUnavailable:
            self._record_nowait(entry)

    async def _record_soon(self, entry: AuditEntry) -> None:
        """A disk that hangs keeps nobody from hearing what became of a stop."""
        await asyncio.wait([asyncio.ensure_future(self._record_after(entry))], timeout=STOP_AUDIT_TIMEOUT_S)


def validate_params(operation: Operation, params: Json) -> OperationParams:
    """Raises InvalidParameters with every fault at once."""
    try:
        return operation.params.model_validate(params)
    except ValidationError as error:
        raise params_error(operation.name, pydantic_faults(error.errors(include_url=False))) from error


def _audit_entry(
    operation: Operation, params: Any, actor: Actor, outcome: str | None = None, drives: Iterable[str] = ()
) -> AuditEntry:
    """``drives``: those that it concerns; where they are more than its target they are named."""
    found = to_plain(params)
    known = found if isinstance(found, dict) else {}
    target = next((known[name] for name in TARGET_PARAMS if isinstance(known.get(name), str)), "")
    concerned = [id for id in drives if id != target]
    return AuditEntry.by(
        actor,
        operation.name,
        target=target,
        params=known | ({"drives": concerned} if concerned else {}),
        outcome=outcome,
    )


def _unrecorded_entry(entry: AuditEntry) -> AuditEntry:
    """It was not done because it could not be recorded."""
    return replace(entry, what="audit.refused", params={"what": entry.what}, frames=(), outcome=None)


def _failed_entry(entry: AuditEntry, error: BaseException) -> AuditEntry:
    """Of an error that nobody foresaw only its class is told: what it left on the wire is not known."""
    if not isinstance(error, DrivebusError):
        return replace(entry, outcome="unknown", params={**entry.params, "error": type(error).__name__})
    told = error_to_json(error)
    return replace(entry, outcome=told["code"], frames=(told["outcome"] or {}).get("frames", ()))


def _completed_entry(entry: AuditEntry, found: Json) -> AuditEntry:
    """With the word and the frames of what was done."""
    many = {**found.get("outcomes", {}), **found.get("followers", {})}
    one = found.get("outcome")
    every = [*([one] if one else ()), *many.values()]
    words = dict.fromkeys(str(each.get("word") or each.get("code") or "done") for each in every)
    frames = [frame for each in every for frame in each.get("frames", ())]
    return replace(entry, outcome=", ".join(words) or "done", frames=frames)
