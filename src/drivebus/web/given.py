"""What the routes of this room take: strict, nothing unknown (S08)."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from drivebus.plant.access.rights import Right, Role

Name = Annotated[str, Field(min_length=1, max_length=64)]
Secret = Annotated[str, Field(min_length=1, max_length=200)]


class Given(BaseModel):
    """A body."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Nothing(Given):
    """An empty object, or no body at all."""


class Login(Given):
    name: Name
    password: Secret


class LoginOnce(Given):
    code: Secret


class SetUp(Given):
    secret: Secret
    name: Name
    password: Secret


class Wake(Given):
    password: Secret


class NewPassword(Given):
    old: Secret
    new: Secret


class NewUser(Given):
    name: Name
    role: Role
    password: Secret


class ChangedUser(Given):
    """What is left out stays."""

    role: Role | None = None
    disabled: Annotated[bool, Field(strict=True)] | None = None
    password: Secret | None = None
    end_sessions: Annotated[bool, Field(strict=True)] = False


def whole(found: object) -> object:
    """JSON has one kind of number: 30.0 days are 30."""
    return int(found) if isinstance(found, float) and found.is_integer() else found


class NewToken(Given):
    name: Name
    rights: Annotated[list[Right], Field(min_length=1, max_length=len(Right))]
    days: Annotated[int, Field(strict=True, ge=1, le=366), BeforeValidator(whole)] = 90
