"""A plant that answers as the contract says and counts what it was asked, and an app with nothing but the gateways."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from functools import cache
from typing import Any

import httpx
from fastapi import FastAPI
from pydantic import ValidationError
from starlette.requests import Request

from drivebus.errors import DrivebusError, Forbidden, NotFound
from drivebus.gateways import problems
from drivebus.gateways.rest import openapi
from drivebus.gateways.rest.router import rest_router
from drivebus.plant.access.rights import RIGHTS, Role
from drivebus.plant.actor import Actor
from drivebus.plant.operations import OPERATIONS
from drivebus.plant.params import of_pydantic, refusal

Json = dict[str, Any]
OPERATOR = Actor("li", RIGHTS[Role.OPERATOR], "s-li", address="127.0.0.1")


class Plant:
    """Rights and parameters as the real one; results as they are put into ``results``, else ``{}``."""

    def __init__(self, **results: Any) -> None:
        self.results: dict[str, Any] = results
        self.asked: list[tuple[str, Json, Actor]] = []
        self.records: list[tuple[Json, Actor]] = []
        self.messages: asyncio.Queue[Json] = asyncio.Queue()
        self.frames: asyncio.Queue[Json] = asyncio.Queue()
        """What is told to whoever listens, and what to whoever listens to frames."""
        self.listening: list[tuple[tuple[str, ...], float]] = []

    async def call(self, operation: str, params: Json, actor: Actor) -> Json:
        wanted = OPERATIONS[operation]
        if not actor.may(wanted.right):
            raise Forbidden("plant.no_right", right=wanted.right)
        try:
            wanted.params.model_validate(params)
        except ValidationError as error:
            raise refusal(operation, of_pydantic(error.errors(include_url=False))) from error
        if params.get("drive", "fan-1") != "fan-1":
            raise NotFound("plant.no_drive", drive=params["drive"])
        self.asked.append((operation, params, actor))
        return self._result(operation, params)

    def _result(self, operation: str, params: Json) -> Json:
        found = self.results.get(operation, {})
        if isinstance(found, DrivebusError):
            raise found
        result: Json = found(params) if callable(found) else found
        return result

    async def live(self, patterns: Sequence[str], actor: Actor, interval_s: float = 0.25) -> AsyncIterator[Json]:
        self.listening.append((tuple(patterns), interval_s))
        queue = self.frames if patterns[0].startswith("frames/") else self.messages
        while (message := await queue.get())["type"] != "closed":
            yield message
        yield message

    async def record(self, entry: Json, actor: Actor) -> None:
        self.records.append((entry, actor))


class _Whoever:
    """Stands between one app, which is costly to make, and the plant and actor of each test."""

    plant: Plant
    actor: Actor

    async def call(self, operation: str, params: Json, actor: Actor) -> Json:
        return await self.plant.call(operation, params, actor)

    def live(self, patterns: Sequence[str], actor: Actor, interval_s: float = 0.25) -> AsyncIterator[Json]:
        return self.plant.live(patterns, actor, interval_s)

    async def record(self, entry: Json, actor: Actor) -> None:
        await self.plant.record(entry, actor)


@cache
def _app() -> tuple[FastAPI, _Whoever]:
    whoever = _Whoever()
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url="/api/v1/openapi.json")
    problems.install(app)
    app.include_router(rest_router(whoever))
    openapi.install(app)

    @app.middleware("http")
    async def let_in(request: Request, go_on: Any) -> Any:
        request.state.visitor = whoever
        return await go_on(request)

    return app, whoever


def app_of(plant: Plant, actor: Actor = OPERATOR) -> FastAPI:
    """The REST gateway on a bare app, where everybody is ``actor``."""
    app, whoever = _app()
    whoever.plant, whoever.actor = plant, actor
    return app


def client_of(app: FastAPI) -> httpx.AsyncClient:
    """Speaks to the app without a socket; an error inside is an answer, as it would be to a stranger."""
    transport = httpx.ASGITransport(app=app, raise_app_exceptions=False)
    return httpx.AsyncClient(transport=transport, base_url="http://plant")
