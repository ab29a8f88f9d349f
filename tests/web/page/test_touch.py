"""The page under a finger: a swipe that scrolls the page changes nothing that it begins on."""

from __future__ import annotations

from typing import Any

from fixtures.browser import Stage
from fixtures.browser_actions import DRAWN

PHONE = {"size": (360, 740), "has_touch": True, "is_mobile": True}
SCROLLED = "async () => { for (let at = -1; at !== scrollY; await DRAWN) at = scrollY; }".replace("DRAWN", DRAWN)
"""Script that waits until the page scrolls no more."""


def swipe(page: Any, begin: str, up: int) -> None:
    """Draw a finger upwards over the screen, from the last third of an element."""
    target = page.locator(begin)
    target.evaluate("one => one.scrollIntoView({ block: 'center' })")
    box = target.bounding_box()
    x, y = box["x"] + box["width"] * 0.8, box["y"] + box["height"] / 2
    before = page.evaluate("scrollY")
    finger = page.context.new_cdp_session(page)
    for step in range(11):
        kind = "touchMove" if step else "touchStart"
        at = {"x": x, "y": y - up * step / 10}
        finger.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [at]})
        page.wait_for_timeout(16)
    finger.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    page.wait_for_function("before => scrollY > before + 20", arg=before)
    page.evaluate(SCROLLED)


def test_a_swipe_that_begins_on_the_slider_or_a_button_scrolls_the_page_only(stage: Stage, visit: Any) -> None:
    """The slider followed the finger: 20 Hz became 36 Hz while the page was scrolled, and the next press set it."""
    stage.call("waiver.grant", drive="fan-1", reason="watched bench")
    page = visit("#/drive/fan-1", **PHONE)
    page.click("[data-do=take]")
    page.locator(".lease.own").wait_for()
    page.fill(".control .frequency input[inputmode=decimal]", "20")
    sent: list[str] = []
    page.on("request", lambda request: sent.append(f"{request.method} {request.url}"))
    for begin in ("input[type=range]", "[data-do=set]", "[data-step=first]", "[data-do=stop]"):
        swipe(page, f".control {begin} >> nth=0", 200)
        assert page.input_value(".control .frequency input[inputmode=decimal]") == "20"
    swipe(page, "[data-stop=all]", 200)
    assert [request for request in sent if "/fan-1/" in request or request.endswith("/stop")] == []


def test_a_tap_on_the_slider_still_sets_it(stage: Stage, visit: Any) -> None:
    page = visit("#/drive/fan-1", **PHONE)
    page.click("[data-do=take]")
    page.locator(".lease.own").wait_for()
    slider = page.locator(".control input[type=range]").first
    slider.evaluate("one => one.scrollIntoView({ block: 'center' })")
    box = slider.bounding_box()
    page.touchscreen.tap(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    value = "Number(document.querySelector('.control .frequency input[inputmode=decimal]').value)"
    page.wait_for_function(f"() => 20 < {value} && {value} < 25")
