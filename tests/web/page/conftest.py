"""Fixtures of the page's tests: a browser, and a whole plant behind it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

import peers
from drivebus.drives import monitor, permissives
from fixtures.browser import Stage, log_in_by_request, staged, wait_until_live
from fixtures.browser_actions import expecting

ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--in-process-gpu", "--renderer-process-limit=1"]
"""Without a graphics card; few processes, because starting one for each test takes a third of the processor's time."""

ALLOWED_NOISE = (
    "ERR_CONNECTION_REFUSED",
    "ERR_CONNECTION_RESET",
    "ERR_EMPTY_RESPONSE",
    "ERR_FAILED",
    "401 (Unauthorized)",
    "403 (Forbidden)",
    "422 (Unprocessable Entity)",  # the reload of a file with errors
    "503 (Service Unavailable)",
    "500 (Internal Server Error)",  # a server that ends aborts a request after its timeout
    "504 (Gateway Timeout)",  # a stop that is not confirmed in its time
    "WebSocket connection",
)
"""Messages of the browser itself about a lost server, session or answer, which the tests provoke."""


MAX_READING_AGE_S = 20.0
"""Age up to which a reading is valid here and permits a start, since a busy machine may delay polls.

The limits that it replaces are tested in ``drives/test_on_simulated_drives.py`` and ``drives/test_permissives.py``.
"""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run these tests last, because the browser's driver keeps an event loop running in the main thread."""
    items.sort(key=lambda item: "browser" in getattr(item, "fixturenames", ()))


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Start Debian's Chromium without a window, a second time where its first start fails."""
    program = peers.need_program("chromium-headless-shell", "chromium-headless-shell")
    peers.need_module("playwright")
    from playwright.sync_api import Error, sync_playwright

    with sync_playwright() as driver:

        def launch() -> Any:
            return driver.chromium.launch(executable_path=program, args=ARGUMENTS)

        try:
            found = launch()
        except Error:
            found = launch()
        yield found
        found.close()


@pytest.fixture(scope="module")
def scripts(browser: Any, plant: Stage) -> Iterator[Any]:
    """Open the page's origin without a login, to import its modules."""
    context = browser.new_context()
    page = context.new_page()
    page.goto(plant.at)
    page.locator("input[name=password]").wait_for()  # its texts are loaded
    yield page
    context.close()


@pytest.fixture(scope="session")
def plant(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    """Start one plant for all tests, because that takes a second."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(monitor, "MIN_READING_VALIDITY_S", MAX_READING_AGE_S)
        patch.setattr(permissives, "MAX_STATUS_AGE_S", MAX_READING_AGE_S)
        with staged(tmp_path_factory.mktemp("plant")) as stage:
            yield stage


@pytest.fixture
def stage(plant: Stage) -> Stage:
    """Return the plant in its initial state."""
    plant.reset()
    return plant


@pytest.fixture
def expect() -> Any:
    """Return Playwright's ``expect`` with the timeout of these tests."""
    return expecting()


Visit = Callable[..., Any]


DEFAULT_SIZE = (1280, 900)


class BrowserContexts:
    """Contexts of one browser by their options, kept for all tests: each loads the files of the page only once.

    Each keeps a document without scripts open, and with it the process that draws the pages of the next tests.
    """

    def __init__(self, browser: Any, origin: str) -> None:
        self._browser = browser
        self._origin = origin
        self._unused: dict[str, list[Any]] = {}

    def _new_context(self, options: dict[str, Any]) -> Any:
        width, height = DEFAULT_SIZE
        context = self._browser.new_context(viewport={"width": width, "height": height}, **options)
        context.new_page().goto(f"{self._origin}/static/js/lib.js")
        return context

    @contextmanager
    def open_page(self, **options: Any) -> Iterator[Any]:
        """Open a page in a context that has no other page with scripts, no cookie and nothing in its local storage."""
        unused = self._unused.setdefault(repr(sorted(options.items())), [])
        context = unused.pop() if unused else self._new_context(options)
        kept = context.pages
        page = context.new_page()
        devtools = context.new_cdp_session(page)
        devtools.send("Storage.clearDataForOrigin", {"origin": self._origin, "storageTypes": "local_storage"})
        devtools.detach()
        yield page
        for opened in context.pages:
            if opened not in kept:
                opened.close()
        context.clear_cookies()
        unused.append(context)


@pytest.fixture(scope="session")
def contexts(browser: Any, plant: Stage) -> BrowserContexts:
    return BrowserContexts(browser, plant.at)


@pytest.fixture
def visit(contexts: BrowserContexts, stage: Stage) -> Iterator[Visit]:
    """Return a function that opens a logged-in page, ``visit("#/fleet", language="zh", role="engineer")``.

    The test fails on any error of the page's scripts.
    """
    errors: list[str] = []
    with ExitStack() as used:

        def go(
            way: str = "#/fleet",
            *,
            language: str = "en",
            theme: str = "light",
            role: str | None = "engineer",
            size: tuple[int, int] = DEFAULT_SIZE,
            **more: Any,
        ) -> Any:
            locale = {"en": "en-GB", "zh": "zh-CN"}[language]
            page = used.enter_context(contexts.open_page(locale=locale, **more))
            if size != DEFAULT_SIZE:
                page.set_viewport_size({"width": size[0], "height": size[1]})
            if theme != "light":
                page.emulate_media(color_scheme=theme)
            page.set_default_timeout(30_000)
            page.on("pageerror", lambda error: errors.append(str(error)))
            page.on("console", lambda text: _record_error(text, errors))
            if role is not None:
                log_in_by_request(page, stage.at, role)
            page.goto(f"{stage.at}/{way}")
            if role is not None:
                wait_until_live(page)
            return page

        yield go
    assert errors == []


def _record_error(message: Any, errors: list[str]) -> None:
    if message.type == "error" and not any(noise in message.text for noise in ALLOWED_NOISE):
        errors.append(message.text)


@pytest.fixture(scope="session")
def static() -> Path:
    import drivebus.web

    return Path(drivebus.web.__file__).parent / "static"
