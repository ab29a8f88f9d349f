"""Where every operation comes in: is there such a one, may the actor, are the parameters right; what is done is
recorded before its first frame leaves and after (6.5, G14).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from drivebus.errors import AuditUnavailable, DrivebusError, Expired, Forbidden, NotFound, ParamsError, Superseded
from drivebus.plant.access.rights import Right
from drivebus.plant.actor import Actor
from drivebus.plant.alarms import Own
from drivebus.plant.failure import failure, plain
from drivebus.plant.operations import OPERATIONS, Operation, Params, WriteParameters
from drivebus.plant.parts import Handler
from drivebus.plant.state import Plant
from drivebus.plant.units import Unit

Json = dict[str, Any]
OLDEST_S = 2.0
"""A command whose record took so long is another wish (I1)."""
UNRECORDED = frozenset(
    {
        "drive.set_frequency", "group.set_frequency", "drive.reset", "drive.release", "drive.jog_end", "lease.take",
        "lease.release", "alarm.acknowledge", "alarm.shelve", "alarm.unshelve",
    }
)  # fmt: skip
"""Control goes on where the trail can't be written; starts and changes of settings do not (G14)."""


class Desk:
    """Takes requests in."""

    def __init__(self, plant: Plant, handlers: Mapping[str, Handler]) -> None:
        self.plant, self._handlers = plant, handlers

    async def call(self, name: str, params: Json, actor: Actor) -> Json:
        """Raises whatever speaks against it, or what became of it."""
        operation = OPERATIONS.get(name)
        if operation is None:
            raise NotFound("plant.no_operation", id=name)
        await self._may(operation, operation.right, params, actor)
        parsed = checked(operation, params)
        if isinstance(parsed, WriteParameters) and parsed.save:
            await self._may(operation, Right.SAVE, params, actor)
        handler = self._handlers.get(name)
        if handler is None:
            raise NotFound("plant.no_operation", id=name)
        if operation.right is Right.STOP:
            return await self._stop_first(operation, parsed, actor, handler)
        if operation.changes:
            return await self._recorded(operation, parsed, actor, handler)
        return await handler(parsed, actor)

    def may_look(self, actor: Actor) -> None:
        """Raises Forbidden."""
        if not actor.may(Right.VIEW):
            raise Forbidden("plant.forbidden", name=actor.name, operation="live", right=str(Right.VIEW))

    async def _may(self, operation: Operation, right: Right, params: Json, actor: Actor) -> None:
        if actor.may(right):
            return
        error = Forbidden("plant.forbidden", name=actor.name, operation=operation.name, right=str(right))
        await self._after(operation, params, actor, error.key, [])
        raise error

    async def _stop_first(self, operation: Operation, params: Params, actor: Actor, handler: Handler) -> Json:
        """A stop goes; it is recorded when it has gone, if it can be."""
        try:
            found = await handler(params, actor)
        except DrivebusError as error:
            await self._failed(operation, params, actor, error)
            raise
        await self._after(operation, params.model_dump(), actor, *_ended(found))
        return found

    async def _recorded(self, operation: Operation, params: Params, actor: Actor, handler: Handler) -> Json:
        wished_at, stops = self.plant.now(), self._stops(params)
        try:
            await self.record(_entry(operation, params.model_dump(), "asked", []), actor)
        except AuditUnavailable:
            if operation.name not in UNRECORDED:
                raise
        try:
            self._still(params, wished_at, stops)
            found = await handler(params, actor)
        except DrivebusError as error:
            await self._failed(operation, params, actor, error)
            raise
        await self._after(operation, params.model_dump(), actor, *_ended(found))
        return found

    def _still(self, params: Params, wished_at: float, stops: int) -> None:
        """While it was recorded nobody has stopped the drive, and it has not become another wish."""
        if self._stops(params) != stops:
            raise Superseded("plant.stopped_meanwhile", drive=getattr(params, "drive", getattr(params, "group", "")))
        age_s = self.plant.now() - wished_at
        if age_s > OLDEST_S:
            raise Expired("plant.record_too_slow", age_s=round(age_s, 2), limit_s=OLDEST_S)

    def _stops(self, params: Params) -> int:
        return sum(unit.stops for unit in self._concerned(params))

    def _concerned(self, params: Params) -> list[Unit]:
        drive, group = getattr(params, "drive", None), getattr(params, "group", None)
        drives = [drive] if drive is not None else [] if group is None else self.plant.group(group).drives
        return [self.plant.unit(id) for id in drives]

    # --- the record -----------------------------------------------------------------------------------------------

    async def record(self, entry: Json, actor: Actor) -> None:
        """Raises AuditUnavailable, after which every start is refused until an entry can be written again."""
        who = {"who": actor.name, "session": actor.session, "address": actor.address}
        try:
            await self.plant.parts.trail.write(who | entry)
        except AuditUnavailable as error:
            self.plant.alarm(Own.STORE, about="audit.jsonl", reason=error)
            raise
        self.plant.calm(Own.STORE, about="audit.jsonl")

    async def _failed(self, operation: Operation, params: Params, actor: Actor, error: DrivebusError) -> None:
        told = failure(error)
        frames = (told["outcome"] or {}).get("frames", [])
        await self._after(operation, params.model_dump(), actor, told["code"], frames)

    async def _after(self, operation: Operation, params: Json, actor: Actor, outcome: str, frames: list[Json]) -> None:
        """What became of it. What was done is done: a trail that can't be written is an alarm, not a failure."""
        try:
            await self.record(_entry(operation, params, outcome, frames), actor)
        except AuditUnavailable:
            return


def checked(operation: Operation, params: Json) -> Params:
    """Raises ParamsError with every fault at once."""
    try:
        return operation.params.model_validate(params)
    except ValidationError as error:
        faults = [
            {"path": ".".join(map(str, one["loc"])), "found": _short(one["input"]), "expected": one["msg"]}
            for one in error.errors(include_url=False, include_context=False)
        ]
        text = "; ".join(f"{fault['path']}: {fault['expected']}" for fault in faults)
        raise ParamsError("plant.params", operation=operation.name, problems=text, faults=faults) from error


def _short(value: Any) -> str:
    return repr(value)[:200]


def _entry(operation: Operation, params: Any, outcome: str, frames: list[Json]) -> Json:
    found = plain(params)
    target = found.get("drive") or found.get("group") or found.get("alarm") if isinstance(found, dict) else None
    return {"what": operation.name, "target": target, "params": found, "frames": frames, "outcome": outcome}


def _ended(found: Json) -> tuple[str, list[Json]]:
    """The word and the frames of what was done."""
    one = found.get("outcome")
    if one is not None:
        return one["word"], one["frames"]
    many = found.get("outcomes")
    if many is None:
        return "done", []
    words = sorted({each.get("word") or each.get("code") for each in many.values()})
    return ", ".join(words), [frame for each in many.values() for frame in each.get("frames", [])]
