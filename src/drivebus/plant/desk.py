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
    Forbidden,
    NotFound,
    ParamsError,
    ServiceUnavailable,
)
from drivebus.plant.access.rights import Right
from drivebus.plant.actor import Actor
from drivebus.plant.alarms import Own
from drivebus.plant.audit import Entry
from drivebus.plant.failure import failure, plain, why
from drivebus.plant.operations import OPERATIONS, Operation, Params, Run, SetFrequency, WriteParameters
from drivebus.plant.params import of_pydantic, refusal
from drivebus.plant.parts import Handler
from drivebus.plant.state import Plant
from drivebus.plant.units import Unit
from drivebus.plant.wishes import Motion, Wish, still, wished

Json = dict[str, Any]
OLDEST_S = 2.0
"""A command whose record took so long is another wish (I1); for a start it is the same clock that goes on."""
UNRECORDED = frozenset(
    {
        "drive.set_frequency", "group.set_frequency", "drive.reset", "drive.release", "lease.take", "lease.release",
        "alarm.acknowledge", "alarm.shelve", "alarm.unshelve",
    }
)  # fmt: skip
"""Control goes on where the trail can't be written; starts and changes of settings do not (G14). Stops come before
their record anyway."""
TRAIL = "audit.jsonl"
TARGETS = ("drive", "group", "alarm", "bus")
PATIENCE_S = 1.0
"""Whoever stopped something waits no longer for its record."""


class Desk:
    """Takes requests in."""

    def __init__(self, plant: Plant, handlers: Mapping[str, Handler], motions: Mapping[str, Motion]) -> None:
        self.plant, self._handlers, self._motions = plant, handlers, motions

    async def call(self, name: str, params: Json, actor: Actor) -> Json:
        """Raises whatever speaks against it, or what became of it."""
        operation = OPERATIONS.get(name)
        if operation is None:
            raise NotFound("plant.no_operation", id=name)
        await self._may(operation, operation.right, params, actor)
        parsed = checked(operation, params)
        if isinstance(parsed, WriteParameters) and parsed.save:
            await self._may(operation, Right.SAVE, params, actor)
        self._open_for(operation)
        if name in self._motions:
            return await self._recorded(operation, parsed, actor, self._motions[name])
        handler = self._handlers.get(name)
        if handler is None:
            raise NotFound("plant.no_operation", id=name)
        if operation.stops:
            return await self._stop_first(operation, parsed, actor, handler)
        if operation.changes:
            return await self._recorded(operation, parsed, actor, lambda params, actor, wish: handler(params, actor))
        try:
            return await handler(parsed, actor)
        except ParamsError as error:
            raise refusal(name, error.params["faults"]) from error

    def _open_for(self, operation: Operation) -> None:
        """A plant that ends takes stops only, one that has ended nothing. Raises ServiceUnavailable."""
        starts = operation.changes and not operation.stops
        if self.plant.state == "ended" or (starts and self.plant.state == "stopping"):
            raise ServiceUnavailable("plant.stopping")

    def may_look(self, actor: Actor) -> None:
        """Raises Forbidden."""
        if not actor.may(Right.VIEW):
            raise Forbidden("plant.forbidden", name=actor.name, operation="live", right=Right.VIEW)

    async def _may(self, operation: Operation, right: Right, params: Json, actor: Actor) -> None:
        if actor.may(right):
            return
        error = Forbidden("plant.forbidden", name=actor.name, operation=operation.name, right=right)
        self._note(_entry(operation, params, actor, error.key))
        raise error

    async def _stop_first(self, operation: Operation, params: Params, actor: Actor, handler: Handler) -> Json:
        """A stop goes; it is recorded when it has gone, and nobody waits long for that."""
        entry = _entry(operation, params.model_dump(), actor)
        try:
            found = await handler(params, actor)
        except Exception as error:
            await self._soon(_failed(entry, error))
            raise
        except BaseException as error:
            self._note(_failed(entry, error))
            raise
        await self._soon(_done(entry, found))
        return found

    async def _recorded(self, operation: Operation, params: Params, actor: Actor, handler: Motion) -> Json:
        wish = wished(self.plant, self._concerned(params))
        entry = _entry(operation, params.model_dump(), actor, drives=wish.stops)
        try:
            number = await self._record(replace(entry, outcome="asked"))
        except AuditUnavailable:
            if operation.name not in UNRECORDED:
                self._note(_refused(entry))
                raise
            number = None
        except BaseException as error:  # it may be on the disk all the same
            self._note(_failed(entry, error))
            raise
        entry = replace(entry, of=number)
        try:
            self._still(wish)
            found = await handler(params, actor, wish)
        except Exception as error:
            await self._after(_failed(entry, error))
            raise
        except BaseException as error:  # whoever is cancelled does not wait for a disk
            self._note(_failed(entry, error))
            raise
        await self._after(_done(entry, found))
        return found

    def _still(self, wish: Wish) -> None:
        """While it was recorded nobody has stopped one of its drives, and it has not become another wish."""
        still(self.plant, wish)
        age_s = self.plant.now() - wish.at
        if age_s > OLDEST_S:
            raise Expired("plant.record_too_slow", age_s=round(age_s, 2), limit_s=OLDEST_S)

    def _concerned(self, params: Params) -> list[Unit]:
        """The drives that it does something to: followers get their share of their leader's frequency."""
        drive, group = getattr(params, "drive", None), getattr(params, "group", None)
        drives = [drive] if drive is not None else [] if group is None else self.plant.group(group).drives
        followers = self.plant.followers(params.drive) if isinstance(params, Run | SetFrequency) else ()
        return [*(self.plant.unit(id) for id in drives), *(unit for _, unit in followers)]

    # --- the record -----------------------------------------------------------------------------------------------

    async def record(self, found: Json, actor: Actor) -> None:
        """Something that is no operation: ``what``, ``target``, ``params``, ``outcome``. Raises AuditUnavailable."""
        who = {"who": actor.name, "session": actor.session, "address": actor.address}
        entry = Entry.from_json({**found, **who})
        try:
            await self._record(entry)
        except AuditUnavailable:
            self._note(_refused(entry))
            raise

    async def _record(self, entry: Entry) -> int:
        """Raises AuditUnavailable, after which every start is refused until an entry can be written again: whoever
        calls it notes what comes of it."""
        try:
            number = await self.plant.parts.trail.record(entry)
        except AuditUnavailable as error:
            self.plant.alarm(Own.STORE, about=TRAIL, reason=why(error))
            raise
        self.plant.calm(Own.STORE, about=TRAIL)
        return number

    def _note(self, entry: Entry) -> None:
        self.plant.parts.trail.note(entry)

    async def _after(self, entry: Entry) -> None:
        """What was done is done: a trail that can't be written is an alarm, and is written later; no failure."""
        try:
            await self._record(entry)
        except AuditUnavailable:
            self._note(entry)

    async def _soon(self, entry: Entry) -> None:
        """A disk that hangs keeps nobody from hearing what became of a stop."""
        await asyncio.wait([asyncio.ensure_future(self._after(entry))], timeout=PATIENCE_S)


