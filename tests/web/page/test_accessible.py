"""Accessibility of every page: screen readers, keyboard, phones, and reading from three metres away."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus import i18n
from fixtures.axe import axe_violations
from fixtures.browser import Stage, log_in
from fixtures.browser_actions import DRAWN, NEW_HEADING, PHONES, go_to, hold_topics, resize, show_topics, trip

WAYS = {
    "fleet": ".tile",
    "fleet?group=air": ".grouppanel",
    "drive/fan-1": ".control",
    "buses/fans": NEW_HEADING,
    "drive/fan-1?tab=parameters": "[role=tabpanel] table",
    "drive/fan-1?tab=profile": "[role=tabpanel] .facts",
    "drive/fan-1?tab=faults": "[role=tabpanel] table",
    "drive/fan-1?tab=statistics": "[role=tabpanel]",
    "alarms": NEW_HEADING,
    "history": NEW_HEADING,
    "audit": NEW_HEADING,
    "models": NEW_HEADING,
    "models/c320": NEW_HEADING,
    "settings": NEW_HEADING,
}


def walk(page: Any, way: str) -> None:
    go_to(page, way)
    page.locator(WAYS[way]).first.wait_for()


def test_axe_finds_nothing_on_any_page(stage: Stage, visit: Any) -> None:
    stage.call("waiver.grant", drive="fan-1", reason="watched bench")
    trip(stage, "fan-3")
    page = visit("#/fleet", role=None, bypass_csp=True)
    page.locator("input[name=name]").wait_for()
    found = {"login": _violations(page)}
    log_in(page, "administrator")
    for way in WAYS:
        walk(page, way)
        found[way] = _violations(page)
    assert {way: wrong for way, wrong in found.items() if wrong} == {}


def _violations(page: Any) -> list[str]:
    return [
        f"{violation['id']}: {violation['nodes'][0]['html'][:160]} {violation['nodes'][0]['any'][:1]}"
        for violation in axe_violations(page)
        if violation["impact"] != "minor"
    ]


@pytest.mark.parametrize("language", ["en", "zh"])
def test_nothing_is_wider_than_a_phone(stage: Stage, visit: Any, language: str) -> None:
    """Regression: at 240 pixels, a phone with large text, the pages of a drive and of a bus were wider."""
    page = visit("#/fleet", language=language, role="administrator", size=PHONES[-1])
    wide = {}
    for way in WAYS:
        walk(page, way)
        for width, height in PHONES:
            resize(page, width, height)
            wide[way, width] = page.evaluate("document.documentElement.scrollWidth - innerWidth")
            bar = page.locator(".stopbar").bounding_box()
            assert bar["y"] + bar["height"] <= height + 0.5 and bar["x"] >= 0 and bar["width"] <= width
            assert page.locator("[data-stop=all]").is_visible()
    assert {at: over for at, over in wide.items() if over > 0} == {}


LONG_NAMES = """
  const parse = JSON.parse;
  const long = (_, found) => (found?.title?.en
    ? { ...found, title: { en: `${found.title.en} of the Donaudampfschifffahrtselektrizitätenhauptbetriebswerk`,
      zh: `${found.title.zh}喷漆车间屋顶层含备用回路与变频旁路切换柜及消防联动部分` } } : found);
  JSON.parse = (text, ...rest) => parse(text, ...(rest.length ? rest : [long]));
