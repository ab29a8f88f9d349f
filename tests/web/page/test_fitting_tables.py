"""Tables on every width of a screen: no cell, field or button is cut off."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus import i18n
from fixtures.browser import Stage
from fixtures.browser_actions import page_text, trip, wait_for_event


@pytest.mark.parametrize("language", ["en", "zh"])
def test_on_a_phone_a_date_of_a_table_is_not_broken_at_its_hyphens(stage: Stage, visit: Any, language: str) -> None:
    trip(stage, "fan-3")
    wait_for_event(stage, "fan-3", "fault")
    broken = {}
    for way in ("drive/fan-3?tab=faults", "settings", "settings?tab=users"):
        page = visit(f"#/{way}", language=language, role="administrator", size=(360, 740))
        page.locator("td.time").first.wait_for()
        heights = page.locator("td.time").evaluate_all(TEXT_LINES)
        broken[way] = [lines for lines in heights if lines > 2]
    assert broken == {way: [] for way in broken}


TEXT_LINES = """all => all.map((one) => {
  const range = document.createRange();
  range.selectNodeContents(one);
  return new Set([...range.getClientRects()].map((box) => Math.round(box.top))).size;
})"""


@pytest.mark.parametrize("language", ["en", "zh"])
def test_no_cell_of_the_parameters_of_a_drive_is_cut_off_on_a_phone(stage: Stage, visit: Any, language: str) -> None:
    """Value, range and the field of a change were beyond the right edge of a table of ten columns."""
    stage.call("waiver.grant", drive="pump-1", reason="watched bench")
    page = visit("#/drive/pump-1?tab=parameters", size=(360, 740), language=language)
    page.click("[data-do=take]")
    page.locator("td input").first.wait_for()
    page.click("[data-do=read]")
    page.locator(".stacks td b").first.wait_for()
    assert page.evaluate(CELLS_OUT_OF_PLACE) == []
    row = page.locator(".stacks tbody tr", has=page.locator("td input")).first
    name, field, read = (
        row.locator(where).bounding_box() for where in ("td.key code", "td input", "td.corner .button")
    )
    assert name["y"] + name["height"] <= field["y"]
    assert name["x"] + name["width"] <= read["x"] and read["y"] < field["y"]


def test_on_a_narrow_phone_no_choice_of_the_export_is_cut_off(visit: Any) -> None:
    """Regression: of *CSV, one row a value, with quality* the last word was cut off."""
    page = visit("#/history", size=(320, 640))
    choice = page.locator(".export .choice").nth(1)
    right = "(one) => one.getBoundingClientRect().right"
    end = choice.evaluate(right)
    assert max(button.evaluate(right) for button in choice.locator("button").all()) <= end


WORDS_OF_TWO_LINES = """all => all.flatMap((one) => {
  const texts = document.createTreeWalker(one, NodeFilter.SHOW_TEXT), broken = [];
  while (texts.nextNode()) {
    for (const word of texts.currentNode.data.matchAll(/\\S+/g)) {
      const range = document.createRange();
      range.setStart(texts.currentNode, word.index);
      range.setEnd(texts.currentNode, word.index + word[0].length);
      if (new Set([...range.getClientRects()].map((box) => Math.round(box.top))).size > 1) broken.push(word[0]);
    }
  }
  return broken;
})"""


def test_the_words_of_a_parameter_stay_whole_on_a_phone_with_large_text(visit: Any) -> None:
    """Regression: at one and a half times the size of the text a name was "communicat-ion loss time"."""
    page = visit("#/drive/fan-1?tab=parameters", size=(240, 493))
    names = page.locator(".paramtext")
    names.first.wait_for()
    assert "communication loss time" in names.all_inner_texts()
    assert names.evaluate_all(WORDS_OF_TWO_LINES) == []


def test_the_field_of_a_parameter_stays_in_sight_while_its_table_scrolls(stage: Stage, visit: Any) -> None:
    """It was the last of ten columns, beyond the right edge of a panel that a screen of 1440 pixels gives 800."""
    stage.call("waiver.grant", drive="pump-1", reason="watched bench")
    page = visit("#/drive/pump-1?tab=parameters", size=(1024, 768))
    page.click("[data-do=take]")
    page.locator("td input").first.wait_for()
    edge, field = (page.locator(where).first.bounding_box() for where in (".drivedetails .scroll", "td input"))
    assert field["x"] + field["width"] <= edge["x"] + edge["width"] + 1


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_table_of_parameters_fits_a_screen_of_1280_pixels_and_with_its_fields_one_of_1440(
    stage: Stage, visit: Any, language: str
) -> None:
    """Regression: the column of the fields, which stays in sight, covered that of the ranges.

    At 1280 pixels the buttons that read a parameter were beyond the right edge.
    """
    page = visit("#/drive/pump-1?tab=parameters", size=(1280, 800), language=language)
    page.locator(".drivedetails td").first.wait_for()
    table, beyond = page.locator(".drivedetails .scroll"), "(table) => table.scrollWidth - table.clientWidth"
    assert table.evaluate(beyond) <= 0
    page.set_viewport_size({"width": 1440, "height": 900})
    page.click("[data-do=take]")
    page.locator("td input").first.wait_for()
    page.click("[data-do=read]")
    page.locator(".drivedetails td b").first.wait_for()
    assert table.evaluate(beyond) <= 0


def test_no_cell_of_the_stations_of_a_bus_is_cut_off_on_a_phone(visit: Any, expect: Any) -> None:
    """Seven of nine columns were beyond the right edge, and their sentences made the rows tall."""
    page = visit("#/buses/fans", size=(360, 740))
    expect(page.locator(".stacks tbody tr")).to_have_count(3)
    assert page.evaluate(CELLS_OUT_OF_PLACE) == []
    nodes = [node.bounding_box() for node in page.locator(".cable li").all()]
    assert len({box["y"] for box in nodes[:3]}) == 1


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("way", ["models", "models/c320"])
def test_no_cell_of_the_models_and_of_their_signals_is_cut_off_on_a_phone(
    visit: Any, expect: Any, way: str, language: str
) -> None:
    """Regression: encodings, settings and what a model can't do were beyond the right edge."""
    page = visit(f"#/{way}", size=(390, 844), language=language)
    expect(page.locator(".stacks tbody tr").nth(2)).to_be_visible()
    assert page.evaluate(CELLS_OUT_OF_PLACE) == []
    wide = page.locator("main .scroll").evaluate_all(
        "(all) => all.filter((one) => one.scrollWidth > one.clientWidth).length"
    )
    assert wide == 0


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("size", [(390, 844), (683, 384)], ids=["phone", "zoomed to 200 %"])
def test_the_reason_of_a_missing_value_of_a_tripped_drive_is_not_cut_off(
    stage: Stage, visit: Any, expect: Any, size: tuple[int, int], language: str
) -> None:
    """Regression: its end was cut off, and only a mouse could show it."""
    trip(stage, "fan-3")
    page = visit("#/drive/fan-3", size=size, language=language)
    reason = i18n.text("drives.item_not_echoed", language)
    shown = page.locator(".values .reason span", has_text=reason)
    expect(shown.first).to_be_visible()
    cut = shown.evaluate_all("(all) => all.filter((one) => one.scrollHeight > one.clientHeight + 2).length")
    assert cut == 0


