"""The page on paper, printed by a real browser."""

from __future__ import annotations

import re
from typing import Any

import pytest

from drivebus import i18n
from fixtures.browser import Stage
from fixtures.browser_actions import expecting, trip

INK = """() => {
  const brightness = (colour) => colour.match(/[0-9.]+/g).slice(0, 3).reduce((sum, one) => sum + Number(one), 0) / 3;
  const style = (one) => getComputedStyle(document.querySelector(one));
  return [brightness(style('h1').color), brightness(style('body').backgroundColor)];
}"""


@pytest.mark.parametrize(("theme", "language"), [("light", "en"), ("dark", "zh")])
def test_a_printed_page_is_dark_on_white_and_nothing_lies_over_it(
    stage: Stage, visit: Any, theme: str, language: str
) -> None:
    """Regression: the stop bar covered a stretch of each sheet, and the dark theme printed its light text on white.

    Nothing on a sheet said when and of which plant it was printed.
    """
    trip(stage, "pump-2")
    page = visit("#/drive/pump-2", theme=theme, language=language)
    page.locator(".active-fault [data-do=incident]").wait_for()
    assert page.locator(".stopbar").is_visible() and not page.locator(".head .printed").is_visible()
    page.emulate_media(media="print", color_scheme=theme)
    ink, paper = page.evaluate(INK)
    assert ink < 60 and paper == 255
    assert [
        selector
        for selector in (".stopbar", ".head nav", ".strip .button", "main .button")
        if page.locator(selector).first.is_visible()
    ] == []
    assert page.locator(".active-fault").is_visible() and page.locator(".strip .priority").is_visible()
    fixed = "all => all.filter((one) => getComputedStyle(one).position === 'fixed' && one.offsetHeight > 0).length"
    assert page.locator("body *").evaluate_all(fixed) == 0
    page.evaluate("location.hash = '#/fleet'")
    page.locator(".tile").first.wait_for()
    assert not page.locator(".tilestop").first.is_visible()
    expect = expecting()
    expect(page.locator(".head .plant")).to_have_text({"en": "Boiler house", "zh": "锅炉房"}[language])
    expect(page.locator(".head .plant")).to_be_visible()
    printed_at = i18n.text("page.printed_at", language, time="").strip()
    expect(page.locator(".head .printed")).to_have_text(
        re.compile(rf"^{printed_at} ?\d{{4}}-\d\d-\d\d \d\d:\d\d:\d\d$")
    )
    expect(page.locator(".head .printed")).to_be_visible()


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_a_printed_incident_is_complete_and_its_chart_is_dark_on_white(stage: Stage, visit: Any, theme: str) -> None:
    """The frames ended at the height of their box, and the dark theme printed a pale chart.

    A chart drawn for a wide screen lost its right end, which is the trip.
    """
    trip(stage, "pump-2")
    page = visit("#/alarms?tab=incidents", theme=theme, size=(718, 900))
    page.locator(".incidents a").first.click()
    page.locator(".incident-frames tbody tr").first.wait_for()
    page.locator(".trend-plot canvas").wait_for()
    page.emulate_media(media="print", color_scheme=theme)
    hidden = "one => Math.max(one.scrollHeight - one.clientHeight, one.scrollWidth - one.clientWidth)"
    assert [box.evaluate(hidden) > 1 for box in page.locator("main .scroll").all()].count(True) == 0
    page.locator(".trend-plot .u-wrap").evaluate("one => { one.style.width = '1400px'; }")
    assert page.locator(".trend-plot").evaluate("one => one.scrollWidth - one.clientWidth") <= 0
    chart = page.locator(".trend-plot canvas").evaluate("one => getComputedStyle(one).filter")
    assert ("invert" in chart) == (theme == "dark")


VISIBLE_FIELDS = """() => [...document.querySelectorAll("main :is(input, select, textarea, .choice, summary)")]
  .filter((one) => one.getClientRects().length > 0 && !one.matches(".values summary, td summary"))
  .map((one) => one.outerHTML.slice(0, 80))"""
"""Script: fields and buttons of a printed page."""