"""
"""Configuration with a long title wherever it has titles."""


@pytest.mark.parametrize("language", ["en", "zh"])
def test_long_names_widen_no_page_and_keep_the_head_low(visit: Any, language: str) -> None:
    page = visit("#/fleet", language=language, role="administrator", size=(360, 740))
    page.add_init_script(LONG_NAMES)
    page.reload()
    page.locator(".tile").first.wait_for()
    high = page.locator(".head").bounding_box()["height"]
    wide = {}
    for way in [*WAYS, "history?tags=fan-1.output_frequency"]:
        go_to(page, way)
        page.locator(WAYS.get(way, ".trend-readout .swatch")).first.wait_for()
        wide[way] = page.evaluate("document.documentElement.scrollWidth - innerWidth")
    assert {way: over for way, over in wide.items() if over > 0} == {} and high < 100
    page.set_viewport_size({"width": 950, "height": 1080})
    assert page.locator(".head").bounding_box()["height"] < 200


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_phone_shows_that_its_closed_filters_hide_drives(stage: Stage, visit: Any, language: str) -> None:
    page = visit("#/fleet?group=air", language=language, size=(360, 740))
    page.click(".morepicks")
    page.fill("input[type=search]", "extract")
    page.click(".morepicks")
    page.locator(".tile").nth(1).wait_for(state="detached")
    words = [i18n.text("page.filter_search", language, text="extract"), {"en": "Air", "zh": "送引风"}[language]]
    reply_text = i18n.text(
        "page.filtered", language, n=1, total=5, by=i18n.text("language.between_items", language).join(words)
    )
    assert page.locator(".filtered [role=status]").inner_text() == reply_text
    page.click(".filtered button")
    page.locator(".tile").nth(4).wait_for()
    assert page.locator(".filtered").count() == 0 and page.input_value("input[type=search]") == ""


def test_the_fleet_is_read_from_three_metres(stage: Stage, visit: Any) -> None:
    """A capital is 0.7 of its font size: 15 mm of number and 7 mm of word at 96 dpi on a 24 inch screen.

    Three rows, two of them with a tripped drive, are completely visible there.
    """
    trip(stage, "fan-3")
    page = visit("#/fleet", size=(1920, 1080))
    page.select_option("select >> nth=-1", "wall")
    size = "element => parseFloat(getComputedStyle(element).fontSize)"
    mm = 0.7 * 25.4 / 96
    assert page.locator(".tile .value.big .number").first.evaluate(size) * mm > 13
    assert page.locator(".tile .state").first.evaluate(size) * mm > 6.5
    page.locator(".tilefault").first.wait_for()
    first, last = (page.locator(".tile").nth(n).bounding_box() for n in (0, -1))
    bar = page.locator(".stopbar").bounding_box()
    assert last["y"] > first["y"] and first["height"] > last["height"]
    assert first["y"] + 2 * first["height"] + last["height"] + 2 * 12 <= bar["y"]


def test_the_last_row_can_be_scrolled_above_a_stop_bar_of_any_height(visit: Any) -> None:
    page = visit("#/fleet", size=(700, 500))
    page.locator(".tile").nth(4).wait_for()
    page.evaluate("document.querySelector('.stop-status').style.minHeight = '180px'")
    page.wait_for_function("""() => {
      scrollTo(0, 1e6);
      const edges = (one) => document.querySelector(one).getBoundingClientRect();
      return edges(".stopbar").height > 180 && edges(".tile:last-child").bottom <= edges(".stopbar").top;
    }""")  # a function: the page's policy forbids evaluating text


def test_on_a_phone_the_stops_of_two_groups_stand_beside_each_other(visit: Any) -> None:
    """Of ten groups eight were in sight, and nothing showed that the list scrolls."""
    page = visit("#/fleet", size=(375, 812))
    page.locator(".stops .stop").first.click()
    first, second = (page.locator(".stopmenu .stop").nth(n).bounding_box() for n in range(2))
    assert first["y"] == second["y"] and second["x"] + second["width"] <= 375


THIRTY_GROUPS = """() => import('/static/js/store.js').then((store) => {
  const group = store.group('air').peek();
  const more = Array.from({ length: 28 }, (_, n) => `section-${n}`);
  store.applyDelta({ topics: Object.fromEntries(more.map((id) => [`groups/${id}`, { ...group, id, title: null }])) });
})"""


def test_the_stops_of_thirty_groups_are_all_in_sight(visit: Any) -> None:
    """Regression: on a wide screen eight were, in one column that scrolls."""
    page = visit("#/fleet")
    hold_topics(page)
    page.evaluate(THIRTY_GROUPS)
    page.locator("[data-stop=groups]").click()
    page.locator(".stopmenu .stop").nth(29).wait_for()
    assert page.locator(".stopmenu").evaluate("one => one.scrollHeight - one.clientHeight") <= 0
    boxes = [button.bounding_box() for button in page.locator(".stopmenu .stop").all()]
    bar = page.locator(".stopbar").bounding_box()
    assert all(box["y"] >= 0 and box["y"] + box["height"] <= bar["y"] for box in boxes)


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_long_name_of_the_plant_leaves_the_links_and_the_account_in_one_row(visit: Any, language: str) -> None:
    """Regression: the head took a second row from the drives."""
    page = visit("#/fleet", language=language)
    height = page.locator(".head").bounding_box()["height"]
    title = {"en": "Works 3, dyeing and finishing", "zh": "三厂染整车间与污水处理站及锅炉房"}
    show_topics(page, {"plant": {"title": title}})
    page.locator(".head .plant", has_text=title[language]).wait_for()
    assert page.locator(".head").bounding_box()["height"] <= height + 6


@pytest.mark.parametrize("language", ["en", "zh"])
def test_on_a_low_screen_the_stop_bar_leaves_the_room_to_the_page(stage: Stage, visit: Any, language: str) -> None:
    """Regression: at 200 % zoom and on a phone on its side it took more than a third of the height.

    Its stops keep a finger's height and act by one click, also with long names.
    """
    page = visit("#/drive/fan-1", language=language)
    page.add_init_script(LONG_NAMES)
    page.reload()
    page.locator("[data-stop=drive]").wait_for()
    for width, height in ((740, 360), (640, 450), (568, 320)):  # a phone on its side, zoomed, a small phone
        resize(page, width, height)
        assert page.locator(".stopbar").bounding_box()["height"] <= 84
        for stop in page.locator(".stopbar .stop").all():
            box = stop.bounding_box()
            assert box["height"] >= 44 and box["x"] + box["width"] <= width
            label = stop.locator("b")
            assert label.evaluate("one => one.scrollWidth - one.clientWidth") <= 0
    page.click("[data-stop=drive]")
    page.locator(".stop-status.good").wait_for()


@pytest.mark.parametrize("language", ["en", "zh"])
def test_at_400_percent_zoom_each_stop_says_in_full_what_it_stops(visit: Any, language: str) -> None:
    """Of "all, and no restart" the end was cut: that this stop also inhibits the start could not be read."""
    page = visit("#/drive/fan-1", language=language, size=(320, 225))
    page.locator("[data-stop=drive]").wait_for()
    for label in page.locator(".stop :is(b, .what)").all():
        # A line of Chinese may be one pixel higher than its line height.
        assert label.evaluate(
            "(one) => [one.scrollWidth <= one.clientWidth, one.scrollHeight <= one.clientHeight + 2]"
        ) == [True, True]
    assert page.locator(".stopbar").bounding_box()["height"] <= 225 / 2


PLACES = """() => [...document.querySelectorAll('main button:not(.drivedetails *), .stop, nav a')]
  .map((one) => one.getBoundingClientRect()).map(({ x, y }) => [x, y])"""
"""Places of the buttons above the details of a drive, whose chart may be drawn later."""

NEWS = """async () => {
  const [store, taken, stops] = await Promise.all(
    ['store', 'control/takeovers', 'control/stops'].map((one) => import(`/static/js/${one}.js`)));
  const words = { en: 'x '.repeat(300), zh: 'x' };
  store.applyDelta({ topics: { plant: { notice: words }, alarms: { active: [{ id: 'a', drive: 'fan-1',
    kind: 'fault', priority: 'critical', title: words, text: words, cleared_ms: CLEARED_MS, acknowledged_ms: null,
    shelved_until_ms: null, raised_ms: 1 }] } } });
  taken.takeovers.value = [{ drive: 'fan-1', owner: 'bob', time_ms: 1 }];
  const target = { kind: 'all' };
  stops.stops.value = [{ id: 1, target, phase: 'done', good: false, text: () => words.en, time_ms: 1 }];
  await DRAWN;
  return document.querySelectorAll('.notices .banner, .strip .banner.critical, .stop-status.bad').length;
}""".replace("DRAWN", DRAWN)


@pytest.mark.parametrize("cleared_ms", ["null", "2"], ids=["active alarm", "cleared alarm"])
@pytest.mark.parametrize(("address", "width"), [("#/fleet", 1440), ("#/drive/fan-1", 360)])
def test_no_alarm_notice_or_outcome_moves_a_button_under_the_finger(
    visit: Any, address: str, width: int, cleared_ms: str
) -> None:
    page = visit(address, size=(width, 740))
    page.locator(".tile >> nth=4" if width > 360 else ".control [data-do=stop]").wait_for()
    page.evaluate(DRAWN)
    before = page.evaluate(PLACES)
    hold_topics(page)
    assert page.evaluate(NEWS.replace("CLEARED_MS", cleared_ms)) == 4
    assert len(before) > 5 and page.evaluate(PLACES) == before


def test_the_keyboard_alone_leads_from_the_fleet_to_a_stop(stage: Stage, visit: Any) -> None:
    page = visit("#/fleet")
    page.locator(".tilelink").first.wait_for()
    page.evaluate(DRAWN)  # the key is followed after the screen was drawn
    page.keyboard.press("/")
    assert page.evaluate("document.activeElement.type") == "search"
    page.keyboard.type("extract")
    page.locator(".tile").nth(1).wait_for(state="detached")
    page.focus(".tilelink")
    page.keyboard.press("Enter")
    page.locator(".control").wait_for()
    page.focus("[data-stop=drive]")
    page.keyboard.press("Enter")
    page.locator(".stop-status.good").wait_for()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_what_is_chosen_is_seen_with_the_colours_of_the_system(stage: Stage, visit: Any, scheme: str) -> None:
    """High contrast replaces the backgrounds: forward and reverse, and all pages and tabs, looked alike."""
    page = visit("#/drive/fan-1", theme=scheme, forced_colors="active")
    page.click("[data-do=take]")
    page.locator(".lease.own").wait_for()
    background = "one => getComputedStyle(one).backgroundColor"
    chosen, other = (page.locator(f".control .choice [aria-pressed={state}]") for state in ("true", "false"))
    assert chosen.evaluate(background) != other.evaluate(background)
    edge = "one => getComputedStyle(one).borderBottomColor"
    for marked, rest in (
        ("nav [aria-current]", "nav a:not([aria-current]) >> nth=0"),
        ("[role=tab][aria-selected=true]", "[role=tab][aria-selected=false] >> nth=0"),
    ):
        assert page.locator(marked).evaluate(edge) != page.locator(rest).evaluate(edge)
    page.evaluate("location.hash = '#/buses/fans'")
    load = page.locator(".buscard[aria-current] .meter .bar")
    assert load.locator("span").evaluate(background) != load.evaluate(background)


LINES_OVER_EACH_OTHER = """(some) => some.filter((one) => {
  const style = getComputedStyle(one);
  return !(parseFloat(style.lineHeight) >= parseFloat(style.fontSize)); // also "normal", whose height is the font's
}).length"""


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_larger_font_of_the_browser_enlarges_every_text_and_cuts_none(
    stage: Stage, visit: Any, language: str
) -> None:
    """Half of the texts stayed small, and those of a fault lay over each other and over what is below them."""
    trip(stage, "fan-3")
    page = visit("#/fleet", language=language)
    page.evaluate("document.documentElement.style.fontSize = '24px'")
    page.locator(".tilefault").first.wait_for()
    assert page.evaluate("getComputedStyle(document.body).fontSize") == "24px"
    assert page.locator(".tilefault, .tilerow, .tilenote").evaluate_all(LINES_OVER_EACH_OTHER) == 0
    rows = page.locator(".tile:not(:has(.tilefault)) .tileage").all()
    assert len(rows) == 4
    for age in rows:
        row = age.evaluate("one => one.closest('.tilerow').getBoundingClientRect().bottom")
        assert age.bounding_box()["y"] < row - 10
    page.evaluate("location.hash = '#/drive/fan-3'")
    page.locator(".active-fault .what").wait_for()
    assert page.locator(".active-fault").evaluate("one => one.scrollHeight - one.clientHeight") <= 1


@pytest.mark.parametrize("language", ["en", "zh"])
def test_text_of_four_times_its_size_needs_no_sideways_scrolling_and_cuts_no_stop(
    stage: Stage, visit: Any, language: str
) -> None:
    """Regression: the page kept the layout of a wide screen, beyond whose right end its alarm and its buttons lay."""
    trip(stage, "fan-3")
    page = visit("#/buses", language=language, size=(1280, 1000))
    page.context.new_cdp_session(page).send("Page.setFontSizes", {"fontSizes": {"standard": 64, "fixed": 64}})
    for way in ("fleet", "drive/fan-3", "alarms", "audit", "history", "settings"):
        go_to(page, way)
        page.locator(NEW_HEADING).wait_for()
        assert page.evaluate("getComputedStyle(document.body).fontSize") == "64px"
        assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
        for label in page.locator(".stop :is(b, .what)").all():
            assert label.evaluate("(one) => one.scrollHeight - one.clientHeight") <= 8


def test_the_language_and_the_theme_change_at_once_and_stay(stage: Stage, visit: Any) -> None:
    page = visit("#/fleet")
    page.click("text=中文")
    page.locator(f"nav >> text={i18n.text('page.nav_fleet', 'zh')}").wait_for()
    assert page.evaluate("document.documentElement.lang") == "zh-CN"
    page.click(f"text={i18n.text('page.theme_auto', 'zh')}")
    page.click(f"text={i18n.text('page.theme_light', 'zh')}")
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"
    page.reload()
    page.locator(f"nav >> text={i18n.text('page.nav_fleet', 'zh')}").wait_for()
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"