@pytest.mark.parametrize("tab", ["users", "tokens"])
def test_the_actions_of_a_row_are_visible_on_a_phone(stage: Stage, visit: Any, tab: str) -> None:
    page = visit(f"#/settings?tab={tab}", role="administrator", size=(360, 740))
    if tab == "tokens":
        page.click(".panel .button.main")
        page.fill("dialog input >> nth=0", "history")
        page.click("dialog button[type=submit]")
    act = page.locator("td.act .button").first
    act.wait_for()
    edge = page.locator(".panel .scroll").bounding_box()
    box = act.bounding_box()
    assert box["x"] + box["width"] <= edge["x"] + edge["width"] <= 360


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("tab", ["users", "tokens", "me"])
def test_no_cell_of_a_users_tables_is_cut_off_on_a_phone(visit: Any, tab: str, language: str) -> None:
    """The end of a token's validity was behind the button that removes it."""
    page = visit(f"#/settings?tab={tab}", role="administrator", size=(375, 812), language=language)
    if tab == "tokens":
        page.click(".panel .button.main")
        page.fill("dialog input >> nth=0", "history-of-the-boiler-house")
        for box in page.locator("dialog input[type=checkbox]").all():
            box.check()
        page.click("dialog button[type=submit]")
    page.locator(".stacks td.act .button").first.wait_for()
    assert page.evaluate(CELLS_OUT_OF_PLACE) == []
    titles = page.locator(".stacks tbody tr").first.locator("td").evaluate_all(TITLES_OF_CELLS)
    heads = page.locator(".stacks thead th").all_text_contents()
    assert titles == ["none", *(f'"{head}"' for head in heads[1:-1]), "none"]


def test_nothing_of_an_incident_is_beyond_the_edge_of_a_phone(stage: Stage, visit: Any) -> None:
    """The meaning of a frame, the value of a parameter, and whether a drive was online, were beyond the right edge."""
    trip(stage, "fan-3")
    page = visit("#/alarms?tab=incidents", size=(360, 740))
    page.locator(".incidents a").first.click()
    for title in ("incident_states", "incident_parameters", "frames_title"):
        page.get_by_role("region", name=page_text(title)).locator("tbody td").nth(3).wait_for()
    assert page.evaluate(CELLS_OUT_OF_PLACE) == []
    beyond = "(tables) => tables.map((one) => one.scrollWidth - one.clientWidth)"
    assert max(page.locator("main .scroll").evaluate_all(beyond)) <= 0
    head = page.get_by_role("region", name=page_text("incident_parameters")).locator("thead")
    assert page_text("wire_address") in head.inner_text(), "another word than in the parameters of a drive"


CELLS_OUT_OF_PLACE = """() => [...document.querySelectorAll(".stacks td")].filter((cell) => {
  const [box, edge] = [cell, cell.closest(".panel")].map((one) => one.getBoundingClientRect());
  if (box.width === 0) return false; // an empty cell is not shown
  const titleHeight = parseFloat(getComputedStyle(cell, "::before").height);
  const isWide = box.left < edge.left || box.right > edge.right || cell.scrollWidth > cell.clientWidth;
  return isWide || titleHeight > box.height;
}).map((cell) => cell.textContent)"""


TITLES_OF_CELLS = "(cells) => cells.map((cell) => getComputedStyle(cell, '::before').content)"
