"""Operations on users (administrators only) and on API tokens (one's own; for administrators those of all users)."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from drivebus.service.api.operations import Audit, Operation, OperationParams
from drivebus.service.api.operations.operation import ApiObject, EmptyResponse
from drivebus.service.auth.rights import AccessLevel, Right, Role
from drivebus.values import Text
from drivebus.web.operations.account import Secret, UserName

RoleName = Annotated[Role, Field(strict=False, examples=["operator"])]
RightName = Annotated[Right, Field(strict=False)]


class UserParams(OperationParams):
    """User that the operation acts on."""

    user: UserName


class NewUserParams(OperationParams):
    """A new user. A new administrator needs ``own_password``: that of the one who adds it."""

    name: UserName
    role: RoleName
    password: Secret
    own_password: Secret | None = None


class UserChangeParams(UserParams):
    """A change of a user; a field that is left out stays as it is. Role, password and enabling of an administrator need
    ``own_password``: that of the one who makes the change.
    """

    role: RoleName | None = None
    disabled: bool | None = None
    password: Secret | None = None
    own_password: Secret | None = None
    end_sessions: bool = False


class TokenParams(OperationParams):
    """Token that the operation acts on, by its id."""

    token: Annotated[str, Field(min_length=1, max_length=64, examples=["5b1f0c52d1aa"])]


class NewTokenParams(OperationParams):
    """A new token and its validity in days."""

    name: Annotated[UserName, Field(examples=["report"])]
    rights: Annotated[list[RightName], Field(min_length=1, max_length=len(Right), examples=[["view"]])]
    days: Annotated[int, Field(ge=1, le=366, examples=[90])] = 90


class UserObject(ApiObject):
    """A user with the numbers of sessions and tokens."""

    name: str
    role: str
    disabled: bool
    created_ms: int
    sessions: int
    tokens: int


class UsersResponse(ApiObject):
    """All users."""

    users: list[UserObject]


class UserResponse(ApiObject):
    """User that the operation acts on."""

    user: UserObject


class TokenObject(ApiObject):
    """A token without its secret."""

    id: str
    name: str
    user: str
    rights: list[str]
    created_ms: int
    expires_ms: int


class TokensResponse(ApiObject):
    """Tokens of the user who asks; for administrators those of all users."""

    tokens: list[TokenObject]


class NewTokenResponse(ApiObject):
    """A new token; its secret is shown this once."""

    token: TokenObject
    secret: str


USERS_LIST = Operation(
    name="users.list",
    right=Right.ADMINISTER,
    method="GET",
    path="/users",
    response=UsersResponse,
    summary=Text("All users", "全部用户"),
)

USER_ADD = Operation(
    name="user.add",
    right=Right.ADMINISTER,
    method="POST",
    path="/users",
    params=NewUserParams,
    response=UserResponse,
    audit=Audit.REQUIRED,
    summary=Text("Add a user", "添加用户"),
)

USER_CHANGE = Operation(
    name="user.change",
    right=Right.ADMINISTER,
    method="PATCH",
    path="/users/{user}",
    params=UserChangeParams,
    response=UserResponse,
    audit=Audit.REQUIRED,
    summary=Text("Change a user; other rights end the user's sessions", "更改用户；权限变化时结束其会话"),
)

USER_REMOVE = Operation(
    name="user.remove",
    right=Right.ADMINISTER,
    method="DELETE",
    path="/users/{user}",
    params=UserParams,
    response=EmptyResponse,
    audit=Audit.REQUIRED,
    summary=Text("Remove a user with the user's tokens", "删除用户及其令牌"),
)

TOKENS_LIST = Operation(
    name="tokens.list",
    right=AccessLevel.SESSION,
    method="GET",
    path="/tokens",
    response=TokensResponse,
    summary=Text("One's own tokens; for administrators those of all users", "自己的令牌；管理员可见所有用户的令牌"),
)

TOKEN_ADD = Operation(
    name="token.add",
    right=AccessLevel.SESSION,
    method="POST",
    path="/tokens",
    params=NewTokenParams,
    response=NewTokenResponse,
    audit=Audit.REQUIRED,
    summary=Text("Add a token with at most one's present rights", "添加令牌，权限不超过自己当前的权限"),
)

TOKEN_REMOVE = Operation(
    name="token.remove",
    right=AccessLevel.SESSION,
    method="DELETE",
    path="/tokens/{token}",
    params=TokenParams,
    response=EmptyResponse,
    audit=Audit.REQUIRED,
    summary=Text("Remove a token", "删除令牌"),
)
