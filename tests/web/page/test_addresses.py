"""Addresses of the page: names that the plant does not have, the way back, and the title of the browser's tab."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus import i18n
from fixtures.browser import Stage, wait_until_live
from fixtures.browser_actions import DRAWN, expecting

STOPS = "(buttons) => buttons.map((one) => one.dataset.stop)"


@pytest.mark.parametrize(
    ("way", "key", "id"),
    [
        ("#/drive/fan-9", "page.no_such_drive", "fan-9"),
        ("#/fleet?group=steam", "page.no_such_group", "steam"),
        ("#/buses/chillers", "page.no_such_bus", "chillers"),
        ("#/drive", "page.no_such_page", ""),
    ],
)
@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_name_that_the_plant_lacks_is_named_and_no_stop_of_it_is_offered(
    visit: Any, way: str, key: str, id: str, language: str
) -> None:
    """Regression: *Bus stop* of an unknown drive or group stood beside the others and ended in an error."""
    expect = expecting()
    page = visit(way, language=language)
    expect(page.locator("main .notice.warning")).to_contain_text(i18n.text(key, language, id=id))
    expect(page.locator(".stops .stop")).to_have_count(2)
    assert page.locator(".stops .stop").evaluate_all(STOPS) == ["groups", "all"]
    page.keyboard.press("F8")
    expect(page.locator("[data-stop=all]")).to_be_focused()


@pytest.mark.parametrize("way", ["#/drive/fan-1", "#/fleet?group=air", "#/buses/fans"])
def test_a_page_without_a_snapshot_does_not_say_that_the_plant_lacks_its_drive(
    stage: Stage, visit: Any, way: str
) -> None:
    """Regression: a page whose connection failed said that there is no such drive; its stop works meanwhile."""
    expect = expecting()
    page = visit("#/settings")
    page.route_web_socket("**/api/v1/live*", lambda socket: socket.close())
    page.goto(f"{stage.at}/{way}")
    page.reload()
    expect(page.locator(".connection.lost")).to_be_visible()
    assert page.locator("main .notice.warning").count() == 0
    if way == "#/drive/fan-1":
        page.click("[data-stop=drive]")
        expect(page.locator(".stop-status.good")).to_be_visible()


def test_no_frame_of_a_page_that_opens_says_that_the_plant_lacks_its_drive(stage: Stage, visit: Any) -> None:
    """Regression: between a snapshot and the frame that draws its drives the page said that there is no such drive."""
    page = visit("#/fleet")
    page.add_init_script(
        """window.warnings = [];
        new MutationObserver(() => {
          for (const one of document.querySelectorAll("main > .notice.warning")) window.warnings.push(one.textContent);
        }).observe(document, { childList: true, subtree: true });"""
    )
    page.goto(f"{stage.at}/#/drive/pump-2")
    page.reload()
    wait_until_live(page)
    page.locator(".drivehead").wait_for()
    assert page.evaluate("window.warnings") == []


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_tab_of_the_browser_names_the_drive_or_the_page(visit: Any, language: str) -> None:
    """Regression: the tabs of two drives had the same title, and that of the models only the plant's name."""
    expect, plant = expecting(), {"en": "Boiler house", "zh": "锅炉房"}[language]
    page = visit("#/drive/fan-1", language=language)
    names = {
        "#/drive/fan-1": {"en": "Supply fan", "zh": "送风机"}[language],
        "#/drive/fan-9": i18n.text("page.nav_drive", language),
        "#/models": i18n.text("page.models", language),
        "#/alarms": i18n.text("page.nav_alarms", language),
    }
    for way, name in names.items():
        page.evaluate("(way) => { location.hash = way; }", way)
        expect(page).to_have_title(f"{name} · {plant}")
    page.evaluate("location.hash = '#/no-such-page'")
    expect(page).to_have_title(plant)


def test_the_way_back_from_a_drive_leads_to_the_place_where_the_fleet_was_left(visit: Any) -> None:
    """Regression: after a look at one of many drives the fleet began at its top again."""
    page = visit("#/fleet", size=(360, 560))
    last = page.locator(".tilelink").last
    last.wait_for()
    last.scroll_into_view_if_needed()
    page.evaluate(DRAWN)
    place = page.evaluate("scrollY")
    assert place > 100
    for _ in range(2):
        last.click()
        page.locator(".drivehead").wait_for()
        page.wait_for_function("() => scrollY === 0")
        page.evaluate("scrollTo(0, 200)")
        page.evaluate(DRAWN)
        page.go_back()
        page.wait_for_function("(left) => Math.abs(scrollY - left) < 3", arg=place)
    page.go_forward()
    page.wait_for_function("() => scrollY === 200")
    page.locator(".drivehead a").first.click()
    last.wait_for()
    page.wait_for_function("() => scrollY === 0")


def test_a_link_within_the_history_and_the_way_back_show_their_own_signals_and_times(visit: Any) -> None:
    """Regression: the chart read its address only when the page opened, and showed the signals and times before."""
    expect = expecting()
    page = visit("#/history?tags=fan-1.output_frequency&from=1700000000000&to=1700003600000")
    window, signals = page.locator(".trend-window"), page.locator(".trend-readout tbody tr")
    expect(window).to_contain_text("2023-11-14")
    tags = "fan-1.output_frequency,fan-2.output_frequency"
    page.evaluate(f"location.hash = '#/history?tags={tags}&from=1600000000000&to=1600003600000'")
    expect(window).to_contain_text("2020-09-13")
    expect(signals).to_have_count(2)
    page.go_back()
    expect(window).to_contain_text("2023-11-14")
    expect(signals).to_have_count(1)
    page.click("nav a[href='#/history']")
    expect(page.locator("[data-trend=live]")).to_have_attribute("aria-pressed", "true")


LINK_BEFORE_QUERY = """async (link) => {
  const { replaceQuery } = await import('/static/js/router.js');
  location.hash = link;
  replaceQuery({ tags: 'fan-1.output_frequency' });
  return location.hash;
}"""
"""Script that follows a link and changes the query of the page left before the browser reports the new address."""


@pytest.mark.parametrize(
    ("link", "heading"), [("#/alarms", "page.nav_alarms"), ("#/history?from=1000&to=2000", "page.nav_history")]
)
def test_a_link_is_followed_also_where_the_page_left_changes_its_own_address_meanwhile(
    visit: Any, link: str, heading: str
) -> None:
    """Regression: the history, whose address follows its chart, wrote that over the address of the link."""
    page = visit("#/history")
    page.locator(".trend-plot canvas").wait_for()
    assert page.evaluate(LINK_BEFORE_QUERY, link) == link
    page.locator("h1", has_text=i18n.text(heading, "en")).wait_for()


@pytest.mark.parametrize("language", ["en", "zh"])
def test_an_unknown_address_leads_to_the_fleet(visit: Any, expect: Any, language: str) -> None:
    """Regression: an outdated bookmark ended at a sentence without a next step."""
    page = visit("#/bus/fans", language=language)
    notice = page.locator(".notice", has_text=i18n.text("page.no_such_page", language))
    notice.locator("a").click()
    expect(page.locator(".tile").first).to_be_visible()
