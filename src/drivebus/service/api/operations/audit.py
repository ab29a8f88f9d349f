"""Operations on the audit trail: its records, and the verification that it is complete."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from drivebus.service.api.operations.history import TimeRangeParams
from drivebus.service.api.operations.operation import (
    ApiObject,
    LocalizedText,
    Operation,
    PageResponse,
)
from drivebus.service.api.operations.outcomes import ExchangeObject
from drivebus.service.auth.rights import Right
from drivebus.values import Text


class AuditActorObject(ApiObject):
    """User of a record, with the session and the address of the client."""

    name: str
    session: str
    address: str | None


class AuditRecordObject(ApiObject):
    """A record with its sentences. ``of``: number of the record of the request whose outcome this is."""

    n: int
    time_ms: int
    who: AuditActorObject
    what: str
    target: str | None
    params: dict[str, Any]
    frames: list[ExchangeObject]
    outcome: str | None
    of: int | None
    hash: str
    text: LocalizedText
    outcome_text: LocalizedText | None


class AuditProblemObject(ApiObject):
    """A deviation; ``line`` 0 stands for the whole file. Its other members depend on its ``kind``."""

    kind: str
    file: str
    line: int
    text: LocalizedText


class AuditVerificationResponse(ApiObject):
    """Result of a verification of the audit trail."""

    ok: bool
    entries: int
    checkpoints: int
    keyed: bool = Field(description="the key was there, so that forged checkpoints are found")
    covered: int = Field(description="last record before a checkpoint; later ones can be cut off undetected")
    head: int | None = Field(description="newest checkpoint; without it removed checkpoints are not found")
    found: int = Field(description="number of all problems")
    problems: list[AuditProblemObject] = Field(description="the first of them")


AUDIT_LIST = Operation(
    name="audit.list",
    right=Right.AUDIT,
    method="GET",
    path="/audit",
    params=TimeRangeParams,
    response=PageResponse[AuditRecordObject],
    summary=Text("The audit trail", "审计记录"),
)

AUDIT_VERIFY = Operation(
    name="audit.verify",
    right=Right.AUDIT,
    method="GET",
    path="/audit/verify",
    response=AuditVerificationResponse,
    cancellable=True,
    summary=Text("Verify that the audit trail is complete", "检查审计记录是否完整"),
)