def checked(operation: Operation, params: Json) -> Params:
    """Raises ParamsError with every fault at once."""
    try:
        return operation.params.model_validate(params)
    except ValidationError as error:
        raise refusal(operation.name, of_pydantic(error.errors(include_url=False))) from error


def _entry(
    operation: Operation, params: Any, actor: Actor, outcome: str | None = None, drives: Iterable[str] = ()
) -> Entry:
    """``drives``: those that it concerns; where they are more than its target they are named."""
    found = plain(params)
    known = found if isinstance(found, dict) else {}
    target = next((known[name] for name in TARGETS if isinstance(known.get(name), str)), "")
    concerned = [id for id in drives if id != target]
    return Entry.by(
        actor, operation.name, target=target, params=known | ({"drives": concerned} if concerned else {}),
        outcome=outcome,
    )  # fmt: skip


def _refused(entry: Entry) -> Entry:
    """It was not done because it could not be recorded."""
    return replace(entry, what="audit.refused", params={"what": entry.what}, frames=(), outcome=None)


def _failed(entry: Entry, error: BaseException) -> Entry:
    """Of an error that nobody foresaw only its class is told: what it left on the wire is not known."""
    if not isinstance(error, DrivebusError):
        return replace(entry, outcome="unknown", params={**entry.params, "error": type(error).__name__})
    told = failure(error)
    return replace(entry, outcome=told["code"], frames=(told["outcome"] or {}).get("frames", ()))


def _done(entry: Entry, found: Json) -> Entry:
    """With the word and the frames of what was done."""
    many = {**found.get("outcomes", {}), **found.get("followers", {})}
    one = found.get("outcome")
    every = [*([one] if one else ()), *many.values()]
    words = dict.fromkeys(str(each.get("word") or each.get("code") or "done") for each in every)
    frames = [frame for each in every for frame in each.get("frames", ())]
    return replace(entry, outcome=", ".join(words) or "done", frames=frames)
