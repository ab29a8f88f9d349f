"""Release of many drives, the last stop, a second window, and the communication-loss test, on a real plant."""

from __future__ import annotations

import re
from typing import Any

import pytest

from drivebus import i18n
from fixtures.browser import Stage
from fixtures.browser_actions import expecting


def test_after_a_stop_of_all_one_dialog_releases_the_chosen_drives(stage: Stage, visit: Any) -> None:
    page = visit("#/drive/pump-1", size=(360, 560))
    every = [view["id"] for view in stage.call("drives.list")["drives"]]
    page.click(".stop[data-stop=all]")
    page.locator("[data-stop-by=all]", has_text="Bus stop of all drives by").wait_for()
    page.locator(".stopbar [data-select]", has_text=str(len(every))).click()
    expecting()(page.locator("dialog input[type=checkbox]")).to_have_count(len(every))
    box, act, bar = (
        page.locator(selector).bounding_box() for selector in ("dialog", "[data-do=selection]", ".stopbar")
    )
    assert act["y"] + act["height"] <= box["y"] + box["height"] <= bar["y"], "the dialog's buttons are below the fold"
    line = page.locator("dialog [data-do=choose-none]").evaluate("(one) => getComputedStyle(one).textDecorationLine")
    assert line == "underline", "a button that looks like text"
    page.click("dialog [data-do=choose-none]")
    assert page.locator("dialog input:checked").count() == 0 and page.locator("[data-do=selection]").is_disabled()
    page.click("dialog [data-do=choose-all]")
    page.locator("dialog input[type=checkbox]").first.uncheck()
    page.click("[data-do=selection]")
    page.locator("dialog .notice li").wait_for()
    assert [id for id in every if stage.view(id)["start_inhibited"]] == every[:1]


def test_the_tab_key_passes_the_drives_of_a_dialog_in_one_step_and_enter_among_them_sends_nothing(
    stage: Stage, visit: Any
) -> None:
    """Regression: 300 presses lay before its buttons, and Enter on any of the check boxes released every drive."""
    page = visit("#/drive/pump-1")
    page.click(".stop[data-stop=all]")
    page.locator("[data-stop-by=all]").wait_for()
    page.locator(".stopbar [data-select]", has_text=str(len(stage.service.plant.drives))).click()
    boxes = page.locator("dialog input[type=checkbox]")
    page.locator("dialog [data-do=choose-none]").focus()
    page.keyboard.press("Tab")
    for key in ("ArrowRight", "Space", "Enter"):
        page.keyboard.press(key)
    assert [box.is_checked() for box in boxes.all()] == [True, False, True, True, True]
    page.keyboard.press("Tab")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.dataset.do") == "selection"
    page.keyboard.press("Shift+Tab")
    page.keyboard.press("Shift+Tab")
    expecting()(boxes.nth(1)).to_be_focused()
    assert all(stage.view(drive)["start_inhibited"] for drive in stage.service.plant.drives)


def test_a_long_name_in_a_dialog_for_many_drives_covers_no_other_name(stage: Stage, visit: Any) -> None:
    """Regression: on a phone its lines stood over the names of the drives below it."""
    page = visit("#/fleet?group=air", size=(360, 560))
    page.click(".stop[data-stop=all]")
    page.click(".stopbar [data-select]")
    name = page.locator("dialog .check").first
    name.evaluate("(one) => one.append(' Smoke extraction fan'.repeat(10))")
    assert name.evaluate("(one) => one.scrollHeight - one.clientHeight") <= 1


@pytest.mark.parametrize("size", [(640, 450), (740, 360)], ids=["zoomed", "phone on its side"])
@pytest.mark.parametrize("language", ["en", "zh"])
def test_on_a_low_screen_the_reason_of_a_waiver_is_seen_above_the_buttons(
    stage: Stage, visit: Any, language: str, size: tuple[int, int]
) -> None:
    """Regression: the field was behind the buttons, and the button that waits for it looked broken."""
    page = visit("#/fleet?group=air", language=language, size=size)
    page.locator(".grouppanel summary").first.click()
    page.click("main [data-select='/waivers']")
    names, reason, act, box = (
        page.locator(selector).bounding_box()
        for selector in (
            ".dialog .choices",
            ".dialog form input:not([type=checkbox])",
            "[data-do=selection]",
            ".dialog",
        )
    )
    assert box["y"] >= 0 and names["y"] + names["height"] <= reason["y"]
    assert reason["y"] + reason["height"] <= act["y"]
    assert act["y"] + act["height"] <= page.locator(".stopbar").bounding_box()["y"]


