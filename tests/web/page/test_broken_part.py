"""A script error in one part of the page says so in its place, and leaves the stops and the other parts at work."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from drivebus import i18n
from fixtures.browser import Stage, log_in_by_request, wait_until_live
from fixtures.browser_actions import show_topics

BROKEN = "[data-text=broken]"
LOG_OUT = ".account .button:last-child"
BROKEN_DRIVE = {"drives/fan-1": {"comm_loss": None, "limits": None, "commanded_hz": "x"}}
"""View of a drive of a shape that the page does not know, as of a service of another version."""


@pytest.fixture
def page(contexts: Any, stage: Stage) -> Iterator[Any]:
    """Open the fleet; unlike ``visit``, this allows errors of the page's scripts."""
    with contexts.open_page(locale="en-GB") as page:
        log_in_by_request(page, stage.at, "administrator")
        page.goto(f"{stage.at}/#/fleet")
        wait_until_live(page)
        yield page


def test_a_page_whose_answer_it_cannot_draw_says_so_and_stops_still_work(page: Any) -> None:
    page.route("**/api/v1/models", lambda route: route.fulfill(json={}))
    page.evaluate("location.hash = '#/models'")
    page.locator(BROKEN, has_text=i18n.text("page.broken", "en").partition("{")[0]).wait_for()
    page.click("[data-stop=all]")
    page.locator(".stop-status.good").wait_for()
    page.unroute("**/api/v1/models")
    page.evaluate("location.hash = '#/alarms'")
    page.locator("main h1", has_text=i18n.text("page.nav_alarms", "en")).wait_for()
    assert page.locator(BROKEN).count() == 0


def test_a_broken_tab_leaves_the_control_of_its_drive_and_is_drawn_again_on_request(page: Any) -> None:
    page.route("**/api/v1/alarms/history*", lambda route: route.fulfill(json={"items": [None], "next": None}))
    page.evaluate("location.hash = '#/alarms?tab=history'")
    page.locator(f"[role=tabpanel] {BROKEN}").wait_for()
    page.unroute("**/api/v1/alarms/history*")
    page.click("[data-do=draw-again]")
    page.locator("[role=tabpanel] .filters").first.wait_for()
    assert page.locator(BROKEN).count() == 0


def test_a_tile_that_cannot_be_drawn_shows_no_value_of_before(page: Any) -> None:
    """Preact leaves what was drawn before an error: its frequency would count as live for ever."""
    page.locator(".tile").nth(4).wait_for()
    show_topics(page, BROKEN_DRIVE)
    page.locator(f".tiles {BROKEN}", has_text="Supply fan").wait_for()
    assert page.locator(".tile").count() == 4
    page.locator(".tilestop").first.click()
    page.locator(".stop-status.good").wait_for()


def test_after_a_message_that_it_cannot_apply_no_value_is_live_until_the_next_snapshot(page: Any) -> None:
    page.evaluate("""async () => {
      const { connection } = await import('/static/js/live.js');
      window.states = [];
      connection.subscribe((state) => window.states.push(state));
    }""")
    page.evaluate("""() => {
      const parse = JSON.parse;
      JSON.parse = (text) => {
        const value = parse(text);
        if (value?.type !== 'delta') return value; // parts of the page parse texts of their own
        JSON.parse = parse;
        return { type: 'delta' };
      };
    }""")
    page.wait_for_function("() => window.states.join().startsWith('live,lost,live')")


@pytest.mark.parametrize("status", [503, None], ids=["refused", "no answer"])
def test_a_log_out_that_the_server_does_not_confirm_is_not_silent(page: Any, status: int | None) -> None:
    """The next person at the screen would have the session."""

    def refuse(route: Any) -> None:
        if status is None:
            route.abort()
        else:
            route.fulfill(status=status, json={})

    page.route("**/api/v1/logout", refuse)
    page.click(LOG_OUT)
    notice = page.locator("[data-text=logout-failed]")
    notice.wait_for()
    wait_until_live(page)
    page.unroute("**/api/v1/logout")
    notice.locator("button").click()
    page.locator("input[name=name]").wait_for()


def test_a_log_out_shows_the_login_page_although_the_server_is_away_afterwards(page: Any) -> None:
    page.route("**/api/v1/session", lambda route: route.abort())
    page.click(LOG_OUT)
    page.locator("input[name=name]").wait_for()
