"""Request bodies of the routes for sessions, users and tokens: no unknown names, no numbers in strings."""

from __future__ import annotations

from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.requests import Request

from drivebus.service.api.errors import params_error, pydantic_faults
from drivebus.service.auth.rights import Right, Role
from drivebus.types import Json

Name = Annotated[str, Field(min_length=1, max_length=64)]
Secret = Annotated[str, Field(min_length=1, max_length=200)]


class RequestBody(BaseModel):
    """A JSON object in a request."""

    model_config = ConfigDict(extra="forbid", frozen=True)


Body = TypeVar("Body", bound=RequestBody)


class LoginBody(RequestBody):
    """A login by password."""

    name: Name
    password: Secret


class CodeLoginBody(RequestBody):
    """A login by one-time code."""

    code: Secret


class SetupBody(RequestBody):
    """The first administrator, with the set-up secret that the service printed."""

    secret: Secret
    name: Name
    password: Secret


class UnlockBody(RequestBody):
    """The password of an idle session."""

    password: Secret


class PasswordBody(RequestBody):
    """A change of one's own password."""

    old: Secret
    new: Secret


class NewUserBody(RequestBody):
    """A new user."""

    name: Name
    role: Role
    password: Secret


class UserChangeBody(RequestBody):
    """A change of a user; a field that is left out stays as it is."""

    role: Role | None = None
    disabled: Annotated[bool, Field(strict=True)] | None = None
    password: Secret | None = None
    end_sessions: Annotated[bool, Field(strict=True)] = False


class NewTokenBody(RequestBody):
    """A new token and its validity in days."""

    name: Name
    rights: Annotated[list[Right], Field(min_length=1, max_length=len(Right))]
    days: Annotated[int, Field(strict=True, ge=1, le=366)] = 90


def parse_body(request: Request, model: type[Body]) -> Body:
    """Return the body of a request as ``model``. Raises InvalidParameters with every fault."""
    try:
        return model.model_validate(request.state.body)
    except ValidationError as error:
        faults = pydantic_faults(error.errors(include_url=False))
        raise params_error(request.url.path, faults) from error


def body_schema(model: type[RequestBody]) -> Json:
    """Return FastAPI's ``openapi_extra`` for a route with this body."""
    schema = model.model_json_schema()
    definitions = schema.pop("$defs", {})
    content = {"application/json": {"schema": _inlined(schema, definitions)}}
    return {"requestBody": {"content": content, "required": bool(schema.get("required"))}}


def _inlined(value: Any, definitions: Json) -> Any:
    """Replace references by what they refer to: definitions of a body are not part of the whole description."""
    if isinstance(value, list):
        return [_inlined(one, definitions) for one in value]
    if not isinstance(value, dict):
        return value
    if "$ref" in value:
        return definitions[value["$ref"].rpartition("/")[2]]
    return {name: _inlined(one, definitions) for name, one in value.items()}
