"""``ServiceClient``: how everything that is not the plant speaks to it, in the same process or over its socket."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from typing import Any, Protocol

from drivebus.service.auth.actor import Actor

Json = dict[str, Any]


class ServiceClient(Protocol):
    """The plant, seen from outside."""

    async def call(self, operation: str, params: Json, actor: Actor) -> Json:
        """Do one of ``plant.operations``.

        Raises ServiceError: no such operation or thing, wrong parameters, no right, not now, and all that the drive's
        own errors say.
        """
        ...

    def live(self, patterns: Sequence[str], actor: Actor, interval_s: float = 0.25) -> AsyncIterator[Json]:
        """A ``snapshot`` first, then ``delta``s, then ``closed`` with a reason; topics by pattern (``drives/*``).

        ``interval_s``: at most one delta in that time, 0.1 to 10 s; on the wire ``{"live": [...], "interval_s": 0.1}``.
        """
        ...

    async def record(self, entry: Json, actor: Actor) -> None:
        """Put something into the audit trail that is no operation: a login, a refusal at the door."""
        ...
