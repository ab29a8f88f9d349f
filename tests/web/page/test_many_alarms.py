"""Many alarms at once on the page: their sound, their acknowledgement one by one and by group, and by whom."""

from __future__ import annotations

import itertools
import re
from typing import Any
from urllib.parse import urljoin

import pytest

from drivebus import i18n
from fixtures.browser import Stage, wait_until_live
from fixtures.browser_actions import DRAWN, expecting, hold_topics, trip

FANS = ("fan-1", "fan-2", "fan-3")
STORM = """async () => {
  const marks = [];
  for (const name of ['start', 'stop']) {
    const real = OscillatorNode.prototype[name];
    OscillatorNode.prototype[name] = function (at) { marks.push(at); return real.call(this, at); };
  }
  const store = await import('/static/js/store.js');
  const text = { en: 'x', zh: 'x' };
  const alarm = { kind: 'fault', drive: 'fan-1', priority: 'critical', title: text, text, cleared_ms: null,
    acknowledged_ms: null, shelved_until_ms: null, raised_ms: 1 };
  const active = [];
  for (let n = 0; n < 10; n += 1) {
    active.push({ ...alarm, id: `x${n}`, first_id: `x${n}` });
    store.applyDelta({ topics: { alarms: { active: [...active] } } });
    await new Promise((resolve) => { setTimeout(resolve, 60); });
  }
  while (marks.length < 8) await new Promise((resolve) => { setTimeout(resolve, 60); });
  return marks;
}"""
"""Script: alarms one shortly after the other; times at which their tones begin and end, until two sounds are known."""


def test_alarms_that_follow_each_other_closely_sound_one_after_the_other(visit: Any) -> None:
    """Regression: in a storm of alarms a sound began for each of them while those before it still sounded."""
    page = visit("#/fleet", role="operator")
    page.locator(".tile").first.wait_for()
    page.keyboard.press("Tab")
    hold_topics(page)
    marks = page.evaluate(STORM)
    tones = list(zip(marks[::2], marks[1::2], strict=True))
    assert all(end <= begin for (_, end), (begin, _) in itertools.pairwise(tones))


TONES = """() => {
  window.tones = 0;
  const start = OscillatorNode.prototype.start;
  OscillatorNode.prototype.start = function (...at) { window.tones += 1; return start.apply(this, at); };
}"""
HAS_SOUNDED = "() => window.tones > 0"


def test_an_alarm_sounds_in_one_tab_of_the_browser_and_in_another_when_that_is_closed(stage: Stage, visit: Any) -> None:
    """Regression: each of an operator's tabs sounded, at moments of its own."""
    page = visit("#/settings", role="operator")
    page.evaluate(TONES)
    page.click("h1")
    other = page.context.new_page()
    other.goto(page.url)
    wait_until_live(other)
    other.evaluate(TONES)
    other.click("h1")
    trip(stage, "fan-1")
    for tab in (page, other):
        tab.wait_for_function("() => document.title.startsWith('(1) ')")
    other.wait_for_function(HAS_SOUNDED)
    page.evaluate(DRAWN)
    assert page.evaluate("window.tones") == 0
    other.close()
    page.wait_for_function(HAS_SOUNDED)


TAKE_LOCK = """() => new Promise((resolve) => {
  const hold = () => new Promise(() => resolve());
  navigator.locks.request('drivebus.alarm-sound', { steal: true }, hold);
})"""
"""Script: a tab takes the lock and never sounds, as one that the browser has suspended."""
SHOW = "() => document.dispatchEvent(new Event('visibilitychange'))"
HIDE = "() => { Object.defineProperty(document, 'hidden', { value: true }); (SHOW)(); }".replace("SHOW", SHOW)


def test_a_tab_in_front_sounds_while_a_suspended_one_has_the_lock(stage: Stage, visit: Any) -> None:
    """Regression: a background tab that a tablet had suspended kept the lock, and no tab sounded."""
    page = visit("#/settings", role="operator")
    other = page.context.new_page()
    other.goto(urljoin(page.url, "/static/js/i18n.js"))  # no script runs there, as in a suspended tab
    other.evaluate(TAKE_LOCK)
    page.reload()  # the tab before may have held the lock: Playwright's scripts count as a click of the user
    wait_until_live(page)
    page.evaluate(TONES)
    page.click("h1")
    trip(stage, "fan-1")
    page.wait_for_function(HAS_SOUNDED)


@pytest.mark.parametrize("is_shown", [True, False], ids=["is shown", "sees the other one hidden"])
def test_a_tab_takes_the_sound_back_when_it_is_shown_or_the_other_one_hidden(
    stage: Stage, visit: Any, *, is_shown: bool
) -> None:
    page = visit("#/settings", role="operator")
    page.evaluate(TONES)
    page.click("h1")
    other = page.context.new_page()
    other.goto(page.url)
    wait_until_live(other)
    other.evaluate(TAKE_LOCK)
    trip(stage, "fan-1")
    page.wait_for_function("() => document.title.startsWith('(1) ')")
    page.evaluate(DRAWN)
    assert page.evaluate("window.tones") == 0, "one tab sounds"
    page.evaluate(SHOW) if is_shown else other.evaluate(HIDE)
    page.wait_for_function(HAS_SOUNDED)


