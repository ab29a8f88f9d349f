"""Users (administrators only) and API tokens (one's own; administrators everybody's)."""

from __future__ import annotations

import secrets
from dataclasses import replace
from typing import Any

from fastapi import APIRouter
from starlette.requests import Request

from drivebus.service.auth.credentials import SessionCredential
from drivebus.service.auth.errors import AccessDenied, Conflict
from drivebus.service.auth.passwords import check_password_policy
from drivebus.service.auth.rights import Right
from drivebus.service.auth.service import AuthService
from drivebus.service.auth.sessions import secret_digest
from drivebus.service.auth.users import Token, User, UserDatabase, normalized_name
from drivebus.web.dependencies import actor_of, credential_of
from drivebus.web.routes import schemas
from drivebus.web.routes.context import RouteContext

Json = dict[str, Any]
_DAY_MS = 86_400_000


def users_router(desk: RouteContext) -> APIRouter:
    """Under ``/api/v1``."""
    router = APIRouter(prefix="/api/v1", tags=["users and tokens"])
    access = desk.access

    @router.get("/users")
    async def users() -> Json:
        return {"users": [_user_json(access, user) for user in access.database.users]}

    @router.post("/users")
    async def add_user(request: Request, body: schemas.NewUserBody) -> Json:
        async def add() -> User:
            user = await access.new_user(body.name, body.role, body.password)
            await access.change(lambda register: register.with_user(user))
            return user

        return {
            "user": _user_json(
                access, await desk.record_change("user.add", body.name, {"role": body.role}, actor_of(request), add())
            )
        }

    @router.patch("/users/{user}")
    async def change_user(request: Request, user: str, body: schemas.UserChangeBody) -> Json:
        told = body.model_dump(exclude_unset=True, exclude={"password"})
        told |= {"password": "new"} if body.password is not None else {}
        change = _change_user(access, user, body, _user_name(request))
        return {
            "user": _user_json(access, await desk.record_change("user.change", user, told, actor_of(request), change))
        }

    @router.delete("/users/{user}")
    async def remove_user(request: Request, user: str) -> Json:
        if normalized_name(user) == _user_name(request):
            raise Conflict("access.oneself")

        async def remove() -> None:
            await access.change(lambda register: register.without_user(user))
            await access.end_sessions(user, "rights")

        await desk.record_change("user.remove", user, {}, actor_of(request), remove())
        return {}

    @router.get("/tokens")
    async def tokens(request: Request) -> Json:
        seen = [token for token in access.database.tokens if _may_manage(request, token)]
        return {"tokens": [_token_json(token) for token in seen]}

    @router.post("/tokens")
    async def add_token(request: Request, body: schemas.NewTokenBody) -> Json:
        me = actor_of(request)
        beyond = set(body.rights) - me.rights
        if beyond:
            raise AccessDenied("access.beyond_own", rights=", ".join(sorted(beyond)))
        secret, token = _new_token(access, body, _user_name(request))
        told = {"name": body.name, "rights": list(token.rights), "days": body.days}
        await desk.record_change(
            "token.add", token.id, told, me, access.change(lambda register: register.with_token(token))
        )
        return {"token": _token_json(token), "secret": secret}

    @router.delete("/tokens/{token}")
    async def remove_token(request: Request, token: str) -> Json:
        seen = {one.id for one in access.database.tokens if _may_manage(request, one)}
        register = access.database if token in seen else UserDatabase()
        register.without_token(token)
        change = access.change(lambda register: register.without_token(token))
        await desk.record_change("token.remove", token, {}, actor_of(request), change)
        return {}

    return router


async def _change_user(access: AuthService, name: str, body: schemas.UserChangeBody, me: str) -> User:
    """Only what ``body`` names: the rest is as it is when it is written, whoever changed that meanwhile.

    Raises ResourceNotFound, Unfit; Conflict for one's own role and for the last administrator.
    """
    user = access.database.user(name)
    if user.name == me and (body.role is not None or body.disabled is not None):
        raise Conflict("access.oneself")
    wanted: Json = {key: value for key in ("role", "disabled") if (value := getattr(body, key)) is not None}
    if body.password is not None:
        wanted["password"] = await access.passwords.hash(check_password_policy(body.password, user.name))
    after = await access.change(
        lambda register: register.with_changed_user(replace(register.user(user.name), **wanted))
    )
    changed = after.user(user.name)
    if body.end_sessions or changed.stamp != user.stamp:
        await access.end_sessions(user.name, "rights")
    return changed


def _new_token(access: AuthService, body: schemas.NewTokenBody, user: str) -> tuple[str, Token]:
    secret, now_ms = "dbt_" + secrets.token_urlsafe(32), access.wall_ms()
    rights = tuple(sorted(set(body.rights)))
    token = Token(
        secrets.token_hex(6), body.name, user, rights, secret_digest(secret), now_ms, now_ms + body.days * _DAY_MS
    )
    return secret, token


def _user_name(request: Request) -> str:
    found = credential_of(request)
    return found.session.user if isinstance(found, SessionCredential) else found.token.user


def _may_manage(request: Request, token: Token) -> bool:
    return token.user == _user_name(request) or actor_of(request).may(Right.ADMINISTER)


def _user_json(access: AuthService, user: User) -> Json:
    return {
        "name": user.name,
        "role": str(user.role),
        "disabled": user.disabled,
        "created_ms": user.created_ms,
        "sessions": len(access.sessions.of_user(user.name)),
        "tokens": sum(token.user == user.name for token in access.database.tokens),
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
