"""Operations on one's own account: set-up, login, logout, unlocking, password."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from drivebus.service.api.operations import Audit, Operation, OperationParams
from drivebus.service.api.operations.operation import ApiObject, EmptyResponse, LocalizedText
from drivebus.service.auth.rights import AccessLevel
from drivebus.values import Text

UserName = Annotated[str, Field(min_length=1, max_length=64, examples=["wang"])]
Secret = Annotated[str, Field(min_length=1, max_length=200, examples=["correct horse battery"])]


class LoginParams(OperationParams):
    """A login by password."""

    name: UserName
    password: Secret


class CodeLoginParams(OperationParams):
    """A login by one-time code."""

    code: Annotated[Secret, Field(examples=["7KQ2-M9XD"])]


class SetUpParams(OperationParams):
    """The first administrator, with the set-up secret that the service printed."""

    secret: Secret
    name: UserName
    password: Secret


class UnlockParams(OperationParams):
    """The password of an idle session."""

    password: Secret


class LogoutParams(OperationParams):
    """``all``: end every session of the user."""

    all: bool = Field(default=False, examples=[False])


class PasswordParams(OperationParams):
    """A change of one's own password."""

    old: Secret
    new: Secret


class SessionParams(OperationParams):
    """Session of the user that the operation ends, by its id, and the user's password."""

    session: Annotated[str, Field(min_length=1, max_length=64, examples=["s-5b1f0c52d1aa94e0"])]
    password: Secret


class SessionResponse(ApiObject):
    """User, rights and CSRF token; ``setup`` is true while there is no administrator. A session of a browser also has
    ``role``, ``idle``, ``idle_in_s`` and ``expires_in_s``. ``login_notice`` is the configured text of the login page;
    ``users_missing`` says why a plant that had users can't be set up again, and what to do;
    ``failed_logins`` the number of wrong passwords of the user since the login before; ``ended`` why the session of the
    cookie has ended.
    """

    setup: bool
    users_missing: LocalizedText | None
    user: str | None
    rights: list[str]
    csrf: str | None
    session: str | None = None
    role: str | None = None
    idle: bool | None = None
    idle_in_s: float | None = None
    expires_in_s: float | None = None
    login_notice: LocalizedText | None = None
    failed_logins: int | None = None
    ended: LocalizedText | None = None


class OwnSession(ApiObject):
    """A session of the user who asks; ``current`` is the one that asks."""

    id: str
    address: str
    opened_ms: int
    active_ms: int
    current: bool


class SessionsResponse(ApiObject):
    """Open sessions of the user who asks."""

    sessions: list[OwnSession]


class LogoutResponse(ApiObject):
    """Number of sessions that ended."""

    ended: int


SESSION_GET = Operation(
    name="session.get",
    right=AccessLevel.PUBLIC,
    method="GET",
    path="/session",
    response=SessionResponse,
    summary=Text("User, rights and CSRF token of this session", "本会话的用户、权限和 CSRF 令牌"),
)

SESSION_ACTIVITY = Operation(
    name="session.activity",
    right=AccessLevel.SESSION,
    method="POST",
    path="/session/activity",
    response=SessionResponse,
    summary=Text("Keep the session from becoming idle", "防止会话变为空闲"),
)

UNLOCK = Operation(
    name="unlock",
    right=AccessLevel.SESSION,
    method="POST",
    path="/session/unlock",
    params=UnlockParams,
    response=SessionResponse,
    audit=Audit.SESSION,
    summary=Text("Give an idle session its rights back for the password", "输入密码，恢复空闲会话的权限"),
)

SET_UP = Operation(
    name="set-up",
    right=AccessLevel.PUBLIC,
    method="POST",
    path="/setup",
    params=SetUpParams,
    response=SessionResponse,
    audit=Audit.SESSION,
    summary=Text("Create the first administrator", "创建第一个管理员"),
)

LOGIN = Operation(
    name="login",
    right=AccessLevel.PUBLIC,
    method="POST",
    path="/login",
    params=LoginParams,
    response=SessionResponse,
    audit=Audit.SESSION,
    summary=Text("Log in by password", "用密码登录"),
)

LOGIN_CODE = Operation(
    name="login-code",
    right=AccessLevel.PUBLIC,
    method="POST",
    path="/login/code",
    params=CodeLoginParams,
    response=SessionResponse,
    audit=Audit.SESSION,
    summary=Text("Log in by one-time code", "用一次性代码登录"),
)

LOGOUT = Operation(
    name="logout",
    right=AccessLevel.SESSION,
    method="POST",
    path="/logout",
    params=LogoutParams,
    has_query=True,
    response=LogoutResponse,
    audit=Audit.SESSION,
    summary=Text("End this session, or every session of the user", "结束本会话，或该用户的全部会话"),
)

SESSIONS_LIST = Operation(
    name="sessions.list",
    right=AccessLevel.SESSION,
    method="GET",
    path="/sessions",
    response=SessionsResponse,
    summary=Text("One's own open sessions", "自己的会话"),
)

SESSION_END = Operation(
    name="session.end",
    right=AccessLevel.SESSION,
    method="POST",
    path="/sessions/{session}/end",
    params=SessionParams,
    response=EmptyResponse,
    audit=Audit.SESSION,
    summary=Text("End one of one's own sessions, with the password", "输入密码，结束自己的一个会话"),
)

PASSWORD = Operation(
    name="password",
    right=AccessLevel.SESSION,
    method="POST",
    path="/password",
    params=PasswordParams,
    response=SessionResponse,
    audit=Audit.REQUIRED,
    summary=Text(
        "Change one's own password; every other session of the user ends", "更改自己的密码；该用户的其他会话随之结束"
    ),
)
