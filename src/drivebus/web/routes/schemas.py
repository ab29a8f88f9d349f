"""What the routes of this room take: strict, nothing unknown (S08)."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from drivebus.service.auth.rights import Right, Role

Name = Annotated[str, Field(min_length=1, max_length=64)]
Secret = Annotated[str, Field(min_length=1, max_length=200)]


class RequestBody(BaseModel):
    """A body."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class EmptyBody(RequestBody):
    """An empty object, or no body at all."""


class LoginBody(RequestBody):
    name: Name
    password: Secret


class CodeLoginBody(RequestBody):
    code: Secret


class SetupBody(RequestBody):
    secret: Secret
    name: Name
    password: Secret


class UnlockBody(RequestBody):
    password: Secret


class PasswordBody(RequestBody):
    old: Secret
    new: Secret


class NewUserBody(RequestBody):
    name: Name
    role: Role
    password: Secret


class UserChangeBody(RequestBody):
    """What is left out stays."""

    role: Role | None = None
    disabled: Annotated[bool, Field(strict=True)] | None = None
    password: Secret | None = None
    end_sessions: Annotated[bool, Field(strict=True)] = False


def whole_number(found: object) -> object:
    """JSON has one kind of number: 30.0 days are 30."""
    return int(found) if isinstance(found, float) and found.is_integer() else found


class NewTokenBody(RequestBody):
    name: Name
    rights: Annotated[list[Right], Field(min_length=1, max_length=len(Right))]
    days: Annotated[int, Field(strict=True, ge=1, le=366), BeforeValidator(whole_number)] = 90