def test_the_same_user_in_a_second_window_is_named_as_you(stage: Stage, visit: Any) -> None:
    first, second = visit("#/drive/pump-1"), visit("#/drive/pump-1", language="zh")
    first.click("[data-do=take]")
    text = i18n.text("page.lease_other_window", "zh")
    second.locator(".lease .holder", has_text=text).wait_for()
    take_over = i18n.text("page.take_over", "zh")
    second.click(f".lease .button:has-text('{take_over}')")
    second.click(f"dialog .button.main:has-text('{take_over}')")
    first.locator(".takeovers .banner", has_text="in another window").wait_for()


def test_a_release_in_one_tab_is_announced_in_the_other_and_a_closed_tab_takes_nothing(
    stage: Stage, visit: Any
) -> None:
    """Two tabs of a browser are one session: both command, and neither loses control without a sentence."""
    first = visit("#/drive/pump-1")
    second = first.context.new_page()
    second.goto(first.url)
    first.click("[data-do=take]")
    for page in (first, second):
        page.locator(".lease.own").wait_for()
    second.click(".lease.own button")
    first.locator(".takeovers .banner", has_text="in another tab of this browser").wait_for()
    assert second.locator(".takeovers .banner").count() == 0
    second.click("[data-do=take]")
    first.locator(".lease.own").wait_for()
    second.close()
    held = stage.view("pump-1")["lease"]["expires_ms"]
    stage.wait(lambda: stage.view("pump-1")["lease"]["expires_ms"] > held, "the remaining tab does not renew")
    stage.call("lease.take", drive="pump-1")
    first.locator(".takeovers .banner", has_text="tester took control").wait_for()


def test_a_communication_loss_test_is_started_in_two_steps_and_shows_its_silence(stage: Stage, visit: Any) -> None:
    page = visit("#/drive/pump-1")
    page.click("[data-do=take]")
    page.locator(".lease.own").wait_for()
    page.click("[data-do=test-comm-loss]")
    page.click("dialog [data-step=first]")
    page.click("dialog [data-step=second]")
    stage.wait(lambda: (stage.view("pump-1")["comm_loss"]["test"] or {}).get("phase") == "silent", "no silence")
    shown = page.locator(".notice", has_text="for ").locator("p", has_text=" s more").inner_text()
    assert 0 < int(re.search(r"for (\d+) s more", shown)[1]) <= 60, shown  # seconds to the end, not an absolute time
    page.locator("[data-do=read-now]").wait_for()
    page.click(".stop[data-stop=drive]")
    stage.wait(lambda: stage.view("pump-1")["comm_loss"]["test"] is None, "the test goes on after a stop")
    page.locator("[data-do=test-comm-loss]").wait_for()
    assert stage.view("pump-1")["comm_loss"]["tested"] is None


@pytest.mark.parametrize(("language", "asked"), [("en", "at 10.00 Hz, and"), ("zh", "以 10.00 Hz 运行")])
def test_the_second_step_of_a_communication_loss_test_names_its_frequency_with_the_unit(
    visit: Any, language: str, asked: str
) -> None:
    """Regression: the motor ran "at 10.00"."""
    page = visit("#/drive/pump-1", language=language)
    page.click("[data-do=take]")
    page.locator(".lease.own").wait_for()
    page.click("[data-do=test-comm-loss]")
    page.click("dialog [data-step=first]")
    expecting()(page.locator("dialog .confirm")).to_contain_text(asked)


def test_a_withheld_stop_is_sent_after_the_name_plate_was_read(visit: Any) -> None:
    """The stop of one model may start another: the page says so, and asks for the model on the name plate."""
    sent: list[Any] = []

    def answer(route: Any) -> None:
        sent.append(route.request.post_data_json)
        text = {"en": "STOP NOT SENT", "zh": "x"}
        outcome = {"status": "failed", "key": "drives.stop_withheld", "text": text, "notes": [], "frames": []}
        error = {"code": "drives.stop_withheld", "kind": "StopUnconfirmed", "params": {}, "text": text}
        route.fulfill(status=500, json={"error": {**error, "outcome": outcome}})

    page = visit("#/drive/pump-1")
    page.route("**/api/v1/drives/pump-1/stop", answer)
    page.click(".control [data-do=coast]")
    page.locator(".stop-status.bad", has_text="STOP NOT SENT").wait_for()
    page.click(".stopbar [data-do=stop-anyway]")
    page.locator("dialog .notice.warning", has_text="may START the motor").wait_for()
    assert page.locator("[data-do=stop-anyway-send]").is_disabled()
    page.check("dialog input[type=checkbox]")
    page.unroute("**/api/v1/drives/pump-1/stop")
    with page.expect_request("**/api/v1/drives/pump-1/stop") as forced:
        page.click("[data-do=stop-anyway-send]")
    assert sent == [{"how": "coast"}] and forced.value.post_data_json == {"how": "coast", "assume_model": True}
    page.locator(".stop-status.good").wait_for()
    assert page.locator("[data-do=stop-anyway]").count() == 0
