"""Two users and one drive: one asks for control, the other hands it over or keeps it."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus.service.control import leases
from fixtures.browser import Stage
from fixtures.browser_actions import page_text

REQUEST = "[data-request=pump-1]"


def test_the_holder_sees_who_asks_on_any_page_and_hands_over_or_keeps_control(
    stage: Stage, visit: Any, expect: Any
) -> None:
    engineer, operator = visit("#/drive/pump-1"), visit("#/drive/pump-1", role="operator", size=(360, 740))
    name = "Circulation pump"
    engineer.click("[data-do=take]")
    engineer.locator(".lease.own").wait_for()
    engineer.goto(f"{stage.at}/#/alarms")
    operator.click("[data-do=ask]")
    operator.fill("dialog input", "belt is slipping")
    operator.click("[data-do=send-request]")
    expect(operator.locator(".lease [role=timer]")).to_be_visible()
    asked = engineer.locator(REQUEST)
    expect(asked).to_contain_text(
        page_text("control_incoming_for", user="operator", name=name, reason="belt is slipping")
    )
    asked.locator("[data-do=hand-over]").click()
    granted = operator.locator("[data-answer=granted]")
    expect(granted).to_contain_text(page_text("control_answer_granted", by="engineer", name=name))
    operator.locator(".lease.own").wait_for()
    granted.locator("[data-do=read]").click()
    expect(granted).to_have_count(0)
    expect(engineer.locator(".takeovers .banner")).to_have_count(0)  # the engineer gave it: no takeover
    stage.wait(
        lambda: stage.service.plant.leases._leases["pump-1"].claimed, "the page does not renew what it was given"
    )
    engineer.goto(f"{stage.at}/#/drive/pump-1")
    engineer.click("[data-do=ask]")
    engineer.click("[data-do=send-request]")
    operator.locator(f"{REQUEST} [data-do=decline]").click()
    declined = page_text("control_answer_declined", by="operator", name=name)
    expect(engineer.locator("[data-answer=declined]")).to_contain_text(declined)
    assert stage.view("pump-1")["lease"]["owner"] == "operator"


def test_a_takeover_names_the_open_request_and_the_asker_can_withdraw_it(
    stage: Stage, visit: Any, expect: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(leases, "LEASE_TTL_S", 60.0)
    asker, engineer = visit("#/drive/fan-1", role="operator"), visit("#/drive/fan-1")
    stage.call("lease.take", drive="fan-1")
    asker.click("[data-do=ask]")
    asker.click("[data-do=send-request]")
    asked = page_text("control_asked_other", user="operator")
    expect(engineer.locator(".lease")).to_contain_text(asked)
    engineer.click(f".lease .button:has-text('{page_text('take_over')}')")
    expect(engineer.locator("dialog")).to_contain_text(asked)
    asker.click("[data-do=withdraw]")
    expect(engineer.locator("dialog")).not_to_contain_text(asked)


def test_a_group_asks_all_holders_at_once_and_withdraws_at_once(stage: Stage, visit: Any, expect: Any) -> None:
    """The holder gets one notice with both drives, the asker one dialog and one button that withdraws both requests."""
    engineer = visit("#/fleet?group=water")
    operator = visit("#/fleet?group=water", role="operator", size=(360, 560))
    for page in (engineer, operator):
        page.click(".grouppanel summary")
    text, take = (
        engineer.locator(f".grouppanel details .row {selector}").first.bounding_box()
        for selector in ("> span", ".button")
    )
    assert abs(text["y"] + text["height"] / 2 - take["y"] - take["height"] / 2) < 3, "the text is not beside its button"
    engineer.click(".grouppanel .button.main")
    ask, held = operator.locator("[data-select='/control-requests']"), engineer.locator("[data-request]")
    for end in ("withdraw", "hand-over"):
        # Control of the two drives is taken one after the other.
        expect(ask).to_contain_text(page_text("control_ask_all", n=2))
        ask.click()
        operator.fill("dialog input:not([type=checkbox])", "pump exchange")
        operator.click("[data-do=selection]")
        names = "Circulation pump, Feed pump"
        expect(operator.locator("dialog .notice")).to_have_text(page_text("selection_done", names=names))
        done, close = (operator.locator(f"dialog {selector}").bounding_box() for selector in (".notice", ".row.end"))
        assert done["y"] + done["height"] <= close["y"], "the result is hidden behind the button"
        asked = page_text("control_incoming_for", user="operator", name=names, reason="pump exchange")
        expect(held).to_contain_text(asked)
        assert held.count() == 1
        operator.keyboard.press("Escape")
        if end == "withdraw":
            operator.click(".grouppanel [data-do=withdraw]")
            expect(held).to_have_count(0)
            stage.service.plant.control_requests._requested_at.clear()
        else:
            held.locator("[data-do=hand-over]").click()
            granted = operator.locator("[data-answer=granted]")
            expect(granted).to_contain_text(page_text("control_answer_granted", by="engineer", name=names))
            assert granted.count() == 1
    assert [stage.view(drive)["lease"]["owner"] for drive in ("pump-1", "pump-2")] == ["operator"] * 2


def test_control_that_was_handed_over_and_taken_back_is_no_longer_announced(
    stage: Stage, visit: Any, expect: Any
) -> None:
    """The notice of the hand-over stood beside that of the takeover, as if the user still had control."""
    engineer, operator = visit("#/drive/pump-1"), visit("#/drive/pump-1", role="operator")
    engineer.click("[data-do=take]")
    operator.click("[data-do=ask]")
    operator.click("[data-do=send-request]")
    engineer.locator(f"{REQUEST} [data-do=hand-over]").click()
    expect(operator.locator("[data-answer=granted]")).to_be_visible()
    engineer.click(f".lease .button:has-text('{page_text('take_over')}')")
    engineer.click("dialog .button.main")
    expect(operator.locator(".takeovers .banner")).to_have_count(1)
    expect(operator.locator(".takeovers .banner")).to_contain_text("engineer took control of Circulation pump from you")
