"""Idle sessions on the page: they can view and stop, the password restores the other rights, and leases stay."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from drivebus import i18n
from drivebus.service.auth.sessions import SESSION_IDLE_TIMEOUT_S
from drivebus.values import Text
from fixtures.browser import Stage
from fixtures.browser_actions import wait_until
from fixtures.service import WIDEST_LIMITS
from fixtures.web_app import PASSWORD


def fall_idle(stage: Stage, user: str = "operator") -> None:
    """Let the sessions of a user become idle."""
    for session in stage.access.sessions.of_user(user):
        session.active -= SESSION_IDLE_TIMEOUT_S


@pytest.mark.parametrize("language", ["en", "zh"])
def test_an_idle_page_can_stop_and_its_password_unlocks_it(stage: Stage, visit: Any, language: str) -> None:
    page = visit("#/drive/fan-1", language=language, role="operator")
    page.click("[data-do=take]")
    page.wait_for_selector(".lease.own")
    fall_idle(stage)
    page.reload()
    page.wait_for_selector("[data-do=unlock]")
    assert page.locator("[data-step=first]:enabled").count() == 0
    assert page.locator(".stopbar button:enabled").count() > 0

    page.fill("[data-do=unlock] input[type=password]", PASSWORD)
    page.click("[data-do=unlock] button[type=submit]")
    page.wait_for_selector("[data-do=unlock]", state="detached")
    page.wait_for_selector(".lease.own")


def test_an_idle_page_of_the_audit_trail_asks_for_the_password(stage: Stage, visit: Any) -> None:
    """The page denied that the account has a right to see the trail."""
    page = visit("#/audit")
    page.locator(".entry").first.wait_for()
    fall_idle(stage, "engineer")
    page.reload()
    page.locator("main .notice", has_text=i18n.text("page.idle", "en")).wait_for()
    page.fill("[data-do=unlock] input[type=password]", PASSWORD)
    page.click("[data-do=unlock] button[type=submit]")
    page.locator(".entry").first.wait_for()


def test_a_request_of_before_the_unlocking_that_is_refused_after_it_does_not_log_out(stage: Stage, visit: Any) -> None:
    """Regression: unlocking replaces the cookie, and a request with the old one was still on its way."""
    page = visit("#/drive/fan-1", role="operator")
    fall_idle(stage)
    held: list[Any] = []
    page.route("**/api/v1/history/tags*", lambda request: held.append(request))
    with page.expect_request("**/api/v1/history/tags*"):
        page.reload()
    page.fill("[data-do=unlock] input[type=password]", PASSWORD)
    page.click("[data-do=unlock] button[type=submit]")
    page.wait_for_selector("[data-do=unlock]", state="detached")
    wait_until(page, lambda: bool(held), "no request was on its way")
    for request in held:
        request.fulfill(status=401, json={"error": {"code": "auth.not_logged_in", "kind": "NotAuthenticated"}})
    page.wait_for_timeout(300)
    page.click("[data-do=take]")
    page.wait_for_selector(".lease.own")


def test_an_answer_to_the_cookie_of_before_the_unlocking_does_not_log_out(stage: Stage, visit: Any) -> None:
    """Regression: a page that lost its connection asked for its session, which the old cookie no longer has."""
    page = visit("#/drive/fan-1", role="operator")
    fall_idle(stage)
    page.reload()
    page.wait_for_selector("[data-do=unlock]")
    held: list[Any] = []
    page.route("**/api/v1/session", lambda request: held.append(request), times=1)
    with page.expect_request("**/api/v1/session"):
        page.evaluate("() => { import('/static/js/session.js').then((found) => found.loadSession()); }")
    page.fill("[data-do=unlock] input[type=password]", PASSWORD)
    page.click("[data-do=unlock] button[type=submit]")
    page.wait_for_selector("[data-do=unlock]", state="detached")
    wait_until(page, lambda: bool(held), "the session is not asked for")
    [request] = held
    request.fulfill(json={"user": None, "rights": [], "csrf": None, "setup": False})
    page.wait_for_timeout(300)
    page.click("[data-do=take]")
    page.wait_for_selector(".lease.own")


@pytest.mark.parametrize("size", [(1280, 900), (390, 844)])
def test_a_dialog_of_a_session_that_falls_idle_is_unlocked_in_place_and_keeps_its_input(
    stage: Stage, visit: Any, size: tuple[int, int]
) -> None:
    """Regression: the form stood behind the dialog's veil, a minute later; a press on it closed the dialog."""
    page = visit("#/drive/fan-2", size=size)
    try:
        page.click(f"text={i18n.text('page.limits_change', 'en')}")
        page.fill(".dialog input[inputmode=decimal] >> nth=1", "41")
        fall_idle(stage, "engineer")
        page.click(".dialog button[type=submit]")
        page.fill("[data-do=unlock] input[type=password]", PASSWORD)
        assert page.locator(".stopbar .stop").first.is_enabled()
        page.click("[data-do=unlock] button[type=submit]")
        page.wait_for_selector("[data-do=unlock]", state="detached")
        page.click(".dialog button[type=submit]")
        page.locator(".dialog").wait_for(state="detached")
        assert stage.view("fan-2")["maximum_hz"] == 41.0
    finally:
        stage.call("drive.limits", drive="fan-2", **WIDEST_LIMITS)


def test_the_keyboard_reaches_the_password_from_an_open_dialog(stage: Stage, visit: Any) -> None:
    """Tab led from the stop bar back to the dialog, whose commands were all refused."""
    page = visit("#/drive/fan-2")
    page.click(f"text={i18n.text('page.limits_change', 'en')}")
    fall_idle(stage, "engineer")
    page.press(".dialog button[type=submit]", "Enter")
    page.wait_for_selector("[data-do=unlock]")
    for _ in range(20):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.type") == "password":
            break
    page.keyboard.type(PASSWORD)
    page.keyboard.press("Enter")
    page.wait_for_selector("[data-do=unlock]", state="detached")
    assert page.locator(".dialog").is_visible()


def test_a_notice_of_the_service_stays_until_it_is_closed_and_a_new_one_comes(stage: Stage, visit: Any) -> None:
    page = visit("#/fleet", language="zh", role="operator")
    try:
        stage.service.plant.notice = {"en": "the first", "zh": "第一条"}
        page.wait_for_selector("[data-text=notice]:has-text('第一条')")
        close = page.locator("[data-do=close-notice]")
        assert close.evaluate("one => getComputedStyle(one).textDecorationLine") == "underline"
        close.click()
        page.wait_for_selector("[data-text=notice]", state="detached")
        stage.service.plant.notice = {"en": "the second", "zh": "第二条"}
        page.wait_for_selector("[data-text=notice]:has-text('第二条')")
    finally:
        stage.service.plant.notice = None
    page.wait_for_selector("[data-text=notice]", state="detached")


def test_the_configured_notice_is_on_the_login_page_and_in_the_form_that_unlocks(stage: Stage, visit: Any) -> None:
    context = stage._app.state.context
    stage._app.state.context = replace(context, login_notice=Text("authorized staff only", "仅限授权人员"))
    try:
        page = visit("#/fleet", language="en", role="operator")
        fall_idle(stage)
        page.reload()
        page.wait_for_selector("[data-do=unlock] [data-text=login-notice]:has-text('authorized staff only')")
        page.context.clear_cookies()
        page.reload()
        page.wait_for_selector(".login [data-text=login-notice]:has-text('authorized staff only')")
    finally:
        stage._app.state.context = context
