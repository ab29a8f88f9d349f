"""``ServiceClient``: the service as every client sees it, in the same process or over its socket."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from functools import cached_property
from typing import Protocol

from drivebus.service.auth.actor import Actor
from drivebus.types import Json


class ServiceErrorReply(Exception):
    """An error that the service answered, as the JSON text that it sent."""

    def __init__(self, payload: bytes) -> None:
        super().__init__(payload.decode(errors="replace"))
        self.payload = payload

    @property
    def kind(self) -> str:
        """Name of the error's class."""
        return str(self._error["kind"])

    @property
    def params(self) -> Json:
        """Parameters of the error's sentence."""
        params: Json = self._error.get("params", {})
        return params

    @cached_property
    def _error(self) -> Json:
        error: Json = json.loads(self.payload)
        return error


class ServiceClient(Protocol):
    """Operations, live values and audit records of one service."""

    async def call(self, operation: str, params: Json, actor: Actor) -> Json:
        """Run an operation and return its result.

        Raises ServiceError (unknown operation or object, wrong parameters, missing right, wrong state) and the errors
        of the drive.
        """
        ...

    async def call_json(self, operation: str, params: Json, actor: Actor) -> bytes:
        """Run an operation and return its result as JSON text, for a client that only forwards it.

        Raises ServiceErrorReply with the error as the service sent it, or what ``call`` raises.
        """
        ...

    def live(self, stream: str, actor: Actor) -> AsyncIterator[Json]:
        """Yield the messages of a live stream: ``state`` (every topic but frames) or ``frames/<bus>``.

        A ``snapshot`` comes first, then an ``update`` whenever something changed and at least once a second, last
        ``closed`` with a reason. Messages hold ``time_ms``, whole ``topics`` (new items, where a topic is a list), and
        where there are any ``removed`` topics and the number of items ``missed`` of lists.
        """
        ...

    async def record(self, entry: Json, actor: Actor) -> None:
        """Write an event into the audit trail that is no operation: a login, a denied request."""
        ...

    async def end_control(self, reason: str, actor: Actor) -> None:
        """End the control of a session or token that has ended, or lost the right to it, and record its drives.

        ``reason``: as ``Credential.end_reason``.
        """
        ...
