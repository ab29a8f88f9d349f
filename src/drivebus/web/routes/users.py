"""Handlers of the operations on users and API tokens."""

from __future__ import annotations

from dataclasses import replace

from starlette.requests import Request

from drivebus.service.api.handlers import handles
from drivebus.service.api.operations.operation import NoParams
from drivebus.service.auth.credentials import SessionCredential
from drivebus.service.auth.errors import AccessDenied, Conflict, InvalidInput
from drivebus.service.auth.names import normalized_name
from drivebus.service.auth.password_policy import check_password_policy
from drivebus.service.auth.rights import Right, Role
from drivebus.service.auth.service import AuthService
from drivebus.service.auth.tokens import new_token
from drivebus.service.auth.users import Token, User, UserDatabase
from drivebus.types import Json
from drivebus.web.context import actor_of, context_of, credential_of
from drivebus.web.operations.users import (
    TOKEN_ADD,
    TOKEN_REMOVE,
    TOKENS_LIST,
    USER_ADD,
    USER_CHANGE,
    USER_REMOVE,
    USERS_LIST,
    NewTokenParams,
    NewUserParams,
    TokenParams,
    UserChangeParams,
    UserParams,
)


@handles(USERS_LIST)
async def list_users(request: Request, params: NoParams) -> Json:
    auth = context_of(request).auth
    return {"users": [_user_json(auth, user) for user in auth.database.users]}


@handles(USER_ADD)
async def add_user(request: Request, params: NewUserParams) -> Json:
    context = context_of(request)

    async def add() -> User:
        if params.role is Role.ADMINISTRATOR:
            await _verify_own_password(request, params.own_password)
        user = await context.auth.new_user(params.name, params.role, params.password)
        await context.auth.change_database(lambda database: database.with_user(user))
        return user

    user = await context.record_change(USER_ADD, params.name, {"role": params.role}, actor_of(request), add())
    return {"user": _user_json(context.auth, user)}


@handles(USER_CHANGE)
async def change_user(request: Request, params: UserChangeParams) -> Json:
    context = context_of(request)
    recorded = params.model_dump(exclude_unset=True, exclude={"user", "password", "own_password"})
    recorded |= {"password": "new"} if params.password is not None else {}

    async def change() -> User:
        role = params.role or context.auth.database.user(params.user).role
        strengthens = params.role is not None or params.password is not None or params.disabled is False
        if role is Role.ADMINISTRATOR and strengthens and normalized_name(params.user) != _user_name(request):
            await _verify_own_password(request, params.own_password)
        return await _change_user(context.auth, params, _user_name(request))

    withdraws = recorded.keys() <= {"disabled", "end_sessions"} and params.disabled is not False
    changed = await context.record_change(
        USER_CHANGE, params.user, recorded, actor_of(request), change(), withdraws=withdraws
    )
    return {"user": _user_json(context.auth, changed)}


@handles(USER_REMOVE)
async def remove_user(request: Request, params: UserParams) -> Json:
    context, user = context_of(request), params.user
    if normalized_name(user) == _user_name(request):
        raise Conflict("auth.oneself")

    async def remove() -> None:
        await context.auth.change_database(lambda database: database.without_user(user))
        await context.auth.end_sessions(user, "removed")

    await context.record_change(USER_REMOVE, user, {}, actor_of(request), remove(), withdraws=True)
    return {}


@handles(TOKENS_LIST)
async def list_tokens(request: Request, params: NoParams) -> Json:
    tokens = context_of(request).auth.database.tokens
    return {"tokens": [_token_json(token) for token in tokens if _may_manage(request, token)]}


@handles(TOKEN_ADD)
async def add_token(request: Request, params: NewTokenParams) -> Json:
    """Create a token with at most the present rights of its user; the secret is shown this once."""
    context, actor = context_of(request), actor_of(request)
    if beyond := set(params.rights) - actor.rights:
        raise AccessDenied("auth.beyond_own", rights=tuple(sorted(beyond)))
    secret, token = new_token(
        name=params.name,
        user=_user_name(request),
        rights=params.rights,
        days=params.days,
        now_ms=context.auth.wall_ms(),
    )
    recorded = {"name": params.name, "rights": list(token.rights), "days": params.days}
    change = context.auth.change_database(lambda database: database.with_token(token))
    await context.record_change(TOKEN_ADD, token.id, recorded, actor, change)
    return {"token": _token_json(token), "secret": secret}


@handles(TOKEN_REMOVE)
async def remove_token(request: Request, params: TokenParams) -> Json:
    """Remove a token; another user's is answered as one that does not exist."""
    context, token = context_of(request), params.token
    database = context.auth.database
    manageable = {each.id for each in database.tokens if _may_manage(request, each)}
    (database if token in manageable else UserDatabase()).without_token(token)
    change = context.auth.change_database(lambda database: database.without_token(token))
    await context.record_change(TOKEN_REMOVE, token, {}, actor_of(request), change, withdraws=True)
    return {}


async def _change_user(auth: AuthService, params: UserChangeParams, own_name: str) -> User:
    """Change only the fields in ``params``, on the database as it is when it is written.

    Raises ResourceNotFound, InvalidInput; Conflict for one's own role and password and for the last administrator.
    """
    user = auth.database.user(params.user)
    if user.name == own_name and (params.role is not None or params.disabled is not None):
        raise Conflict("auth.oneself")
    if user.name == own_name and params.password is not None:
        raise Conflict("auth.own_password")
    changes: Json = {key: value for key in ("role", "disabled") if (value := getattr(params, key)) is not None}
    if params.password is not None:
        changes["password"] = await auth.passwords.hash(check_password_policy(params.password, user.name))
    after = await auth.change_database(
        lambda database: database.with_changed_user(replace(database.user(user.name), **changes))
    )
    changed = after.user(user.name)
    reason = changed.change_since(user.stamp)
    if params.end_sessions or reason is not None:
        await auth.end_sessions(user.name, reason or "ended")
    return changed


async def _verify_own_password(request: Request, own_password: str | None) -> None:
    """Check the password of the user who makes the request: it changes an administrator.

    Raises AccessDenied for a wrong one and for a token, InvalidInput for none, TooManyAttempts, AuthUnavailable.
    """
    credential = credential_of(request)
    if not isinstance(credential, SessionCredential):
        raise AccessDenied("auth.only_session")
    if own_password is None:
        raise InvalidInput("auth.own_password_needed")
    await context_of(request).auth.verify_own_password(credential.session, own_password)


def _user_name(request: Request) -> str:
    credential = credential_of(request)
    return credential.session.user if isinstance(credential, SessionCredential) else credential.token.user


def _may_manage(request: Request, token: Token) -> bool:
    return token.user == _user_name(request) or actor_of(request).may(Right.ADMINISTER)


def _user_json(auth: AuthService, user: User) -> Json:
    return {
        "name": user.name,
        "role": str(user.role),
        "disabled": user.disabled,
        "created_ms": user.created_ms,
        "sessions": len(auth.sessions.of_user(user.name)),
        "tokens": sum(token.user == user.name for token in auth.database.tokens),
    }


def _token_json(token: Token) -> Json:
    return {
        "id": token.id,
        "name": token.name,
        "user": token.user,
        "rights": list(token.rights),
        "created_ms": token.created_ms,
        "expires_ms": token.expires_ms,
    }
