"""The frame around each page on screens of different sizes: header, notice of the service, filters, stop bar."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus import i18n
from fixtures.browser import Stage
from fixtures.browser_actions import go_to, hold_topics, show_topics

BOTTOMS = """all => new Set(all.filter((one) => one.offsetParent)
  .map((one) => Math.round(one.getBoundingClientRect().bottom))).size"""
"""Script: number of different lower edges of the visible ones of these elements."""


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("size", [(1440, 900), (1366, 768), (1920, 1080)])
def test_the_filters_of_the_fleet_stand_in_one_row(visit: Any, size: tuple[int, int], language: str) -> None:
    """Regression: at 1440 pixels they took two rows, and a third row of drives was cut off."""
    page = visit("#/fleet", size=size, language=language)
    page.locator(".tile").nth(4).wait_for()
    assert page.locator(".fleettools > .choice, .fleetpicks > *").evaluate_all(BOTTOMS) == 1
    widths = "all => all.filter((one) => one.scrollWidth > one.clientWidth).length"
    assert page.locator(".fleettools .choice button").evaluate_all(widths) == 0


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_size_of_the_tiles_can_be_read_where_they_are_for_a_wall(visit: Any, language: str) -> None:
    """Regression: the chosen size was "Wall (from"."""
    page = visit("#/fleet", size=(1440, 900), language=language)
    page.locator(".tile").nth(4).wait_for()
    size = page.get_by_label(i18n.text("page.size", language))
    size.select_option("wall")
    # 20 pixels for its arrow
    assert size.evaluate("""(one) => {
      const style = getComputedStyle(one);
      const text = document.createElement('canvas').getContext('2d');
      text.font = style.font;
      const width = text.measureText(one.selectedOptions[0].text).width + 2 * parseFloat(style.paddingLeft);
      return width + 20 <= one.clientWidth;
    }""")


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_header_of_a_tablet_is_one_row(visit: Any, language: str) -> None:
    """Regression: the account stood below the links, although there was room beside them."""
    page = visit("#/fleet", size=(1180, 820), language=language)
    page.locator(".tile").nth(4).wait_for()
    title = {"en": "Rolling mill, second hall", "zh": "第二轧钢车间的冷却与除鳞系统"}
    show_topics(page, {"plant": {"title": title}})
    page.locator(".head .plant", has_text=title[language]).wait_for()
    assert page.locator(".head").bounding_box()["height"] <= 64


def test_values_of_neighbouring_tiles_stand_at_one_height_below_names_of_one_and_two_lines(
    stage: Stage, visit: Any
) -> None:
    """Regression: below a name of two lines state and frequency stood a line lower than beside it."""
    page = visit("#/fleet", size=(1440, 900))
    page.locator(".tile").nth(4).wait_for()
    title = {"en": "Roller table motor of the second stand", "zh": "辊道电机"}
    show_topics(page, {"drives/fan-2": {"title": title}})
    page.locator(".tilename", has_text="second stand").wait_for()
    heights = page.locator(".tilename").evaluate_all("all => new Set(all.map((one) => one.offsetHeight)).size")
    assert heights > 1
    for part in (".state", ".tilehz", ".tilerow"):
        assert page.locator(f".tile {part}").evaluate_all(BOTTOMS) == 1, part


@pytest.mark.parametrize("size", [(360, 740), (844, 390)])
def test_the_stops_of_a_drive_and_of_its_group_differ_on_a_phone(
    visit: Any, expect: Any, size: tuple[int, int]
) -> None:
    """Regression: *Press section motor 1-1* and *Press section* both read *Press section*."""
    page = visit("#/drive/fan-1", size=size)
    names = {"drives/fan-1": "Press section motor 1-1", "groups/air": "Press section"}
    show_topics(page, {topic: {"title": {"en": name, "zh": name}} for topic, name in names.items()})
    own = page.locator("[data-stop=drive] .what")
    expect(own).to_contain_text("motor 1-1")
    assert own.evaluate("(one) => one.scrollHeight <= one.clientHeight"), "its end is cut off"
    assert own.locator(".short").inner_text().endswith("1-1")
    expect(page.get_by_role("button", name="Press section motor 1-1")).to_be_visible()
    expect(page.locator("[data-stop=group] .what")).to_have_text("Press section")


@pytest.mark.parametrize(("way", "share"), [("#/fleet", 0.26), ("#/drive/fan-1", 0.37)])
def test_the_stop_bar_leaves_most_of_a_screen_at_four_times_its_size(visit: Any, way: str, share: float) -> None:
    """Regression: of a screen of 1440 × 900 at 400 % zoom the bar took two fifths, and on a drive's page half."""
    page = visit(way, size=(360, 225))
    page.locator(".stop").last.wait_for()
    bar = page.locator(".stopbar").bounding_box()
    assert bar["height"] <= share * 225
    assert page.locator(".stopbar").inner_text().count(i18n.text("page.stop_note", "en")) == 1
    for button in page.locator(".stop").all():
        box = button.bounding_box()
        assert box["height"] >= 40 and box["x"] >= 0 and box["x"] + box["width"] <= 360
    assert page.locator(".stop b").evaluate_all("all => all.filter((one) => one.scrollWidth > one.clientWidth)") == []


