"""A browser for all tests of the page, and a whole plant behind it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import peers
from fixtures.browser import Stage, log_in, staged

ALLOWED_NOISE = (
    "ERR_CONNECTION_REFUSED",
    "ERR_CONNECTION_RESET",
    "ERR_EMPTY_RESPONSE",
    "ERR_FAILED",
    "401 (Unauthorized)",
    "403 (Forbidden)",
    "503 (Service Unavailable)",
    "500 (Internal Server Error)",  # a server that is ended cuts a request off when its patience is over
    "WebSocket connection",
)
"""What the browser itself says when a server, a session or an answer is gone: the tests take them away."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Last of all: the browser's driver keeps a loop running in the main thread, in which no other loop may run."""
    items.sort(key=lambda item: "browser" in getattr(item, "fixturenames", ()))


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Debian's Chromium. Its very first start may fail: once more."""
    program = peers.need_program("chromium", "chromium")
    peers.need_module("playwright")
    from playwright.sync_api import Error, sync_playwright

    with sync_playwright() as driver:

        def launch() -> Any:
            return driver.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])

        try:
            found = launch()
        except Error:
            found = launch()
        yield found
        found.close()


@pytest.fixture(scope="session")
def plant(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    """One plant for all: starting it takes a second."""
    with staged(tmp_path_factory.mktemp("plant")) as stage:
        yield stage


@pytest.fixture
def stage(plant: Stage) -> Stage:
    """As it was at the beginning."""
    plant.calm()
    return plant


Visit = Callable[..., Any]


@pytest.fixture
def visit(browser: Any, stage: Stage) -> Iterator[Visit]:
    """``visit("#/fleet", language="zh", role="engineer")`` gives a logged-in page; no error of its scripts is lost."""
    contexts, wrong = [], []

    def go(
        way: str = "#/fleet",
        *,
        language: str = "en",
        theme: str = "light",
        role: str | None = "engineer",
        size: tuple[int, int] = (1280, 900),
        **more: Any,
    ) -> Any:
        locale = {"en": "en-GB", "zh": "zh-CN"}[language]
        viewport = {"width": size[0], "height": size[1]}
        context = browser.new_context(viewport=viewport, color_scheme=theme, locale=locale, **more)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(15_000)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda text: _note(text, wrong))
        page.goto(f"{stage.at}/{way}")
        if role is not None:
            log_in(page, role)
        return page

    yield go
    for context in contexts:
        context.close()
    assert wrong == []


def _note(said: Any, wrong: list[str]) -> None:
    if said.type == "error" and not any(noise in said.text for noise in ALLOWED_NOISE):
        wrong.append(said.text)


@pytest.fixture(scope="session")
def static() -> Path:
    import drivebus.web

    return Path(drivebus.web.__file__).parent / "static"
