"""Keyboard focus, and whether what can be pressed looks like it."""

from __future__ import annotations

from typing import Any

from drivebus import i18n
from fixtures.browser import Stage
from fixtures.browser_actions import trip


def test_the_focus_stays_in_the_control_panel_while_its_buttons_come_and_go(stage: Stage, visit: Any) -> None:
    """After Take control, Cancel of a start and Release the next Tab leads on from there; no button is focused."""
    stage.call("waiver.grant", drive="fan-1", reason="watched bench")
    page = visit("#/drive/fan-1")
    page.locator("[data-do=take]").press("Enter")
    page.wait_for_selector(".lease.own")
    page.locator("section.control:focus").wait_for()
    page.fill(".control .frequency input[inputmode=decimal]", "20")
    page.locator("[data-step=first]").press("Enter")
    page.locator(".confirm").press("Escape")
    page.locator("[data-step=first]").wait_for()
    page.locator("section.control:focus").wait_for()
    page.locator(".lease .button").press("Enter")
    page.wait_for_selector("[data-do=take]")
    page.locator(".control:focus, .control :focus").first.wait_for()
    page.mouse.click(2, 400)  # the ground of the page: the focus does not jump back
    page.wait_for_timeout(50)
    assert page.evaluate("document.activeElement.tagName") == "MAIN"


def test_a_window_returns_the_focus_and_its_opener_looks_like_an_action(stage: Stage, visit: Any) -> None:
    page = visit("#/drive/fan-1")
    opener = page.get_by_role("button", name=i18n.text("page.limits_change", "en"))
    opener.wait_for()
    assert opener.evaluate("one => getComputedStyle(one).textDecorationLine") == "underline"
    opener.press("Enter")
    page.keyboard.press("Escape")
    page.locator("dialog").wait_for(state="detached")
    assert opener.evaluate("one => one === document.activeElement")


def test_the_focus_stays_at_the_stop_bar_and_the_notices_whose_buttons_go(stage: Stage, visit: Any) -> None:
    """Regression: after a stop result was dismissed, or its drives released, Tab began at the top of the page."""
    page = visit("#/drive/pump-1")
    page.locator("[data-do=take]").press("Enter")
    page.wait_for_selector(".lease.own")
    stage.call("lease.take", drive="pump-1")
    page.locator(".takeovers .banner .button").press("Enter")
    page.locator(".notices:focus").wait_for(state="attached")  # empty then, and without a size
    stage.call("lease.release", drive="pump-1")
    page.locator(".stop[data-stop=all]").press("Enter")
    page.locator("[data-do=dismiss-stop]").press("Enter")
    page.locator(".stopbar:focus").wait_for()
    page.locator(".stopbar [data-select]").press("Enter")
    page.locator("[data-do=selection]").press("Enter")
    page.locator("dialog .notice").wait_for()
    page.locator("dialog .row.end .button").press("Enter")
    page.locator(".stopbar:focus").wait_for()
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.dataset.stop") == "drive"


def test_a_press_beside_a_window_closes_it_only_while_nothing_was_typed(visit: Any) -> None:
    """A slip of the pointer lost a whole form."""
    page = visit("#/drive/fan-1")
    opener = page.get_by_role("button", name=i18n.text("page.limits_change", "en"))
    window = page.locator("dialog")
    opener.click()
    page.mouse.click(5, 300)
    window.wait_for(state="detached")
    opener.click()
    window.locator("input").first.fill("12")
    page.mouse.click(5, 300)
    page.keyboard.press("Tab")  # drawn again meanwhile
    assert window.locator("input").first.input_value() == "12"
    page.keyboard.press("Escape")
    window.wait_for(state="detached")


def test_a_choice_in_a_window_counts_as_input_for_a_press_beside_it(scripts: Any) -> None:
    """Regression: the minutes of a shelving were lost."""
    kept = scripts.evaluate("""async () => {
      const [lib, ui] = await Promise.all(["lib", "ui"].map((name) => import(`/static/js/${name}.js`)));
      const root = document.body.appendChild(document.createElement("div"));
      let closed = 0;
      const choice = lib.h(ui.Choice, { value: 1, options: [[1, "one"], [2, "two"]], onChange: () => null });
      lib.render(lib.h(ui.Dialog, { title: "", onClose: () => { closed += 1; } }, choice), root);
      root.querySelector(".choice button").click();
      root.querySelector(".veil").click();
      const kept = closed === 0;
      lib.render(null, root);
      root.remove();
      return kept;
    }""")
    assert kept


def test_the_focus_stays_in_the_row_of_an_alarm_that_is_acknowledged(stage: Stage, visit: Any) -> None:
    """It went to the top of the page, from where the next alarm is many presses of Tab away."""
    trip(stage, "pump-2")
    page = visit("#/alarms")
    row = page.locator(".alarmrow", has_text="Feed pump").first
    row.locator("[data-alarm=acknowledge]").press("Enter")
    row.locator("[data-alarm=acknowledge]").wait_for(state="detached")
    page.wait_for_function("() => document.activeElement.matches('.alarmrow')")
    page.keyboard.press("Tab")
    assert row.evaluate("one => one.contains(document.activeElement) && one !== document.activeElement")


def test_the_row_that_has_the_focus_is_in_view_where_its_acknowledgement_has_moved_it(stage: Stage, visit: Any) -> None:
    """Regression: the keyboard's place in the list was below the stop bar, or beyond the end of the screen."""
    for drive in ("fan-1", "pump-1", "pump-2", "fan-2"):
        trip(stage, drive)
    page = visit("#/alarms", role="operator", size=(1280, 420))
    row = page.locator(".alarmrow").first
    row.wait_for()
    name = row.locator(".what a").inner_text()
    row.locator("[data-alarm=acknowledge]").press("Enter")
    page.locator(".alarmrow", has_text=name).locator("[data-alarm=acknowledge]").wait_for(state="detached")
    page.wait_for_function("() => document.activeElement.matches('.alarmrow')")
    place = page.evaluate("document.activeElement.getBoundingClientRect().toJSON()")
    bar = page.locator(".stopbar").bounding_box()
    assert name in page.evaluate("document.activeElement.innerText")
    assert place["top"] >= 0 and place["bottom"] <= bar["y"]


def test_a_check_box_keeps_its_size_beside_a_long_label(visit: Any) -> None:
    page = visit("#/settings?tab=configuration", role="administrator", size=(360, 740))
    box = page.locator(".check input").first
    box.wait_for()
    box.evaluate("one => one.parentElement.append(' a label of many words that wrap on a phone'.repeat(3))")
    assert box.bounding_box()["width"] == 20