@pytest.mark.parametrize(("size", "height"), [((360, 225), 88), ((360, 800), 140)])
def test_the_stop_bar_stays_low_with_a_result_and_the_button_that_releases(
    stage: Stage, visit: Any, size: tuple[int, int], height: int
) -> None:
    """Regression: the button had a row of its own, and at four times its size the bar took two thirds of the screen."""
    page = visit("#/fleet", size=size)
    page.locator(".tile").nth(4).wait_for()
    page.click("[data-stop=all]")
    page.locator(".stopbar > .button").wait_for()
    page.locator(".stop-results").wait_for()
    assert page.locator(".stopbar").bounding_box()["height"] <= height
    button = page.locator(".stopbar > .button").bounding_box()
    assert button["height"] >= 40 and button["x"] + button["width"] <= size[0]
    page.locator(".stop-status.good").wait_for()


def test_values_of_tiles_on_a_phone_stand_at_one_height_also_where_one_is_not_known(visit: Any) -> None:
    """Regression: beside a dash the sparkline took the row of the value, and the tile was a row shorter."""
    page = visit("#/fleet", size=(360, 800))
    page.locator(".tile").nth(4).wait_for()
    unknown = {"value": None, "unit": "Hz", "quality": "bad", "reason": None, "source_time_ms": None}
    title = {"title": {"en": "Fan", "zh": "风机"}}
    signals = {"signals": {"output_frequency": unknown}}
    show_topics(page, {"drives/fan-1": title | signals, "drives/fan-2": title})
    page.locator("[data-drive=fan-1] .value.none").wait_for()
    bottoms = "(one) => Math.round(one.getBoundingClientRect().bottom)"
    states = page.locator("[data-drive=fan-1] .state, [data-drive=fan-2] .state")
    assert len({state.evaluate(bottoms) for state in states.all()}) == 1


def test_the_title_of_a_cleared_alarm_has_its_place_in_the_strip_of_a_phone(visit: Any) -> None:
    """Regression: beside the word "cleared" it was "Descali…ng pump" in letters of three lines."""
    page = visit("#/fleet", size=(360, 800))
    page.locator(".tile").nth(4).wait_for()
    hold_topics(page)
    page.evaluate("""async () => {
      const store = await import('/static/js/store.js');
      const text = { en: 'No usable reply', zh: 'x' };
      const alarm = (n) => ({ id: `x${n}`, first_id: `x${n}`, kind: `k${n}`, drive: 'fan-1', priority: 'high',
        title: text, text, cleared_ms: 2, acknowledged_ms: null, shelved_until_ms: null, raised_ms: 1 });
      store.applyDelta({ topics: { alarms: { active: Array.from({ length: 30 }, (_, n) => alarm(n)) } } });
    }""")
    banner = page.locator(".strip .banner.cleared")
    assert banner.locator("a").first.bounding_box()["width"] >= 100
    strip, state = page.locator(".strip").bounding_box(), banner.locator(".state").bounding_box()
    assert strip["y"] <= state["y"] and state["y"] + state["height"] <= strip["y"] + strip["height"]