def test_a_printed_drive_with_its_parameters_has_no_field(stage: Stage, visit: Any) -> None:
    """Regression: the sheet had the slider, the direction, a search and an empty field for each parameter."""
    page = visit("#/drive/pump-1?tab=parameters")
    page.click("[data-do=take]")
    page.locator("td.pinned input").first.wait_for()
    page.emulate_media(media="print")
    expecting()(page.locator("td.pinned").first).to_be_hidden()
    assert page.evaluate(VISIBLE_FIELDS) == []
    assert page.locator("[role=tab]:visible").all_inner_texts() == [i18n.text("page.tab_parameters", "en")]


def test_a_printed_audit_trail_says_what_it_was_filtered_by_without_a_field(stage: Stage, visit: Any) -> None:
    """Regression: the sheet had three fields, one of them empty."""
    page = visit("#/audit")
    page.locator(".entry").first.wait_for()
    page.emulate_media(media="print")
    expect, search = expecting(), page.locator(".filters .field", has=page.locator("[type=search]"))
    expect(search).to_be_hidden()
    frame = "all => all.map((one) => getComputedStyle(one).borderTopWidth)"
    assert page.locator(".filters select").evaluate_all(frame) == ["0px", "0px"]
    expect(page.locator(".filters select").first).to_be_visible()
    page.emulate_media(media="screen")
    page.fill(".filters [type=search]", "e")
    page.emulate_media(media="print")
    expect(search).to_be_visible()


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_printed_fleet_names_its_filters_in_place_of_their_fields(stage: Stage, visit: Any, language: str) -> None:
    """Regression: the sheet had a search field, lists and buttons, and not always a word of what it lacks."""
    page = visit("#/fleet", language=language)
    page.locator(".tile").first.wait_for()
    expect, filtered = expecting(), page.locator(".filtered")
    page.emulate_media(media="print")
    expect(page.locator(".fleettools")).to_be_hidden()
    expect(filtered).to_have_count(0)
    page.emulate_media(media="screen")
    page.fill("input[type=search]", "pump-2")
    expect(page.locator(".tile")).to_have_count(1)
    expect(filtered).to_be_hidden()
    page.emulate_media(media="print")
    by = i18n.text("page.filter_search", language, text="pump-2")
    expect(filtered.get_by_role("status")).to_have_text(i18n.text("page.filtered", language, n=1, total=5, by=by))
    expect(filtered.get_by_role("status")).to_be_visible()
    expect(filtered.locator(".button")).to_be_hidden()


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_printed_bus_is_no_wider_than_a_sheet(visit: Any, language: str) -> None:
    """Regression: the table of its stations had 900 pixels, of which a sheet of A4 cut off the errors."""
    page = visit("#/buses/fans", language=language, size=(718, 1040))
    page.locator(".wide-table tbody tr").first.wait_for()
    page.emulate_media(media="print")
    assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0


BLANK_OR_CLOSED = """() => [...document.querySelectorAll("main :is(div, p, section, details, summary)")]
.filter((one) => {
  const box = one.getBoundingClientRect();
  if (one.closest(".trend-plot") || box.height === 0) return false;
  if (one.matches("summary")) return getComputedStyle(one).listStyleType !== "none";
  if (one.matches(".values details")) return box.height < 2 * one.firstElementChild.getBoundingClientRect().height;
  const drawn = one.innerText.trim() || one.querySelector("canvas, svg");
  return !drawn || (one.matches(".fault-place") && box.height > 1.5 * one.querySelector("h2").offsetHeight + 40);
}).map((one) => one.outerHTML.slice(0, 80))"""
"""Script: parts of a printed page that have no content, or content that can't be opened on paper."""


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_printed_drive_has_no_blank_place_and_nothing_to_open(stage: Stage, visit: Any, language: str) -> None:
    """Regression: the places of buttons were blank, and some values stood behind a triangle to press."""
    trip(stage, "pump-2")
    page = visit("#/drive/pump-2", language=language)
    page.locator(".active-fault").wait_for()
    page.locator(".trend-plot canvas").wait_for()
    page.emulate_media(media="print")
    assert page.evaluate(BLANK_OR_CLOSED) == []
    page.evaluate("location.hash = '#/audit'")
    page.locator(".entry summary").first.wait_for()
    assert page.evaluate(BLANK_OR_CLOSED) == []
