"""Details that pages show on demand: accessibility, phones, and both languages."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivebus import errors, i18n, profiles
from drivebus.bus.core import UntrustedReply
from fixtures.axe import axe_violations
from fixtures.browser import Stage
from fixtures.browser_actions import NEW_HEADING, PHONES, expecting, go_to, page_text, resize, show_topics, trip


def open_history(page: Any) -> None:
    page.locator(".trend-plot canvas").wait_for()
    page.click(".picker summary")
    page.click("[data-trend=cursors]")
    page.click(".trend-events summary")


def open_incident(page: Any) -> None:
    page.locator(".incidents a").first.click()
    page.locator(".trend-plot canvas").wait_for()


def shelve(page: Any) -> None:
    page.locator(".alarmrow .do button").last.click()
    page.locator("dialog input").wait_for()


def add(page: Any) -> None:
    page.locator("[role=tabpanel] .button.main").click()
    page.locator("dialog input").first.wait_for()


def check(page: Any) -> None:
    page.click("[data-configuration=check]")
    page.locator(".notice").first.wait_for()


def look(page: Any) -> None:
    page.locator(NEW_HEADING).wait_for()


DETAILS: dict[str, Callable[[Any], None]] = {
    "history?tags=fan-1.output_frequency,fan-1.dc_bus_voltage": open_history,
    "alarms?tab=incidents": open_incident,
    "alarms?tab=active": shelve,
    "alarms?tab=history": look,
    "buses/pumps": lambda page: page.locator(".frame").first.wait_for(),
    "settings?tab=users": add,
    "settings?tab=tokens": add,
    "settings?tab=configuration": check,
    "settings?tab=about": look,
}


def open_detail(page: Any, way: str) -> None:
    page.evaluate("way => { location.hash = '#/fleet'; }", way)
    page.locator(".tile").first.wait_for()
    go_to(page, way)
    DETAILS[way](page)


def test_axe_finds_nothing_serious_in_the_details(stage: Stage, visit: Any) -> None:
    trip(stage, "fan-3")
    page = visit("#/fleet", role="administrator", bypass_csp=True)
    found = {}
    for way in DETAILS:
        open_detail(page, way)
        grave = [violation for violation in axe_violations(page) if violation["impact"] in ("serious", "critical")]
        found[way] = [(violation["id"], violation["nodes"][0]["html"][:160]) for violation in grave]
    assert {way: wrong for way, wrong in found.items() if wrong} == {}


@pytest.mark.parametrize("language", ["en", "zh"])
def test_no_detail_is_wider_than_a_phone(stage: Stage, visit: Any, language: str) -> None:
    trip(stage, "fan-3")
    page = visit("#/fleet", language=language, role="administrator", size=PHONES[-1])
    wide, broken = {}, 0
    for way in DETAILS:
        open_detail(page, way)
        for width, height in PHONES:
            resize(page, width, height)
            broken += page.evaluate(
                "[...document.querySelectorAll('td .button')].filter(b => b.offsetHeight > 40).length"
            )
            wide[way, width] = page.evaluate("document.documentElement.scrollWidth - innerWidth")
            assert page.locator("[data-stop=all]").is_visible()
    assert {at: over for at, over in wide.items() if over > 0} == {}
    assert broken == 0


def test_touch_pans_and_zooms_a_trend(visit: Any) -> None:
    """A finger pans through time, two zoom; a tap shows values, also where no mouse points; the page still scrolls."""
    page = visit("#/history?tags=fan-1.output_frequency", size=(360, 740), has_touch=True)
    over, window = page.locator(".u-over"), page.locator(".trend-window")
    page.locator(".trend-readout .value").first.wait_for()
    over.scroll_into_view_if_needed()
    box = over.bounding_box()
    before = window.inner_text()
    fingers = page.context.new_cdp_session(page)

    def touch(kind: str, *places: float) -> None:
        points = [{"x": box["x"] + place, "y": box["y"] + 40, "id": n} for n, place in enumerate(places)]
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    page.touchscreen.tap(box["x"] + 60, box["y"] + 40)
    expecting()(page.locator(".trend-tip")).to_contain_text("Supply fan")
    page.touchscreen.tap(box["x"] + 60, box["y"] - 40)
    expecting()(page.locator(".trend-tip")).to_have_count(0)
    touch("touchStart", 60)
    touch("touchMove", 160)
    touch("touchEnd")
    expecting()(window).not_to_have_text(before)
    assert window.inner_text().endswith("1 h")
    touch("touchStart", 80, 160)
    touch("touchMove", 40, 200)
    touch("touchEnd")
    expecting()(window).not_to_have_text(re.compile("1 h$"))
    assert over.evaluate("element => getComputedStyle(element).touchAction") == "pan-y"


# --- texts --------------------------------------------------------------------------------------------------------


def snake(name: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()


def test_every_text_of_an_error_class_belongs_to_an_existing_class() -> None:
    classes = {snake(name) for name in dir(errors) if isinstance(getattr(errors, name), type)}
    classes.add(snake(UntrustedReply.__name__))
    words = {key.removeprefix("page.error_") for key in i18n.catalogue("en") if key.startswith("page.error_")}
    assert len(words) > 10 and words <= classes


API_PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "use-the-api.md"


def test_the_browser_example_of_the_api_page_prints_the_states_of_a_drive(visit: Any) -> None:
    (program,) = re.findall(r"^```js\n(.*?)^```", API_PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    page = visit("#/fleet", role="viewer")
    with page.expect_console_message(lambda message: message.text.startswith("fan-1 ")) as found:
        page.evaluate(f"() => {{ {program} }}")
    assert found.value.text in ("fan-1 stopped", "fan-1 running")


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_identity_of_a_c320_is_read_on_the_page(visit: Any, language: str) -> None:
    page = visit("#/drive/fan-1?tab=profile", language=language, role="operator")
    page.click("[data-do=read-identity]")
    page.wait_for_selector("[data-text=identity]:has-text('380 V')")
    assert "page." not in page.locator("[data-text=identity]").inner_text()
    page.locator("[data-text=identity]").scroll_into_view_if_needed()


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_line_to_a_vc660_is_tested_on_the_page(visit: Any, language: str) -> None:
    """The loop-back was in the command line alone, which needs the port of the service."""
    page = visit("#/drive/pump-1?tab=profile", language=language, role="operator")
    page.click("[data-do=loopback]")
    result = page.locator("[data-text=loopback]")
    expecting()(result).to_contain_text(i18n.text("loopback.returned", language, returned=100, requests=100))
    assert result.get_attribute("role") == "status" and "{" not in result.inner_text()


@pytest.mark.parametrize(("drive", "role"), [("fan-1", "operator"), ("pump-1", "viewer")])
def test_no_loop_back_is_offered_for_a_model_without_one_or_to_a_viewer(visit: Any, drive: str, role: str) -> None:
    page = visit(f"#/drive/{drive}?tab=profile", role=role)
    page.wait_for_selector(f"h3:has-text('{i18n.text('page.signals')}')")
    expecting()(page.locator("[data-do=loopback]")).to_have_count(0)


@pytest.mark.parametrize(("language", "emergency"), [("en", "emergency stop under way"), ("zh", "紧急停车过程中")])
def test_the_bits_of_the_status_word_are_listed_with_those_that_are_set(
    visit: Any, language: str, emergency: str
) -> None:
    """The word of the VC660 stood on the page as a number, and its bits nowhere."""
    page = visit("#/drive/pump-1?tab=profile", language=language)
    rows = page.locator("table", has_text=emergency).locator("tbody tr")
    expecting()(rows).to_have_count(len(profiles.load("vc660").status.bits))  # type: ignore[union-attr]
    expecting()(rows.nth(0)).to_contain_text(i18n.text("page.yes", language))
    expecting()(rows.nth(4)).to_contain_text(i18n.text("page.no", language))
    expecting()(rows.nth(4)).to_contain_text("0010H")
    table = visit("#/models/vc660", language=language).locator("table", has_text=emergency)
    expecting()(table).to_be_visible()
    assert i18n.text("page.status_set", language) not in table.inner_text()


def test_a_start_that_needs_a_waiver_leads_to_the_panel_of_test_and_waiver(stage: Stage, visit: Any) -> None:
    """Regression: on a phone the sentence asks for a waiver, and its button stands two screens further down."""
    page = visit("#/drive/fan-1", size=(390, 844))
    page.click("[data-do=show-safety]")
    waive = page.locator("[data-do=waive]")
    expecting()(page.locator("#safety")).to_be_focused()
    expecting()(waive).to_be_in_viewport()
    stage.call("waiver.grant", drive="fan-1", reason="watched bench")
    page.locator("[data-do=show-safety]").wait_for(state="detached")
    other = visit("#/drive/fan-2", role="operator")
    other.locator("#start-blockers").wait_for()
    assert other.locator("[data-do=show-safety]").count() == 0


def test_the_faults_of_the_statistics_have_the_labels_of_the_keypad(stage: Stage, visit: Any, expect: Any) -> None:
    """They read "3: 3", and a code without a label was a bare number."""
    fault = {"code": 3, "label": "Fu.3", "text": {"en": "over-current", "zh": "过电流"}}

    def answer_with(name: str, faults: Any) -> None:
        def change(route: Any) -> None:
            answer = route.fetch()
            route.fulfill(response=answer, json=answer.json() | {"faults": faults})

        page.route(f"**/api/v1/drives/fan-3/{name}", change)

    page = visit("#/drive/fan-2")
    answer_with("profile", [fault])
    answer_with("statistics", {"3": 3, "9999": 1, "-1": 2})
    page.goto(f"{stage.at}/#/drive/fan-3?tab=statistics")
    expect(page.locator("[role=tabpanel]")).to_contain_text(
        f"Fu.3 × 3, {page_text('fault_code', code=9999)} × 1, {i18n.text('drives.unnamed_fault', 'en')} × 2"
    )


def test_a_fault_without_a_label_has_a_dash_in_its_place(visit: Any, expect: Any) -> None:
    page = visit("#/models/vc660?tab=faults")
    fault = page.get_by_role("region", name=page_text("all_faults")).locator("tbody tr").first
    expect(fault).to_contain_text("under-voltage")
    assert "" not in [cell.strip() for cell in fault.locator("td").all_inner_texts()]


def test_a_search_of_the_faults_finds_their_words_and_no_names_of_fields(visit: Any, expect: Any) -> None:
    """A search for "code" or "label" found every fault, and one for two words that are not neighbours found none."""
    page = visit("#/models/vc660?tab=faults")
    faults, field = page.get_by_role("region", name=page_text("all_faults")), page.locator("main input[type=search]")
    field.fill("label")
    expect(faults.locator("td.empty")).to_be_visible()
    field.fill("voltage under")
    expect(faults.locator("tbody tr").first).to_contain_text("under-voltage")


def test_the_groups_of_a_drive_stand_apart_from_each_other(visit: Any) -> None:
    """Regression: *Section 1 Ends of all lines* read as the name of one group."""
    page = visit("#/drive/fan-1")
    show_topics(page, {"drives/fan-1": {"groups": ["air", "water"]}})
    expecting()(page.locator(".identity")).to_contain_text("· Air · Water")