LONGEST = {language: i18n.text("demo.story.unplug", language, bus="B") for language in i18n.LANGUAGES}
PLACES = """() => [...document.querySelectorAll('main :is(button, a), .stopbar button')]
  .filter((one) => one.offsetParent).map((one) => Math.round(one.getBoundingClientRect().top))"""


@pytest.mark.parametrize("size", [(1440, 900), (820, 1180), (360, 800)])
def test_a_notice_of_the_service_covers_nothing_and_its_end_moves_nothing(
    stage: Stage, visit: Any, size: tuple[int, int]
) -> None:
    """Regression: the notice of the demo lay over tiles. One that comes to an open page does, and moves nothing."""
    stage.service.plant.notice = LONGEST
    try:
        page = visit("#/buses", size=size)
        notice = page.locator("[data-text=notice]")
        notice.wait_for()  # the service has published it
        go_to(page, "fleet")
        page.locator(".tile").nth(4).wait_for()
        box, main = notice.bounding_box(), page.locator("main").bounding_box()
        assert box["y"] + box["height"] <= main["y"]
        place = page.locator(".service-notice")
        assert place.evaluate("one => one.scrollHeight <= one.clientHeight"), "its text is whole"
        before = page.evaluate(PLACES)
        stage.service.plant.notice = {"en": "short", "zh": "短"}
        page.locator("[data-text=notice]", has_text="short").wait_for()
        assert page.evaluate(PLACES) == before
        stage.service.plant.notice = None
        notice.wait_for(state="detached")
        assert page.evaluate(PLACES) == before
        background = place.evaluate("one => getComputedStyle(one).backgroundColor")
        assert background == "rgba(0, 0, 0, 0)", "no empty strip under the alarms"
    finally:
        stage.service.plant.notice = None
    go_to(page, "buses")
    place.wait_for(state="detached")


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("size", [(360, 800), (1180, 820), (1440, 900)])
def test_a_lost_connection_moves_no_button(stage: Stage, visit: Any, size: tuple[int, int], language: str) -> None:
    """Regression: beside "no live connection" the button of the menu took a second row, and all drives moved down."""
    page = visit("#/fleet", size=size, language=language)
    page.locator(".tile").nth(4).wait_for()
    title = {"en": "Rolling mill, second hall", "zh": "第二轧钢车间的冷却与除鳞系统"}
    show_topics(page, {"plant": {"title": title}})
    page.locator(".head .plant", has_text=title[language]).wait_for()
    places = "all => all.map((one) => [one.getBoundingClientRect()].map(({ x, y }) => [x, y].map(Math.round)))"
    before = page.evaluate(PLACES), page.locator(".head button").evaluate_all(places)
    stage.lose_server()
    page.locator(".connection.lost").wait_for()
    after = page.evaluate(PLACES), page.locator(".head button").evaluate_all(places)
    stage.regain_server()
    assert after == before


def test_the_notice_of_a_lost_connection_covers_a_few_lines_of_a_wide_screen(stage: Stage, visit: Any) -> None:
    """Regression: it covered two drives of the third row, because its text was a narrow column of eight lines."""
    page = visit("#/fleet", size=(1440, 900))
    page.locator(".tile").nth(4).wait_for()
    stage.lose_server()
    banner = page.locator(".notices .banner.bad")
    banner.wait_for()
    height = banner.bounding_box()["height"]
    stage.regain_server()
    assert height <= 150
