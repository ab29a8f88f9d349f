"""After sleep and after an outage of the plant: old values are not live, and failed requests are repeated."""

from __future__ import annotations

from typing import Any

import pytest

from fixtures.browser import Stage
from fixtures.browser_actions import show_topics

SLEPT_MS = 3 * 3_600_000
SLEEP = "(ms) => { const now = Date.now; Date.now = () => now() + ms; }"
"""Script that advances the wall clock but not the monotonic clock, as after closing a laptop's lid."""

TAKE = (
    "async () => { const { takeControl } = await import('/static/js/control/leases.js'); await takeControl('fan-1'); }"
)


@pytest.mark.parametrize(("language", "message"), [("en", "Connection lost for 3 h."), ("zh", "连接已断开 3 小时。")])
def test_after_sleep_the_page_shows_the_time_without_messages(
    stage: Stage, visit: Any, language: str, message: str
) -> None:
    page = visit(language=language)
    stage.lose_server()
    page.wait_for_selector(".connection.lost")
    page.evaluate(SLEEP, SLEPT_MS)
    page.wait_for_function("(text) => document.querySelector('[role=timer]').textContent === text", arg=message)
    stage.regain_server()
    page.wait_for_selector(".connection.live")


def test_values_from_before_a_sleep_are_not_live_afterwards(visit: Any) -> None:
    """The server goes on to send, so that no silence of the connection makes them stale."""
    page = visit()
    page.evaluate(
        """async () => { const { connection } = await import("/static/js/live.js");
        window.links = []; connection.subscribe((state) => window.links.push(state)); }"""
    )
    page.evaluate(SLEEP, SLEPT_MS)
    page.wait_for_function("() => window.links.includes('lost')")
    page.wait_for_selector(".connection.live")


@pytest.mark.parametrize(
    ("way", "there"),
    [
        ("#/settings?tab=users", "table.data .name"),
        ("#/alarms?tab=incidents", ".incidents + .help"),
        ("#/history", ".picker"),
        ("#/drive/fan-2?tab=profile", "[role=tabpanel] .facts"),
    ],
)
def test_a_page_opened_while_the_plant_was_away_loads_when_it_is_back(
    stage: Stage, visit: Any, way: str, there: str
) -> None:
    page = visit(role="administrator")
    page.goto(f"{stage.at}/{way}")
    page.wait_for_selector(there)
    page.goto(f"{stage.at}/#/fleet")
    page.wait_for_selector(".tile")
    stage.lose_server()
    page.wait_for_selector(".connection.lost")
    page.evaluate("(way) => { location.hash = way; }", way)
    page.wait_for_selector("text=The server does not answer.")
    stage.regain_server()
    page.wait_for_selector(there)
    assert page.locator("text=The server does not answer.").count() == 0


def test_a_stop_without_an_answer_is_not_shown_as_received_by_the_drives(stage: Stage, visit: Any) -> None:
    """The service hangs; the page must not show that it waits for the drives."""
    page = visit()
    page.route("**/api/v1/stop", lambda route: None)
    stage.lose_server()
    page.wait_for_selector(".connection.lost")
    page.click("[data-stop=all]")
    page.wait_for_selector("text=STOP NOT CONFIRMED")
    stage.regain_server()
    page.wait_for_selector(".connection.live")


def test_lost_connection_and_lost_control_are_visible_at_any_scroll_position(stage: Stage, visit: Any) -> None:
    page = visit("#/drive/fan-1", size=(1280, 700))
    page.click("[data-do=take]")
    page.wait_for_selector(".lease.own")
    page.evaluate("scrollTo(0, 500)")
    visit("#/drive/fan-1", role="administrator").evaluate(TAKE)
    message = page.locator(".takeovers .banner")
    message.wait_for()
    assert 0 <= message.bounding_box()["y"] < 700
    stage.lose_server()
    lost = page.locator(".banner.bad")
    lost.wait_for()
    assert 0 <= lost.bounding_box()["y"] < 700
    stage.regain_server()
    page.wait_for_selector(".connection.live")


SLOW_SNAPSHOT = """
  const Native = WebSocket;
  window.WebSocket = class extends Native {
    set onmessage(act) {
      super.onmessage = act && ((event) => { setTimeout(() => { if (this.readyState === 1) act(event); }, 7500); });
    }
  };
"""


def test_a_page_whose_snapshot_takes_longer_than_its_first_limit_becomes_live(visit: Any) -> None:
    """Regression: beside a busy server the page gave up each attempt after 6 s, and never was live again."""
    page = visit()
    page.add_init_script(SLOW_SNAPSHOT)
    page.reload()
    page.wait_for_selector(".connection.lost")
    page.wait_for_selector(".connection.live", timeout=30_000)


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_page_of_an_older_version_says_so_and_is_reloaded_by_a_button(visit: Any, language: str) -> None:
    """A page left open over an update of the service mixed scripts of both versions without a word."""
    page = visit("#/fleet", language=language, size=(360, 740))
    page.locator(".tile").first.wait_for()
    assert page.locator("[data-text=new-version]").count() == 0
    show_topics(page, {"plant": {"version": "9.9.9"}})
    page.locator("[data-text=new-version]", has_text="9.9.9").wait_for()
    icon, text = (
        page.locator(f"[data-text=new-version] > {selector}").bounding_box() for selector in (".icon", "span")
    )
    assert icon["x"] + icon["width"] < text["x"]  # and not alone in the line above
    with page.expect_navigation():
        page.click("[data-do=reload-page]")
    page.locator(".tile").first.wait_for()
    assert page.locator("[data-text=new-version]").count() == 0
