"""Users (administrators only) and API tokens (one's own; administrators everybody's)."""

from __future__ import annotations

import secrets
from dataclasses import replace
from typing import Any

from fastapi import APIRouter
from starlette.requests import Request

from drivebus.gateways.door import actor, visitor
from drivebus.plant.access.access import Access
from drivebus.plant.access.passwords import check_new
from drivebus.plant.access.refusals import Conflict, Forbidden
from drivebus.plant.access.register import Register, Token, User, plain
from drivebus.plant.access.rights import Right
from drivebus.plant.access.sessions import digest
from drivebus.plant.access.visitor import BySession
from drivebus.web import given
from drivebus.web.desk import Desk

Json = dict[str, Any]
_DAY_MS = 86_400_000


def people_router(desk: Desk) -> APIRouter:
    """Under ``/api/v1``."""
    router = APIRouter(prefix="/api/v1", tags=["users and tokens"])
    access = desk.access

    @router.get("/users")
    async def users() -> Json:
        return {"users": [_user_json(access, user) for user in access.register.users]}

    @router.post("/users")
    async def add_user(request: Request, body: given.NewUser) -> Json:
        async def add() -> User:
            user = await access.made(body.name, body.role, body.password)
            await access.change(lambda register: register.added(user))
            return user

        return {
            "user": _user_json(
                access, await desk.change("user.add", body.name, {"role": body.role}, actor(request), add())
            )
        }

    @router.patch("/users/{user}")
    async def change_user(request: Request, user: str, body: given.ChangedUser) -> Json:
        told = body.model_dump(exclude_unset=True, exclude={"password"})
        told |= {"password": "new"} if body.password is not None else {}
        change = _change(access, user, body, _user_of(request))
        return {"user": _user_json(access, await desk.change("user.change", user, told, actor(request), change))}

    @router.delete("/users/{user}")
    async def remove_user(request: Request, user: str) -> Json:
        if plain(user) == _user_of(request):
            raise Conflict("access.oneself")

        async def remove() -> None:
            await access.change(lambda register: register.removed(user))
            await access.end_all(user, "rights")

        await desk.change("user.remove", user, {}, actor(request), remove())
        return {}

    @router.get("/tokens")
    async def tokens(request: Request) -> Json:
        seen = [token for token in access.register.tokens if _may_see(request, token)]
        return {"tokens": [_token_json(token) for token in seen]}

    @router.post("/tokens")
    async def add_token(request: Request, body: given.NewToken) -> Json:
        me = actor(request)
        beyond = set(body.rights) - me.rights
        if beyond:
            raise Forbidden("access.beyond_own", rights=", ".join(sorted(beyond)))
        secret, token = _new_token(access, body, _user_of(request))
        told = {"name": body.name, "rights": list(token.rights), "days": body.days}
        await desk.change("token.add", token.id, told, me, access.change(lambda register: register.with_token(token)))
        return {"token": _token_json(token), "secret": secret}

    @router.delete("/tokens/{token}")
    async def remove_token(request: Request, token: str) -> Json:
        seen = {one.id for one in access.register.tokens if _may_see(request, one)}
        register = access.register if token in seen else Register()
        register.without_token(token)
        change = access.change(lambda register: register.without_token(token))
        await desk.change("token.remove", token, {}, actor(request), change)
        return {}

    return router


async def _change(access: Access, name: str, body: given.ChangedUser, me: str) -> User:
    """Only what ``body`` names: the rest is as it is when it is written, whoever changed that meanwhile.

    Raises NoSuch, Unfit; Conflict for one's own role and for the last administrator.
    """
    user = access.register.user(name)
    if user.name == me and (body.role is not None or body.disabled is not None):
        raise Conflict("access.oneself")
    wanted: Json = {key: value for key in ("role", "disabled") if (value := getattr(body, key)) is not None}
    if body.password is not None:
        wanted["password"] = await access.passwords.hash(check_new(body.password, user.name))
    after = await access.change(lambda register: register.changed(replace(register.user(user.name), **wanted)))
    changed = after.user(user.name)
    if body.end_sessions or changed.stamp != user.stamp:
        await access.end_all(user.name, "rights")
    return changed


def _new_token(access: Access, body: given.NewToken, user: str) -> tuple[str, Token]:
    secret, now_ms = "dbt_" + secrets.token_urlsafe(32), access.wall_ms()
    rights = tuple(sorted(set(body.rights)))
    token = Token(secrets.token_hex(6), body.name, user, rights, digest(secret), now_ms, now_ms + body.days * _DAY_MS)
    return secret, token


def _user_of(request: Request) -> str:
    found = visitor(request)
    return found.session.user if isinstance(found, BySession) else found.token.user


def _may_see(request: Request, token: Token) -> bool:
    return token.user == _user_of(request) or actor(request).may(Right.ADMINISTER)


def _user_json(access: Access, user: User) -> Json:
    return {
        "name": user.name,
        "role": str(user.role),
        "disabled": user.disabled,
        "created_ms": user.created_ms,
        "sessions": len(access.sessions.of(user.name)),
        "tokens": sum(token.user == user.name for token in access.register.tokens),
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
