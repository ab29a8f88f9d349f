"""A jog runs only while its button is held, on a real plant.

Its lease is half a second long in ``tests/drives``, in virtual time; here a busy machine may renew it much later.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from drivebus import i18n
from drivebus.drives.dialects.modbus import ModbusDialect
from drivebus.drives.jog_session import JogSession
from drivebus.drives.state import Direction
from fixtures.browser import Stage
from fixtures.browser_actions import DRAWN, wait_until
from fixtures.service import LOCAL

HOLD = "[data-jog=forward]"
MAX_RENEWAL_DELAY_S = 20.0  # of a busy machine
PATIENT = f"""() => {{
  const timeout = AbortSignal.timeout.bind(AbortSignal);
  AbortSignal.timeout = (ms) => timeout(Math.max(ms, {MAX_RENEWAL_DELAY_S * 1000}));
}}"""
"""Script that lets the page wait as long for the answer to a renewal."""


@pytest.fixture(autouse=True)
def late_renewals(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the service accept a renewal that a busy machine delays."""
    arm = JogSession._arm
    monkeypatch.setattr(JogSession, "_arm", lambda session, left_s: arm(session, left_s + MAX_RENEWAL_DELAY_S))


@pytest.fixture
def page(stage: Stage, visit: Any) -> Any:
    """Open the page of a drive under control, with the jog enabled."""
    return enabled(stage, visit("#/drive/pump-1"), "pump-1")


def enabled(stage: Stage, page: Any, drive: str) -> Any:
    stage.call("waiver.grant", drive=drive, reason="watched bench")
    page.evaluate(PATIENT)
    page.click("[data-do=take]")
    page.locator(".lease.own").wait_for()
    page.click(".control summary")
    page.click(".jog button:not(.hold)")
    page.locator(f"{HOLD}:enabled").wait_for()
    return page


def test_a_jog_frequency_is_entered_only_where_the_bus_can_set_one(stage: Stage, visit: Any) -> None:
    page = enabled(stage, visit("#/drive/fan-1"), "fan-1")
    for text, state in (
        ("5,5", "disabled"),
        ("", "enabled"),
    ):  # an invalid number does not mean the drive's own frequency
        page.fill(".jog input[inputmode=decimal]", text)
        page.locator(f"{HOLD}:{state}").wait_for()
    page.goto(f"{stage.at}/#/drive/pump-1")
    page.locator("h1", has_text="Circulation pump").wait_for()
    page.click(".control summary")
    page.locator(".jog .notice", has_text=i18n.text("page.jog_own_frequency", "en")).wait_for()
    assert page.locator(".jog input").count() == 0


def test_a_jog_is_renewed_while_the_button_is_held_and_ends_when_it_is_released(stage: Stage, page: Any) -> None:
    requests: list[str] = []
    page.on("request", lambda request: requests.append(request.url.partition("/drives/pump-1")[2]))
    page.hover(HOLD)
    page.mouse.down()
    for _ in range(3):
        with page.expect_request("**/jog/renew"):
            pass
    with page.expect_response("**/jog/end"):
        page.mouse.up()
    requests = [way for way in requests if way.startswith("/jog")]  # the page may read values in between
    assert requests[0] == "/jog" and requests[-1] == "/jog/end" and requests.count("/jog") == 1
    page.locator(".jog .notice strong", has_text=i18n.text("page.jog_ended", "en")).wait_for()
    stage.wait(lambda: stage.view("pump-1")["state"] == "stopped", "it goes on")


def test_the_next_jog_is_enabled_only_after_the_result_of_the_last(page: Any) -> None:
    """A jog held before that was taken for the one that had ended: its button was disabled under the pointer."""
    ends: list[Any] = []
    page.route("**/jog/end", lambda route: ends.append(route))
    page.hover(HOLD)
    with page.expect_request("**/jog/renew"):
        page.mouse.down()
    with page.expect_request("**/jog/end"):
        page.mouse.up()
    page.locator(".jog button:not(.hold):disabled").wait_for()
    wait_until(page, lambda: bool(ends), "the end is not sent")
    ends[0].continue_()
    page.locator(".jog .notice strong", has_text=i18n.text("page.jog_ended", "en")).wait_for()
    page.click(".jog button:not(.hold)")
    page.locator(f"{HOLD}:enabled").wait_for()


def released_key(page: Any) -> None:
    page.keyboard.up("Space")


def left(page: Any) -> None:
    page.evaluate("location.hash = '#/fleet'")


def blurred(page: Any) -> None:
    page.evaluate("dispatchEvent(new Event('blur'))")


@pytest.mark.parametrize("release", [released_key, left, blurred])
def test_a_released_key_a_left_page_and_a_hidden_window_end_the_jog(
    stage: Stage, page: Any, release: Callable[[Any], None]
) -> None:
    page.focus(HOLD)
    with page.expect_request("**/jog/renew"):
        page.keyboard.down("Space")
    with page.expect_request("**/jog/end"):
        release(page)
    stage.wait(lambda: stage.view("pump-1")["state"] == "stopped", "it goes on")