def test_an_alarm_sounds_in_a_browser_without_locks(stage: Stage, visit: Any) -> None:
    """Without HTTPS a page of another computer has none."""
    page = visit("#/settings", role="operator")
    page.add_init_script("Object.defineProperty(navigator, 'locks', { value: undefined })")
    page.reload()
    wait_until_live(page)
    page.evaluate(TONES)
    page.click("h1")
    trip(stage, "fan-1")
    page.wait_for_function(HAS_SOUNDED)


def test_a_group_of_alarms_stays_open_and_in_its_order_while_they_are_acknowledged(stage: Stage, visit: Any) -> None:
    """Regression: each acknowledgement closed the group, or put the button of the next alarm under the pointer."""
    for fan in FANS:
        trip(stage, fan)
    page = visit("#/alarms", role="operator")
    page.locator(".alarmrow.group .whole > summary").click()
    rows = page.locator(".alarmrow.group .alarms .alarmrow")
    names = ["Extract fan", "Flue gas fan", "Supply fan"]
    expecting()(rows.locator(".what a")).to_have_text(names)
    for number in range(len(FANS)):
        rows.nth(number).locator("[data-alarm=acknowledge]").click()
        expecting()(rows.nth(number)).to_have_class(re.compile(r"\backnowledged\b"))
        assert rows.locator(".what a").all_inner_texts() == names


def test_a_double_click_acknowledges_one_alarm(stage: Stage, visit: Any) -> None:
    """Regression: its second press was for the next alarm, which had taken the place of the first one meanwhile."""
    trip(stage, "fan-1")
    page = visit("#/fleet", role="operator")
    button = page.locator(".strip [data-do=acknowledge]")
    button.wait_for()
    trip(stage, "pump-1")
    expecting()(page).to_have_title(re.compile(r"^\(2\) "))
    box = button.bounding_box()
    at = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.click(*at)
    expecting()(page).to_have_title(re.compile(r"^\(1\) "))
    sent: list[str] = []
    page.on("request", lambda request: sent.append(request.method))
    page.mouse.down(click_count=2)
    page.mouse.up(click_count=2)
    page.evaluate(DRAWN)
    assert "POST" not in sent
    page.mouse.click(*at)
    expecting()(page).to_have_title(re.compile(r"^[^(]"))


@pytest.mark.parametrize("language", ["en", "zh"])
def test_an_alarm_that_still_holds_says_who_has_acknowledged_it(stage: Stage, visit: Any, language: str) -> None:
    """Regression: the next shift saw that it was acknowledged, and by whom only in the history once it was over."""
    trip(stage, "pump-1")
    for fan in FANS:
        trip(stage, fan)
    page = visit("#/alarms", role="operator", language=language)
    page.locator(".alarmrow.group").wait_for()
    page.locator(".alarmrow:not(.group) [data-alarm=acknowledge]").click()
    page.locator(".alarmrow.group [data-alarm=acknowledge]").click()
    by = i18n.text("page.acknowledged_by", language, by="operator", time="")
    for kind in (".group", ":not(.group)"):
        shown = page.locator(f".alarmrow{kind} > .when")
        expecting()(shown).to_contain_text(re.compile(".*".join(map(re.escape, by.split("  ")))))


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_fault_of_a_group_names_none_of_its_drives(stage: Stage, visit: Any, language: str) -> None:
    """Regression: it named one of 20 drives, and another one after each acknowledgement."""
    for fan in FANS:
        trip(stage, fan)
    text = stage.view("fan-1")["fault"]["text"][language]
    page = visit("#/alarms", role="operator", language=language)
    fault = page.locator(".alarmrow.group > .what > p")
    expecting()(fault).to_contain_text(text)
    names = {stage.view(fan)["title"][language] for fan in FANS}
    assert not any(name in fault.inner_text() for name in names)


LINES_OF_A_NUMBER = """async () => {
  const store = await import('/static/js/store.js');
  const found = [];
  for (let n = 1; n < 16; n += 1) {
    const title = `${'x'.repeat(n)} 12-34`;
    store.applyDelta({ topics: { 'drives/fan-1': { title: { en: title, zh: title } } } });
    await DRAWN;
    found.push(document.querySelector('.tilename .whole-number').getClientRects().length);
  }
  return found;
}""".replace("DRAWN", DRAWN)
"""Script: lines of the number of a drive in its tile, with names of many lengths before it."""


def test_no_line_ends_within_the_number_of_a_drive(visit: Any) -> None:
    """Regression: of "Circulation pump 1-02" a tile had "1-" in one line and "02" in the next."""
    page = visit("#/fleet", size=(390, 844))
    page.locator(".tilename").first.wait_for()
    hold_topics(page)
    assert set(page.evaluate(LINES_OF_A_NUMBER)) == {1}
