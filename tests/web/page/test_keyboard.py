"""The page with the keyboard alone: the way to a stop, open windows, and keys that belong to an input method."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus import i18n
from fixtures.browser import Stage
from fixtures.browser_actions import NEW_HEADING, expecting, go_to, wait_until

FOCUSED_STOP = "() => document.activeElement.dataset.stop ?? document.activeElement.getAttribute('aria-label')"


@pytest.mark.parametrize(
    ("way", "stop"),
    [("#/drive/fan-1?tab=parameters", "drive"), ("#/fleet?group=air", "group"), ("#/settings?tab=users", "all")],
)
def test_one_key_leads_to_the_nearest_stop_and_with_shift_to_that_of_all(visit: Any, way: str, stop: str) -> None:
    """From the middle of a page the stop bar was up to a hundred presses of Tab away."""
    page = visit(way, role="administrator")
    page.locator(f"[data-stop={stop}]").wait_for()
    page.keyboard.press("F8")
    assert page.evaluate(FOCUSED_STOP) == stop
    page.keyboard.press("Shift+F8")
    assert page.evaluate(FOCUSED_STOP) == "all"


def test_two_keys_stop_a_drive_from_an_open_window_and_the_drive_of_a_tile(stage: Stage, visit: Any) -> None:
    page = visit("#/drive/fan-1")
    page.get_by_role("button", name=i18n.text("page.limits_change", "en")).press("Enter")
    page.locator("dialog input").first.focus()
    page.keyboard.press("F8")
    page.keyboard.press("Enter")
    page.locator(".stop-status.good", has_text="Supply fan").wait_for()
    page.goto(f"{stage.at}/#/fleet")
    page.locator("[data-drive=pump-2]").focus()
    page.keyboard.press("F8")
    assert page.evaluate(FOCUSED_STOP) == i18n.text("page.stop_named", "en", name="Feed pump")


def test_a_window_that_closes_by_itself_leaves_the_focus_at_the_stop(stage: Stage, visit: Any) -> None:
    """An answer between F8 and Enter gave the focus back to the button of the window, and Enter opened it again."""
    page = visit("#/drive/fan-1")
    page.get_by_role("button", name=i18n.text("page.limits_change", "en")).press("Enter")
    waiting: list[Any] = []
    page.route("**/limits", lambda route: waiting.append(route))
    with page.expect_request("**/limits"):
        page.locator("dialog [type=submit]").press("Enter")
    wait_until(page, lambda: bool(waiting), "the limits are not sent")
    page.keyboard.press("F8")
    waiting[0].fulfill(json={})
    page.locator("dialog").wait_for(state="detached")
    assert page.evaluate(FOCUSED_STOP) == "drive"


def test_a_held_enter_key_sends_one_stop(stage: Stage, visit: Any) -> None:
    """Each repeat sent another, and the few connections of a browser were taken when the stop of all was pressed."""
    page = visit("#/drive/fan-1")
    sent: list[str] = []
    page.on("request", lambda request: sent.append(request.url) if request.method == "POST" else None)
    page.locator("[data-stop=drive]").focus()
    for _ in range(5):
        page.keyboard.down("Enter")
    page.keyboard.up("Enter")
    page.locator(".stop-status.good").wait_for()
    assert len([url for url in sent if url.endswith("/stop")]) == 1


def test_no_key_leads_from_an_open_window_to_what_it_covers(visit: Any) -> None:
    """The buttons behind the window are not visible, and some of them start a drive."""
    page = visit("#/drive/fan-1")
    page.get_by_role("button", name=i18n.text("page.limits_change", "en")).press("Enter")
    page.locator("dialog").wait_for()
    seen = set()
    for _ in range(40):
        page.keyboard.press("Tab")
        seen.add(page.evaluate("document.activeElement.closest('dialog, .stopbar, .notices, main, .head')?.localName"))
    assert seen - {None} == {"dialog", "footer"}  # none: the browser's own buttons
    page.keyboard.press("F8")
    page.keyboard.press("Shift+Tab")
    assert page.evaluate("document.activeElement.closest('dialog') !== null")


def test_escape_withdraws_the_second_step_and_leaves_its_window_open(stage: Stage, visit: Any) -> None:
    page = visit("#/drive/fan-1")
    page.click("[data-do=take]")
    page.locator(".lease.own").wait_for()
    page.click("[data-do=test-comm-loss]")
    page.locator("dialog [data-step=first]").press("Enter")
    page.locator("dialog .confirm").press("Escape")
    page.locator("dialog [data-step=first]").wait_for()
    page.keyboard.press("Escape")
    page.locator("dialog").wait_for(state="detached")


UNCOVERED = """(one) => {
  const { left, top, width, height } = one.getBoundingClientRect();
  const places = [[0.1, 0.5], [0.5, 0.15], [0.5, 0.5], [0.5, 0.85], [0.9, 0.5]];
  return places.every(([x, y]) => one.contains(document.elementFromPoint(left + x * width, top + y * height)));
}"""


def test_what_has_the_focus_is_not_covered_by_what_stays_in_place(visit: Any) -> None:
    """Read lay below the fields of the parameters, and the end of a token below the buttons of its window."""
    page = visit("#/drive/fan-1?tab=parameters")
    page.click("[data-do=take]")
    page.locator("td.pinned input").first.wait_for()
    page.locator("[data-do=review]").scroll_into_view_if_needed()
    read = page.locator("td.corner .button").first
    page.locator("td.pinned input").first.focus()
    page.keyboard.press("Shift+Tab")
    assert read.evaluate("one => one === document.activeElement") and read.evaluate(UNCOVERED)
    go_to(page, "settings?tab=tokens")
    page.set_viewport_size({"width": 640, "height": 450})
    page.locator(NEW_HEADING).wait_for()
    page.locator("[role=tabpanel]").get_by_role("button").first.press("Enter")
    end = page.locator("dialog select")
    end.wait_for()
    for _ in range(20):
        page.keyboard.press("Tab")
        if end.evaluate("one => one === document.activeElement"):
            break
    assert end.evaluate(UNCOVERED)


def test_the_outline_of_what_has_the_focus_is_not_cut_off_at_the_top(visit: Any) -> None:
    """Regression: a button that the keyboard scrolled to stood at the very edge, without the upper line."""
    page = visit("#/drive/fan-1", size=(1280, 600))
    page.locator(".trend-plot canvas").wait_for()
    page.locator(".stop").first.focus()
    tops = []
    for _ in range(30):
        page.keyboard.press("Shift+Tab")
        tops.append(page.evaluate("document.activeElement.getBoundingClientRect().top"))
    assert min(tops) >= 5


COMPOSING = "(one, key) => one.dispatchEvent(new KeyboardEvent('keydown', { key, bubbles: true, isComposing: true }))"


def test_a_key_of_an_input_method_sets_no_frequency_and_closes_no_window(stage: Stage, visit: Any) -> None:
    """Enter takes over, and Escape drops, what is being composed: fullwidth digits, or the Chinese text of a reason."""
    expect = expecting()
    page = visit("#/drive/fan-1", language="zh")
    page.click("[data-do=take]")
    page.locator(".lease.own").wait_for()
    sent: list[str] = []
    page.on("request", lambda request: sent.append(request.url))
    field = page.locator(".control .frequency input[inputmode=decimal]").first
    field.fill("１２")
    field.evaluate(COMPOSING, "Enter")
    page.wait_for_timeout(200)
    assert not [url for url in sent if url.endswith("/set-frequency")]
    with page.expect_request("**/set-frequency"):
        field.press("Enter")
    page.click("[data-do=waive]")
    reason = page.locator("dialog input")
    reason.fill("台架")
    reason.evaluate(COMPOSING, "Escape")
    page.wait_for_timeout(200)
    expect(reason).to_have_value("台架")
    reason.press("Escape")
    page.locator("dialog").wait_for(state="detached")


ESCAPE_AT_ONCE = """async () => {
  document.querySelector('[data-stop=groups]').click();
  for (let n = 0; n < 1000 && !document.querySelector('.stopmenu'); n += 1) await null;
  const escape = new KeyboardEvent('keydown', { key: 'Escape', bubbles: true });
  document.querySelector('.stopmenu .stop').dispatchEvent(escape);
}"""
"""Script that presses Escape before the screen shows the menu."""


def test_escape_closes_a_menu_that_has_just_opened(visit: Any) -> None:
    """Regression: a menu listened from the frame after its first one on, and on a busy machine it stayed open."""
    page = visit("#/fleet")
    page.locator("[data-stop=groups]").wait_for()
    page.evaluate(ESCAPE_AT_ONCE)
    page.locator(".stopmenu").wait_for(state="detached")


def test_escape_closes_an_open_menu_and_leaves_the_focus_at_its_button(visit: Any) -> None:
    """At 200 % zoom the menu of the pages stayed open, and after that of the group stops the focus was lost."""
    page = visit("#/fleet", size=(640, 450))
    page.locator(".head .menu").press("Enter")
    page.locator("nav a").nth(1).focus()
    page.keyboard.press("Escape")
    page.locator("nav").wait_for(state="hidden")
    assert page.evaluate("document.activeElement.className") == "menu"
    page.locator("[data-stop=groups]").press("Enter")
    page.locator(".stopmenu .stop").first.focus()
    page.keyboard.press("Escape")
    page.locator(".stopmenu").wait_for(state="detached")
    page.locator("[data-stop=groups]:focus").wait_for()