def test_a_pointer_that_slips_off_the_held_button_ends_the_jog(stage: Stage, page: Any) -> None:
    """The pressed button of the mouse is no hold of the button on the page."""
    page.hover(HOLD)
    with page.expect_request("**/jog/renew"):
        page.mouse.down()
    assert page.locator(f"{HOLD}.held").count() == 1
    box = page.locator(HOLD).bounding_box()
    with page.expect_request("**/jog/renew"):
        page.mouse.move(box["x"] + 3, box["y"] + 3)
    with page.expect_request("**/jog/end"):
        page.mouse.move(box["x"] + 3, box["y"] - 3)
    stage.wait(lambda: stage.view("pump-1")["state"] == "stopped", "it goes on")
    page.mouse.up()
    page.locator(f"{HOLD}:disabled:not(.held)").wait_for()


@pytest.mark.parametrize("size", [(1280, 900), (360, 740)])
def test_no_button_of_the_control_panel_moves_while_a_jog_begins_and_ends(
    stage: Stage, visit: Any, size: tuple[int, int]
) -> None:
    """Regression: who stopped the drive stood in a line that came and went above the held button."""
    stage.call("waiver.grant", drive="pump-1", reason="watched bench")
    page = visit("#/drive/pump-1", size=size)
    page.evaluate(PATIENT)
    page.click("[data-do=take]")
    page.locator(".lease.own").wait_for()
    page.click(".control summary")
    page.locator(".jog button:not(.hold):enabled").wait_for()
    place = "(one) => one.getBoundingClientRect().top + scrollY"
    watched = page.locator(f"{HOLD}, .control [data-step=first], .control [data-do=stop]")

    def places() -> Any:
        return [watched.nth(n).evaluate(place) for n in range(watched.count())]

    found = []
    for _ in range(2):
        page.click(".jog button:not(.hold)")
        page.locator(f"{HOLD}:enabled").wait_for()
        found.append(places())
        page.hover(HOLD)
        with page.expect_request("**/jog/renew"):
            page.mouse.down()
        stage.wait(lambda: stage.view("pump-1")["last_stop"] is None, "the last stop is shown")
        page.evaluate(DRAWN)
        found.append(places())
        page.mouse.up()
        page.locator("[data-stop-by=jog]").wait_for()
        found.append(places())
    assert len(found[0]) == 3 and all(positions == found[0] for positions in found), found


def test_a_jog_in_the_other_direction_is_remarked_on_while_the_button_is_held_and_after_its_release(
    stage: Stage, page: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The page showed a jog and nothing more; the direction stands elsewhere on it."""
    jog_frames, other = ModbusDialect.jog, Direction.REVERSE
    monkeypatch.setattr(ModbusDialect, "jog", lambda self, _, word: jog_frames(self, other, word))
    remark = page.locator(
        ".jog .notice.bad", has_text=i18n.text("drives.wrong_direction", expected=Direction.FORWARD, found=other)
    )
    page.hover(HOLD)
    page.mouse.down()
    remark.wait_for()
    page.mouse.up()
    page.locator(".jog .notice strong", has_text=i18n.text("page.jog_ended", "en")).wait_for()
    assert remark.count() == 1


def test_a_jog_whose_renewal_fails_ends_with_an_error(stage: Stage, page: Any) -> None:
    """The page does not show the jog as running any more; a stop follows."""
    page.route("**/jog/renew", lambda route: route.abort())
    page.focus(HOLD)
    with page.expect_request("**/drives/pump-1/stop"):
        page.keyboard.down("Space")
    page.locator(".jog .notice.bad", has_text=i18n.text("page.jog_lost", "en")).wait_for()
    page.locator(".stop-status.good").wait_for()
    stage.wait(lambda: stage.view("pump-1")["state"] == "stopped", "it goes on")


def test_a_hold_without_its_first_step_moves_nothing(stage: Stage, visit: Any) -> None:
    """A pressed key alone does not jog."""
    stage.call("waiver.grant", drive="pump-1", reason="watched bench")
    page = visit("#/drive/pump-1")
    page.click("[data-do=take]")
    page.locator(".lease.own").wait_for()
    page.click(".control summary")
    assert page.locator(HOLD).is_disabled()
    assert LOCAL.session not in str(stage.view("pump-1")["lease"])


def test_a_jog_is_not_enabled_by_an_answer_that_came_while_the_user_had_no_control(stage: Stage, visit: Any) -> None:
    """The token waited for the next control of the drive, whose user had pressed no first step."""
    held: list[Any] = []
    stage.call("waiver.grant", drive="pump-1", reason="watched bench")
    page = visit("#/drive/pump-1")
    page.route("**/arm", lambda route: held.append((route, route.fetch())))
    page.click("[data-do=take]")
    page.click(".control summary")
    page.click(".jog button:not(.hold)")
    page.locator(".jog button:not(.hold)[aria-busy]").wait_for()
    wait_until(page, lambda: bool(held), "the first step is not sent")
    page.click(".lease.own button")
    page.locator("[data-do=take]").wait_for()
    route, answer = held[0]
    with page.expect_response("**/arm"):
        route.fulfill(response=answer)
    page.click("[data-do=take]")
    page.locator(".jog button:not(.hold):enabled").wait_for()
    assert page.locator(HOLD).is_disabled()
