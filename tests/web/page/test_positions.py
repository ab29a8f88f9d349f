"""Positions of the buttons of a drive's page while a trip comes and goes."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus import i18n
from drivebus.service.alarms import SystemAlarm
from fixtures.browser import Stage
from fixtures.browser_actions import DRAWN, expecting, hold_topics, resize, show_topics, trip

BUTTONS = """() => Object.fromEntries([...document.querySelectorAll(
    "main :is(button, summary, [role=tab]):not(.active-fault *, .confirm *)")].filter((one) => one.offsetParent)
  .map((one) => {
    const { x, y } = one.getBoundingClientRect();
    return [one.textContent.trim() + (one.dataset.do ?? ""), [x + scrollX, y + scrollY].map(Math.round)];
  }))"""


@pytest.mark.parametrize("size", [(1440, 900), (360, 740)])
def test_no_button_of_the_drive_page_moves_when_a_trip_or_an_alarm_comes_or_goes(
    stage: Stage, visit: Any, size: tuple[int, int]
) -> None:
    """A hand that is on its way to Stop or Set frequency must not press something else."""
    stage.call("waiver.grant", drive="fan-1", reason="watched bench")
    page = visit("#/drive/fan-1", size=size)
    page.click("[data-do=take]")
    page.locator(".lease.own").wait_for()
    page.locator(".trend-plot canvas").wait_for()
    page.fill(".control .frequency input[inputmode=decimal]", "20")
    page.click("[data-step=first]")
    page.click("[data-step=second]")
    page.locator(".control .notice.good").wait_for()
    page.locator("[data-stop-by]").wait_for(state="detached")
    before = settled_buttons(page)

    async def raise_alarm() -> None:
        stage.service.plant.raise_alarm(SystemAlarm.INTERLOCK_TRIP, "fan-1", subject="cool", interlock="cool")

    async def clear_alarm() -> None:
        stage.service.plant.clear_alarm(SystemAlarm.INTERLOCK_TRIP, "fan-1", subject="cool")

    stage.do(raise_alarm)
    page.locator(".drive-alarm a").wait_for()
    assert moved(before, page.evaluate(BUTTONS)) == {}
    trip(stage, "fan-1")
    page.locator(".active-fault [data-do=reset]").wait_for()
    page.locator(".active-fault .small a").wait_for()
    assert page.locator(".active-fault").evaluate("(one) => one.scrollHeight - one.clientHeight") <= 1
    stage.do(clear_alarm)
    page.locator(".active-fault .small a").wait_for(state="detached")
    page.wait_for_timeout(100)
    tripped = page.evaluate(BUTTONS)
    assert moved(before, tripped) == {}
    page.click(".active-fault [data-do=reset]")
    page.locator(".active-fault").wait_for(state="detached")
    assert moved(before, page.evaluate(BUTTONS)) == {}


def moved(before: dict[str, Any], after: dict[str, Any]) -> dict[str, Any]:
    """Return the buttons of both measurements that have moved, each with its two places."""
    both = before.keys() & after.keys()
    assert len(both) > 12, "hardly a button was compared"
    return {name: (before[name], after[name]) for name in both if before[name] != after[name]}


def test_a_long_fault_text_is_whole_on_a_desktop_and_with_its_failed_reset_on_a_phone(stage: Stage, visit: Any) -> None:
    trip(stage, "pump-2")
    page = visit("#/drive/pump-2", size=(360, 740))
    hidden = "(one) => one.scrollHeight - one.clientHeight"
    assert page.locator(".active-fault").evaluate(hidden) <= 1, "the box is too small for what is in it"
    page.click(".active-fault [data-do=remedy]")
    title = page.locator("dialog h2", has_text="see the VC660 manual")
    assert title.evaluate(hidden) <= 1
    page.keyboard.press("Escape")
    page.click("[data-do=take]")
    page.route("**/reset", not_reset)
    page.click(".active-fault [data-do=reset]")
    why = page.locator(".fault-outcome p", has_text="The cause is still there")
    assert why.evaluate(hidden) <= 1, "the reason of a failed reset is cut off"
    page.click(".fault-outcome .button")
    why.wait_for(state="detached")
    page.set_viewport_size({"width": 1440, "height": 900})
    assert page.locator(".active-fault h2").evaluate(hidden) <= 1


STATE_NOTES = """async () => {
  const store = await import('/static/js/store.js');
  const height = () => document.querySelector('.drivehead').getBoundingClientRect().height;
  const usual = { state: 'stopped', state_reason: null, stop_pending: false, start_inhibited: false };
  const unknown = { state: 'unknown', state_reason: 'drives.no_answer' };
  const stopped = { stop_pending: true, start_inhibited: true };
  const heights = [];
  for (const turn of [usual, unknown, stopped, { ...unknown, ...stopped }, { state: 'emergency_stopped' }]) {
    store.applyDelta({ topics: { 'drives/fan-1': { ...usual, ...turn } } });
    await DRAWN;
    heights.push(height());
  }
  return heights;
}""".replace("DRAWN", DRAWN)


@pytest.mark.parametrize("language", ["en", "zh"])
def test_no_note_on_the_state_of_a_drive_moves_its_control_panel(visit: Any, language: str) -> None:
    """Regression: on a phone the reason of an unknown state pushed the buttons down by a line."""
    page = visit("#/drive/fan-1", language=language)
    page.locator(".control [data-do=stop]").wait_for()
    hold_topics(page)
    for width in (1440, 1024, 390, 320):
        resize(page, width, 740)
        heights = page.evaluate(STATE_NOTES)
        assert len(heights) == 5 and set(heights) == {heights[0]}, width


NOTES_CUT_OFF = """async () => {
  const { applyDelta } = await import('/static/js/store.js');
  const notes = { state: 'unknown', state_reason: 'drives.no_answer', stop_pending: true, start_inhibited: true };
  applyDelta({ topics: { 'drives/fan-1': notes } });
  await DRAWN;
  document.querySelector('.state-notes').focus();
  const span = document.querySelector('.state-notes span');
  return span.scrollHeight - span.clientHeight;
}""".replace("DRAWN", DRAWN)


@pytest.mark.parametrize("width", [320, 1440])
def test_a_tap_on_the_notes_on_the_state_of_a_drive_shows_all_of_them(visit: Any, width: int) -> None:
    """Regression: a touch screen had no way to the third line."""
    page = visit("#/drive/fan-1", language="en", size=(width, 740))
    page.locator(".control [data-do=stop]").wait_for()
    hold_topics(page)
    assert page.evaluate(NOTES_CUT_OFF) <= 4


# A line has 15 pixels and more; the tall glyphs of a Chinese font overlap its edge by up to 3.
CUT_OFF = """(box) => [...box.querySelectorAll(".button, .small"), box]
  .filter((one) => one.scrollHeight - one.clientHeight > 4 || one.scrollWidth - one.clientWidth > 1)
  .map((one) => one.textContent)"""


@pytest.mark.parametrize("language", ["en", "zh"])
def test_reset_its_reason_and_the_incident_stand_in_the_red_box_at_every_width(
    stage: Stage, visit: Any, language: str
) -> None:
    """Regression: below 1,100 px the incident and why a reset is refused were only behind the details."""
    trip(stage, "pump-2")
    visit("#/drive/pump-2").click("[data-do=take]")
    page = visit("#/drive/pump-2", language=language, role="operator")
    why = i18n.text("page.not_controlled_other", language)
    box = page.locator(".active-fault")
    box.locator(".small", has_text=why).wait_for()
    box.locator("[data-do=incident]").wait_for()
    for width in (360, 390, 560, 561, 700, 760, 761, 900, 1100, 1101, 1280, 1920):
        page.set_viewport_size({"width": width, "height": 800})
        outer = box.bounding_box()
        for part in ("[data-do=reset]", "[data-do=remedy]", "[data-do=incident]", ".small"):
            inner = box.locator(part).bounding_box()
            assert inner is not None and inner["height"] > 10, (width, part)
            assert outer["y"] <= inner["y"], (width, part)
            assert inner["y"] + inner["height"] <= outer["y"] + outer["height"], (width, part)
        assert box.evaluate(CUT_OFF) == [], width
        assert width <= 760 or box.locator("h2").evaluate("(one) => one.scrollHeight - one.clientHeight") <= 4, width


def test_a_drive_that_reports_no_faults_has_no_empty_place_for_one(visit: Any) -> None:
    """Regression: the page of a DF800 had a gap of 106 px below its title."""
    page = visit("#/drive/fan-1")
    page.locator(".fault-place").wait_for()
    show_topics(page, {"drives/fan-1": {"capabilities": ["run", "stop"], "state": "unknown"}})
    page.locator(".fault-place").wait_for(state="detached")


def test_a_reset_that_a_bus_stop_refuses_is_disabled_with_its_reason(stage: Stage, visit: Any) -> None:
    """Regression: the button was enabled, and the service refused the reset until the drive was released."""
    trip(stage, "fan-2")
    page = visit("#/drive/fan-2")
    page.click("[data-do=take]")
    reset = page.locator(".active-fault [data-do=reset]")
    expecting()(reset).to_be_enabled()
    page.click("[data-stop=all]")
    why = page.locator(".active-fault .small", has_text=i18n.text("page.reset_inhibited", "en"))
    why.wait_for()
    expecting()(reset).to_be_disabled()
    page.locator(".stop-status.good").wait_for()  # a stop that goes on supersedes the reset
    page.click(".control [data-do=release]")
    why.wait_for(state="detached")
    expecting()(reset).to_be_enabled()
    reset.click()
    page.locator(".active-fault").wait_for(state="detached")


def not_reset(route: Any) -> None:
    """Answer as a service whose drive has rejected the reset."""
    text = {"en": "The cause is still there: " + "the heat sink is too hot for a reset, " * 4, "zh": "x"}
    outcome = {"status": "refused", "key": "drives.rejected", "text": text, "notes": [], "frames": []}
    error = {"code": "drives.rejected", "kind": "DriveRejected", "params": {}, "text": text}
    route.fulfill(status=500, json={"error": {**error, "outcome": outcome}})


def test_on_a_phone_the_begin_of_a_long_outcome_of_a_stop_is_in_sight(visit: Any) -> None:
    """Regression: of a stop of 72 drives only names were shown, and what had happened stood above the box."""
    page = visit("#/fleet", size=(360, 740))
    lost = {"unconfirmed": ["fan-1"] + [f"a-drive-with-quite-a-long-name-{n}" for n in range(20)]}
    page.route(
        "**/api/v1/stop", lambda route: route.fulfill(status=200, json={"outcomes": {}, "buses": {"fans": lost}})
    )
    page.click("[data-stop=all]")
    status = page.locator(".stop-status.bad")
    status.evaluate("(one) => { one.style.maxHeight = '40px'; }")
    top = status.locator("time").bounding_box()["y"]
    assert top >= status.bounding_box()["y"]


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_text_of_a_badge_is_one_line_after_the_other_on_a_phone(stage: Stage, visit: Any, language: str) -> None:
    """The word *waived* stood in a column of its own beside two broken lines."""
    stage.call("waiver.grant", drive="fan-1", reason="watched bench")
    page = visit("#/drive/fan-1", language=language, size=(360, 740))
    waived = i18n.text("page.waived", language)
    badge = page.locator(".badge", has_text=f" · {waived}").first
    badge.wait_for()
    assert badge.locator("> span").inner_text().endswith(f" · {waived}")
    assert badge.evaluate("(one) => [...one.childNodes].filter((n) => n.textContent.trim()).length") == 1


def settled_buttons(page: Any) -> Any:
    """Return the places of the buttons once the chart below them has drawn its first data."""
    before, after = None, page.evaluate(BUTTONS)
    while before != after:
        page.wait_for_timeout(1000)
        before, after = after, page.evaluate(BUTTONS)
    return after


@pytest.mark.parametrize("language", ["en", "zh"])
def test_no_button_moves_while_a_frequency_is_wrong(visit: Any, language: str) -> None:
    """Regression: the error pushed Set frequency and Run down by a line."""
    page = visit("#/drive/fan-1", language=language, size=(360, 740))
    page.click("[data-do=take]")
    page.locator(".lease.own").wait_for()
    page.locator(".trend-plot canvas").wait_for()
    entry = page.locator(".control .frequency input[inputmode=decimal]").first
    before = settled_buttons(page)
    for wrong in ("99", "1,5"):
        entry.fill(wrong)
        page.locator(".control .frequency .wrong").first.wait_for()
        assert moved(before, page.evaluate(BUTTONS)) == {}


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_remedy_of_two_lines_is_whole_in_the_red_box_of_a_desktop(stage: Stage, visit: Any, language: str) -> None:
    """Regression: one line was shown, although the box has room for two."""
    trip(stage, "pump-2")
    page = visit("#/drive/pump-2", size=(1440, 900), language=language)
    page.locator(".active-fault [data-do=incident]").wait_for()
    text = {"en": "over-current", "zh": "过电流"}
    cause = {"en": "The motor is blocked.", "zh": "电机堵转。"}
    remedy = {"en": "Find out what blocks the motor. " * 5, "zh": "先查明电机为何卡住。" * 7}
    fault = stage.view("pump-2")["fault"] | {"text": text, "cause": cause, "remedy": remedy}
    show_topics(page, {"drives/pump-2": {"fault": fault}})
    page.locator(".active-fault .what > p").nth(1).wait_for()
    cut = page.evaluate("""() => {
      const [one, two] = document.querySelectorAll('.active-fault .what > p');
      const box = document.querySelector('.active-fault').getBoundingClientRect();
      return [two.clientHeight > 1.5 * one.clientHeight, two.scrollHeight - two.clientHeight > 4,
        two.getBoundingClientRect().bottom <= box.bottom - 3];
    }""")
    assert cut == [True, False, True]
