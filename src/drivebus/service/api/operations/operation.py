"""``Operation``: the one declaration of something that the service does for a client.

Routes, authorization, OpenAPI, the reference page, the Python client and the audit policy derive from it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from drivebus.service.auth.rights import Right
from drivebus.types import Json
from drivebus.values import Text

Name = Annotated[str, Field(min_length=1, max_length=100)]
ID_PATTERN = r"^[a-z0-9][a-z0-9_-]{0,63}$"
Id = Annotated[str, Field(pattern=ID_PATTERN)]
DriveId = Annotated[Id, Field(examples=["fan-1"])]
Frequency = Annotated[float, Field(ge=0.0, le=1000.0, allow_inf_nan=False, examples=[25.0])]
Reason = Annotated[str, Field(min_length=3, max_length=500, examples=["bearing is being changed"])]
MAX_TIME_MS = 253_402_300_799_999  # the end of the year 9999 in milliseconds since 1970
TimeMs = Annotated[int, Field(ge=0, le=MAX_TIME_MS)]
Cursor = Annotated[str, Field(max_length=200)]
PageSize = Annotated[int, Field(ge=1, le=1000, examples=[100])]

API_PREFIX = "/api/v1"  # stands before the path of every operation
BODY_METHODS = ("POST", "PUT")  # the others carry their parameters in path and query


class OperationParams(BaseModel):
    """Parameters of an operation: strict types, no unknown names. A field's example works on its own."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class NoParams(OperationParams):
    """Parameters of an operation that takes none."""


class ApiObject(BaseModel):
    """An object in a result. The API promise allows more keys, so nothing is checked or cut on the way out."""

    model_config = ConfigDict(extra="allow")


class LocalizedText(ApiObject):
    """A text in both languages."""

    en: str
    zh: str


class PageResponse(ApiObject):
    """A part of a list; ``next`` is the ``cursor`` of the following part, null at the end. A cursor is opaque."""

    items: list[dict[str, Any]]
    next: str | None


class Audit(StrEnum):
    """When an operation is written into the audit trail."""

    NONE = "none"
    """Never: it changes nothing."""
    REQUIRED = "required"
    """Before and after; where the trail cannot be written, the operation is rejected."""
    BEST_EFFORT = "best_effort"
    """Before and after, but control goes on where the trail cannot be written."""
    AFTER = "after"
    """Only after: a stop waits for no record."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Operation:
    """One operation. Raises ValueError where the declaration contradicts itself."""

    name: str
    right: Right
    method: str
    """HTTP method of its route."""
    path: str
    """Path after ``API_PREFIX``; a name in braces is the parameter of that name."""
    summary: Text
    params: type[OperationParams] = NoParams
    response: type[ApiObject] = ApiObject
    """Model of the result; ``ApiObject`` itself where the reference describes it in words only."""
    audit: Audit = Audit.NONE
    keepalive: bool = False
    """Keeps a lease or a jog from ending: it never waits behind queries."""
    background: bool = False
    """Sent by a page on its own; it does not count as activity of the user."""
    download: bool = False
    """The result is one part of a file; a client of the web gets the whole file."""

    def __post_init__(self) -> None:
        missing = set(self.path_params) - self.params.model_fields.keys()
        if missing:
            raise ValueError(f"{self.name}: {missing} of the path are no parameters")
        if self.mutates and self.method == "GET":
            raise ValueError(f"{self.name}: GET must not change anything")
        if self.is_stop and self.right is not Right.STOP:
            raise ValueError(f"{self.name}: only an operation of the right 'stop' is recorded after it is done")

    @property
    def mutates(self) -> bool:
        """Whether it changes or commands something; it is then audited and never reached by GET."""
        return self.audit is not Audit.NONE

    @property
    def is_stop(self) -> bool:
        """Whether it only takes motion away: nothing is asked or recorded before it."""
        return self.audit is Audit.AFTER

    @property
    def yields(self) -> bool:
        """Whether it waits for its turn on the event loop. Commands and renewals keep the order in which they arrive,
        so that a stop voids every command sent before it.
        """
        return not (self.mutates or self.keepalive)

    @property
    def tag(self) -> str:
        """Section of the API description."""
        return self.path.split("/")[1]

    @property
    def path_params(self) -> tuple[str, ...]:
        """Names of the parameters that stand in the path."""
        return tuple(re.findall(r"{(\w+)}", self.path))

    @property
    def has_body(self) -> bool:
        """Whether parameters outside the path are a JSON body; otherwise they are the query."""
        return self.method in BODY_METHODS

    @property
    def example(self) -> Json:
        """Parameters that work, from the examples of their fields."""
        return {name: field.examples[0] for name, field in self.params.model_fields.items() if field.examples}

    def param_schemas(self) -> Json:
        """JSON schemas of the parameters outside the path, by name."""
        found: Json = self.params.model_json_schema().get("properties", {})
        return {name: schema for name, schema in found.items() if name not in self.path_params}

    def required_params(self) -> list[str]:
        """Names of ``param_schemas`` that must be given."""
        required = self.params.model_json_schema().get("required", [])
        return [name for name in required if name not in self.path_params]
