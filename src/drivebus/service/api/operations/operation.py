"""``Operation``: the one declaration of something that the service does for a client.

Routes, authorization, OpenAPI, the reference page, the Python client, the exceptions for a stop and the audit policy
derive from it. Its handler is bound to it by ``drivebus.service.api.handlers.handles``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from itertools import islice
from types import ModuleType
from typing import Annotated, Any, Generic, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import PydanticCustomError

from drivebus.clock import MAX_TIME_MS
from drivebus.control_characters import CONTROL_CHARACTERS, CONTROL_RANGES, INVISIBLE_RANGES, is_blank
from drivebus.service.api.errors import params_error, pydantic_faults
from drivebus.service.auth.rights import RequiredAccess, Right
from drivebus.service.ids import Id
from drivebus.types import Json
from drivebus.values import Text


def require_printable(text: str) -> str:
    """Return the text. Raises PydanticCustomError for control or direction characters, or for one that is blank."""
    if CONTROL_CHARACTERS.search(text) or is_blank(text):
        raise PydanticCustomError("printable", "control characters, or blank")
    return text


PRINTABLE_PATTERN = rf"^[^{CONTROL_RANGES}]*[^\s{CONTROL_RANGES}{INVISIBLE_RANGES}][^{CONTROL_RANGES}]*$"
Name = Annotated[
    str,
    Field(min_length=1, max_length=100, json_schema_extra={"pattern": PRINTABLE_PATTERN}),
    AfterValidator(require_printable),
]
IssuedId = Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[A-Za-z0-9_-]+$")]
"""Id that the service has made, as of an alarm: a client's own words in its place would stand in the audit trail."""
DriveId = Annotated[Id, Field(examples=["fan-1"])]
Frequency = Annotated[float, Field(ge=0.0, le=1000.0, allow_inf_nan=False, examples=[25.0])]


Reason = Annotated[
    str,
    Field(
        min_length=3,
        max_length=500,
        examples=["bearing is being changed"],
        json_schema_extra={"pattern": PRINTABLE_PATTERN},
    ),
    AfterValidator(require_printable),
]
TimeMs = Annotated[int, Field(ge=0, le=MAX_TIME_MS)]
Cursor = Annotated[str, Field(max_length=200)]
PageSize = Annotated[int, Field(ge=1, le=1000, examples=[100])]

MAX_FAULTS = 100
"""Wrong parameters that one error names: a request of 1 MiB can have 100,000, whose sentences take ten seconds."""
API_PREFIX = "/api/v1"  # stands before the path of every operation
BODY_METHODS = ("POST", "PUT", "PATCH")  # the others carry their parameters in path and query


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


class EmptyResponse(ApiObject):
    """An empty object: it was done."""


Item = TypeVar("Item", bound=ApiObject)


class PageResponse(ApiObject, Generic[Item]):
    """A part of a list; ``next`` is the ``cursor`` of the following part, null at the end. A cursor is opaque."""

    items: list[Item]
    next: str | None


