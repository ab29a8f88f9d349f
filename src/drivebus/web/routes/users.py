"""Routes of users (administrators only) and of API tokens (one's own; for administrators those of all users)."""

from __future__ import annotations

import secrets
from dataclasses import replace

from starlette.requests import Request

from drivebus.service.api.operations import API_PREFIX
from drivebus.service.auth.credentials import SessionCredential
from drivebus.service.auth.errors import AccessDenied, Conflict
from drivebus.service.auth.passwords import check_password_policy
from drivebus.service.auth.rights import Right
from drivebus.service.auth.service import AuthService
from drivebus.service.auth.sessions import secret_digest
from drivebus.service.auth.users import Token, User, UserDatabase, normalized_name
from drivebus.types import Json
from drivebus.web.context import actor_of, context_of, credential_of
from drivebus.web.route import AccessLevel, AccessRouter
from drivebus.web.routes.schemas import NewTokenBody, NewUserBody, UserChangeBody, body_schema, parse_body

DAY_MS = 86_400_000

router = AccessRouter(API_PREFIX, tags=["users and tokens"])


@router.route("GET", "/users", access=Right.ADMINISTER)
async def list_users(request: Request) -> Json:
    auth = context_of(request).auth
    return {"users": [_user_json(auth, user) for user in auth.database.users]}


@router.route("POST", "/users", access=Right.ADMINISTER, openapi_extra=body_schema(NewUserBody))
async def add_user(request: Request) -> Json:
    context, body = context_of(request), parse_body(request, NewUserBody)

    async def add() -> User:
        user = await context.auth.new_user(body.name, body.role, body.password)
        await context.auth.change(lambda database: database.with_user(user))
        return user

    user = await context.record_change("user.add", body.name, {"role": body.role}, actor_of(request), add())
    return {"user": _user_json(context.auth, user)}


@router.route("PATCH", "/users/{user}", access=Right.ADMINISTER, openapi_extra=body_schema(UserChangeBody))
async def change_user(request: Request, user: str) -> Json:
    context, body = context_of(request), parse_body(request, UserChangeBody)
    recorded = body.model_dump(exclude_unset=True, exclude={"password"})
    recorded |= {"password": "new"} if body.password is not None else {}
    change = _change_user(context.auth, user, body, _user_name(request))
    changed = await context.record_change("user.change", user, recorded, actor_of(request), change)
    return {"user": _user_json(context.auth, changed)}


@router.route("DELETE", "/users/{user}", access=Right.ADMINISTER)
async def remove_user(request: Request, user: str) -> Json:
    context = context_of(request)
    if normalized_name(user) == _user_name(request):
        raise Conflict("auth.oneself")

    async def remove() -> None:
        await context.auth.change(lambda database: database.without_user(user))
        await context.auth.end_sessions(user, "rights")

    await context.record_change("user.remove", user, {}, actor_of(request), remove())
    return {}


@router.route("GET", "/tokens", access=AccessLevel.SESSION)
async def list_tokens(request: Request) -> Json:
    tokens = context_of(request).auth.database.tokens
    return {"tokens": [_token_json(token) for token in tokens if _may_manage(request, token)]}


@router.route("POST", "/tokens", access=AccessLevel.SESSION, openapi_extra=body_schema(NewTokenBody))
async def add_token(request: Request) -> Json:
    """Create a token with at most the present rights of its user; the secret is shown this once."""
    context, actor, body = context_of(request), actor_of(request), parse_body(request, NewTokenBody)
    if beyond := set(body.rights) - actor.rights:
        raise AccessDenied("auth.beyond_own", rights=", ".join(sorted(beyond)))
    secret, token = _new_token(context.auth, body, _user_name(request))
    recorded = {"name": body.name, "rights": list(token.rights), "days": body.days}
    change = context.auth.change(lambda database: database.with_token(token))
    await context.record_change("token.add", token.id, recorded, actor, change)
    return {"token": _token_json(token), "secret": secret}


@router.route("DELETE", "/tokens/{token}", access=AccessLevel.SESSION)
async def remove_token(request: Request, token: str) -> Json:
    """Remove a token; another user's is answered as one that does not exist."""
    context = context_of(request)
    database = context.auth.database
    manageable = {one.id for one in database.tokens if _may_manage(request, one)}
    (database if token in manageable else UserDatabase()).without_token(token)
    change = context.auth.change(lambda database: database.without_token(token))
    await context.record_change("token.remove", token, {}, actor_of(request), change)
    return {}


async def _change_user(auth: AuthService, name: str, body: UserChangeBody, own_name: str) -> User:
    """Change only the fields in ``body``, on the database as it is when it is written.

    Raises ResourceNotFound, InvalidInput; Conflict for one's own role and for the last administrator.
    """
    user = auth.database.user(name)
    if user.name == own_name and (body.role is not None or body.disabled is not None):
        raise Conflict("auth.oneself")
    changes: Json = {key: value for key in ("role", "disabled") if (value := getattr(body, key)) is not None}
    if body.password is not None:
        changes["password"] = await auth.passwords.hash(check_password_policy(body.password, user.name))
    after = await auth.change(lambda database: database.with_changed_user(replace(database.user(user.name), **changes)))
    changed = after.user(user.name)
    if body.end_sessions or changed.stamp != user.stamp:
        await auth.end_sessions(user.name, "rights")
    return changed


def _new_token(auth: AuthService, body: NewTokenBody, user: str) -> tuple[str, Token]:
    secret, now_ms = "dbt_" + secrets.token_urlsafe(32), auth.wall_ms()
    rights = tuple(sorted(set(body.rights)))
    expires_ms = now_ms + body.days * DAY_MS
    return secret, Token(secrets.token_hex(6), body.name, user, rights, secret_digest(secret), now_ms, expires_ms)


def _user_name(request: Request) -> str:
    found = credential_of(request)
    return found.session.user if isinstance(found, SessionCredential) else found.token.user


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
