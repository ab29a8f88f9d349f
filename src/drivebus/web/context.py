"""``WebContext``: the objects that every route of one app works with, and how a route reaches them."""

from __future__ import annotations

from collections.abc import Coroutine
from dataclasses import dataclass, field
from typing import Any, TypeVar, cast

from starlette.requests import HTTPConnection

from drivebus.errors import DrivebusError, TooManyCommands
from drivebus.service.api.audit_aggregator import COUNTED, AuditAggregator, RecordKind, try_record
from drivebus.service.api.operations import Operation
from drivebus.service.api.record_budget import RecordBudget
from drivebus.service.audit import AuditEntry
from drivebus.service.auth.actor import Actor
from drivebus.service.auth.credentials import Credential
from drivebus.service.auth.errors import AuthUnavailable
from drivebus.service.auth.names import MAX_NAME_LENGTH
from drivebus.service.auth.service import AuthService
from drivebus.service.ipc.service_client import ServiceClient
from drivebus.types import Json
from drivebus.values import Text
from drivebus.web.loop_pauses import LoopPauses
from drivebus.web.service_health import ServiceHealth

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class WebContext:
    """Users and sessions, the client of the service, the aggregator of audit records, and pauses of this process."""

    auth: AuthService
    client: ServiceClient
    aggregator: AuditAggregator
    health: ServiceHealth
    pauses: LoopPauses
    budget: RecordBudget = field(default_factory=RecordBudget)
    """Limit of the records of changes of accounts; a viewer can change the own password and tokens, too."""
    login_notice: Text | None = None

    async def record_change(
        self,
        operation: Operation,
        target: str,
        params: Json,
        actor: Actor,
        change: Coroutine[Any, Any, T],
        *,
        withdraws: bool = False,
    ) -> T:
        """Run the ``change`` of an operation with an audit record before and after it.

        A change that only ``withdraws`` access is counted where there are too many of the actor, and never refused.
        Raises AuthUnavailable, and changes nothing, where the trail cannot be written; TooManyCommands.
        """
        what, now = operation.name, self.auth.clock()
        if withdraws and self.budget.wait_s(actor, now) > 0:
            if await self.aggregator.count(RecordKind.of(what, target[:MAX_NAME_LENGTH], COUNTED, actor)):
                await try_record(self.client, audit_entry(what, target[:MAX_NAME_LENGTH], outcome="requested"), actor)
            return await change
        try:
            self.budget.check(actor, now)
        except TooManyCommands as error:
            change.close()
            await self.aggregator.record_denial(operation.method, operation.path, error.key, actor)
            raise
        requested = audit_entry(what, target, params, outcome="requested")
        self.budget.charge(actor, AuditEntry.from_json(requested, actor), now)
        if not await try_record(self.client, requested, actor):
            change.close()
            raise AuthUnavailable("auth.no_record")
        try:
            result = await change
        except DrivebusError as error:
            await try_record(self.client, audit_entry(what, target, params, outcome=error.key), actor)
            raise
        await try_record(self.client, audit_entry(what, target, params, outcome="done"), actor)
        return result


def audit_entry(what: str, target: str, params: Json | None = None, *, outcome: str) -> Json:
    """Return an entry for the audit trail; its parameters must hold no secret."""
    return {"what": what, "target": target, "params": params or {}, "outcome": outcome}


def context_of(connection: HTTPConnection) -> WebContext:
    """Return the context of the app that serves ``connection``."""
    return cast(WebContext, connection.app.state.context)


def client_of(connection: HTTPConnection) -> ServiceClient:
    """Return the client of the service."""
    return context_of(connection).client


def credential_of(connection: HTTPConnection) -> Credential:
    """Return the credential that the middleware accepted for this route.

    On a long connection read its ``actor`` for each message: rights may shrink meanwhile.
    """
    return cast(Credential, connection.state.credential)


def actor_of(connection: HTTPConnection) -> Actor:
    """Return the actor with its present rights."""
    return credential_of(connection).actor