class Audit(StrEnum):
    """Audit policy of an operation: when it is written into the audit trail."""

    NONE = "none"
    """Never: it changes nothing."""
    REQUIRED = "required"
    """Before and after; where the trail cannot be written, the operation is refused."""
    BEST_EFFORT = "best_effort"
    """Before and after, but control goes on where the trail cannot be written."""
    MEANWHILE = "meanwhile"
    """While it is sent, and after: a stop waits for no record."""
    SESSION = "session"
    """After, with its result: it opens or ends a session, also where the trail cannot be written."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Operation:
    """Operation of the API. Raises ValueError where the declaration contradicts itself."""

    name: str
    right: RequiredAccess
    method: str
    """HTTP method of its route."""
    path: str
    """Path after ``prefix``; a name in braces is the parameter of that name."""
    summary: Text
    prefix: str = API_PREFIX
    """Start of its path; empty where programs expect the path at the root of the server."""
    params: type[OperationParams] = NoParams
    has_query: bool = False
    """Parameters outside the path are the query although the method has a body."""
    response: type[ApiObject] | None = None
    """Model of the result, None where ``media_types`` describe it."""
    audit: Audit = Audit.NONE
    keepalive: bool = False
    """Keeps a lease or a jog from ending: it never waits behind queries."""
    background: bool = False
    """Sent by a page on its own; it does not count as activity of the user."""
    media_types: tuple[str, ...] = ()
    """Media types of a result that is a text or a file instead of JSON."""
    reduces_hazard: bool = False
    """It gives up control or a waiver, or acknowledges an alarm: too many of them are counted and never refused."""
    moves_motors: bool = False
    """Its handler gets the command ticket as well, by which it sends nothing that a later stop has voided."""
    cancellable: bool = False
    """It takes long and ends when its client disconnects. Everything else is done, even when its client is gone."""

    def __post_init__(self) -> None:
        missing = set(self.path_params) - self.params.model_fields.keys()
        if missing:
            raise ValueError(f"{self.name}: {missing} of the path are no parameters")
        if (self.response is None) != bool(self.media_types):
            raise ValueError(f"{self.name}: either a response model or media types describe its result")
        if self.mutates and self.method == "GET":
            raise ValueError(f"{self.name}: GET must not change anything")
        if self.mutates and self.cancellable:
            raise ValueError(f"{self.name}: a command is not cancelled by a client that disconnects")
        if self.is_stop and self.right is not Right.STOP:
            raise ValueError(f"{self.name}: only an operation of the right 'stop' is sent without its record")
        if self.audit is Audit.SESSION and isinstance(self.right, Right):
            raise ValueError(f"{self.name}: an operation that needs a right is recorded before it is done")
        if self.moves_motors and (self.is_stop or not self.mutates):
            raise ValueError(f"{self.name}: a motion is recorded before it begins")

    @property
    def mutates(self) -> bool:
        """Whether it changes or commands something; it is then audited and never reached by GET."""
        return self.audit is not Audit.NONE

    @property
    def is_stop(self) -> bool:
        """Whether it only ends motion: it needs no lease, and nothing is recorded before it."""
        return self.audit is Audit.MEANWHILE

    @property
    def yields(self) -> bool:
        """Whether it waits for its turn on the event loop.

        Commands and renewals keep the order in which they arrive, so that a stop voids every command sent before it.
        """
        return not (self.mutates or self.keepalive)

    @property
    def url_path(self) -> str:
        """Path of its route, with the prefix."""
        return self.prefix + self.path

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
        return self.method in BODY_METHODS and not self.has_query

    @property
    def example(self) -> Json:
        """Parameters that work, from the examples of their fields."""
        return {name: field.examples[0] for name, field in self.params.model_fields.items() if field.examples}

    def validate(self, params: Json) -> OperationParams:
        """Return the parameters as the model. Raises InvalidParameters with the first ``MAX_FAULTS`` faults."""
        fields = self.params.model_fields
        unknown = islice((name for name in params if name not in fields), MAX_FAULTS)
        try:
            return self.params.model_validate({name: params[name] for name in (*(fields & params.keys()), *unknown)})
        except ValidationError as error:
            faults = error.errors(include_url=False)[:MAX_FAULTS]
            raise params_error(self.name, pydantic_faults(faults, params)) from error

    def all_param_schemas(self) -> Json:
        """Return the JSON schemas of the parameters, by name, without references. They must not be changed."""
        return _param_schemas(self.params)

    def param_schemas(self) -> Json:
        """Return the JSON schemas of the parameters outside the path, by name."""
        return {name: schema for name, schema in self.all_param_schemas().items() if name not in self.path_params}

    def required_params(self) -> list[str]:
        """Return the names of ``param_schemas`` that must be given."""
        required = self.params.model_json_schema().get("required", [])
        return [name for name in required if name not in self.path_params]


@cache  # every request with a query needs them
def _param_schemas(params: type[BaseModel]) -> Json:
    schema = params.model_json_schema()
    schemas: Json = _without_references(schema.get("properties", {}), schema.get("$defs", {}))
    return schemas


def _without_references(value: Any, definitions: Json) -> Any:
    """Replace the references of a JSON schema by what they refer to."""
    if isinstance(value, list):
        return [_without_references(item, definitions) for item in value]
    if not isinstance(value, dict):
        return value
    if "$ref" in value:
        return definitions[value["$ref"].rpartition("/")[2]] | {
            name: item for name, item in value.items() if name != "$ref"
        }
    return {name: _without_references(item, definitions) for name, item in value.items()}


def collect_operations(*modules: ModuleType) -> dict[str, Operation]:
    """Return the operations that modules declare, by name. Raises ValueError for a name or route declared twice."""
    operations = [value for module in modules for value in vars(module).values() if isinstance(value, Operation)]
    by_name = {operation.name: operation for operation in operations}
    if not len(operations) == len(by_name) == len({(operation.method, operation.path) for operation in operations}):
        raise ValueError("an operation is declared twice")
    return by_name
