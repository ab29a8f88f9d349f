"""Alarms whose condition no longer holds, on the page in a real browser with a real plant."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from drivebus import i18n
from drivebus.service.alarms import SystemAlarm
from fixtures.browser import Stage
from fixtures.browser_actions import DRAWN, expecting, hold_topics, trip, unplugged

FANS = ("fan-1", "fan-2", "fan-3")


class Alarms:
    """Equal alarms of the fans, raised and cleared by hand."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage

    def raise_for(self, *fans: str, subject: str = "fans") -> None:
        self._change(self._stage.service.plant.raise_alarm, fans, subject)

    def clear_for(self, *fans: str, subject: str = "fans") -> None:
        self._change(self._stage.service.plant.clear_alarm, fans, subject)

    def _change(self, change: Callable[..., None], fans: tuple[str, ...], subject: str) -> None:
        async def act() -> None:
            for fan in fans:
                change(SystemAlarm.FOREIGN_MASTER, fan, subject=subject)

        self._stage.do(act)


@pytest.fixture
def alarms(stage: Stage) -> Iterator[Alarms]:
    found = Alarms(stage)
    yield found
    found.clear_for(*FANS)


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_strip_shows_what_holds_before_what_is_over(
    stage: Stage, visit: Any, alarms: Alarms, language: str
) -> None:
    """Regression: after the port was back, a red strip said that it is lost, in front of an alarm that still held."""
    expect = expecting()

    def word(key: str, **params: Any) -> str:
        return i18n.text(key, language, **params)

    alarms.raise_for("fan-1")
    page = visit("#/fleet", role="operator", language=language)
    strip = page.locator(".strip .banner")
    bus, fan = {"en": ("Fan line", "Supply fan"), "zh": ("风机线路", "送风机")}[language]
    with unplugged(stage, "fans"):
        expect(strip.locator("a").first).to_contain_text(word("alarms.text.port_lost", bus=bus, reason="").strip())
        red = strip.evaluate("one => getComputedStyle(one).backgroundColor")
    expect(strip.locator("a").first).to_have_text(fan + word("page.colon") + word("alarms.title.foreign_master"))
    expect(strip.locator("a.more")).to_be_visible()
    expect(strip.locator(".state")).to_have_count(0)
    alarms.clear_for("fan-1")
    expect(strip.locator("a").first).to_have_text(bus + word("page.colon") + word("alarms.title.port_lost"))
    expect(strip.locator(".state")).to_have_text(word("page.alarm_cleared"))
    assert strip.evaluate("one => getComputedStyle(one).backgroundColor") != red


def test_a_group_of_alarms_says_which_still_hold_and_is_listed_by_them(
    stage: Stage, visit: Any, alarms: Alarms
) -> None:
    """Regression: a group whose condition was over on every drive looked like one that still held."""
    expect = expecting()

    def word(key: str, **params: Any) -> str:
        return i18n.text(f"page.{key}", "en", **params)

    alarms.raise_for(*FANS)
    page = visit("#/alarms", role="operator")
    group = page.locator(".alarmrow.group")
    state = group.locator(".when b").first
    expect(state).to_have_text(word("alarm_group_active", n=3))
    alarms.clear_for("fan-1", "fan-3")
    expect(state).to_have_text(word("alarm_group_partly", n=1, names="Extract fan", cleared=2))
    group.locator(".whole > summary").click()
    states = group.locator(".alarms .alarmstate")
    expect(states).to_have_text(
        [word("alarm_unacknowledged"), word("alarm_cleared_unacknowledged"), word("alarm_cleared_unacknowledged")]
    )
    strip = visit("#/fleet", role="viewer").locator(".strip a").first
    expect(strip).to_have_text("Extract fan: " + i18n.text("alarms.title.foreign_master", "en"))
    red = group.evaluate("one => getComputedStyle(one).backgroundColor")
    alarms.clear_for("fan-2")
    expect(state).to_have_text(word("alarm_group_cleared", n=3))
    assert group.evaluate("one => getComputedStyle(one).backgroundColor") != red


def test_the_mark_of_an_alarm_on_a_tile_has_its_colour_only_while_it_holds(
    stage: Stage, visit: Any, alarms: Alarms
) -> None:
    """Regression: a drive whose fault was reset had the mark of a critical alarm until it was acknowledged."""
    expect = expecting()
    alarms.raise_for("fan-2")
    page = visit("#/fleet", role="operator")
    mark = page.locator(".tile", has=page.locator("[data-drive=fan-2]")).locator(".priority")
    mark.wait_for()
    colour = "one => getComputedStyle(one).backgroundColor"
    red = mark.evaluate(colour)
    assert i18n.text("page.alarm_cleared", "en") not in mark.inner_text()
    alarms.clear_for("fan-2")
    expect(mark).to_contain_text(i18n.text("page.alarm_cleared", "en"))
    assert mark.evaluate(colour) != red
    page.click("[data-do=acknowledge]")
    expect(mark).to_have_count(0)


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_drive_whose_alarm_has_cleared_is_not_abnormal_and_is_found_until_it_is_acknowledged(
    stage: Stage, visit: Any, alarms: Alarms, language: str
) -> None:
    """Regression: the filter *Abnormal* kept a drive that runs normally among those that need help."""
    expect = expecting()

    def word(key: str) -> str:
        return i18n.text(f"page.{key}", language)

    alarms.raise_for("fan-2")
    page = visit("#/fleet", role="operator", language=language)
    filters = {
        kind: page.locator(".fleettools .choice button").filter(has_text=word(f"kind_{kind}"))
        for kind in ("abnormal", "unacknowledged")
    }
    expect(filters["abnormal"].locator("b")).to_have_text("1")
    expect(filters["unacknowledged"].locator("b")).to_have_text("1")
    alarms.clear_for("fan-2")
    expect(filters["abnormal"].locator("b")).to_have_text("0")
    expect(filters["unacknowledged"].locator("b")).to_have_text("1")
    filters["unacknowledged"].click()
    expect(page.locator(".tilelink")).to_have_count(1)
    expect(page.locator(".tile .priority")).to_have_attribute("title", word("alarm_cleared_unacknowledged"))
    page.locator("[data-drive=fan-2]").click()
    note = page.locator(".fault-place").get_by_text(word("alarms_to_acknowledge"))
    expect(note).to_be_visible()
    page.click("[data-do=acknowledge]")
    expect(note).to_have_count(0)


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_group_of_equal_faults_names_the_fault(stage: Stage, visit: Any, language: str) -> None:
    """Regression: of many trips each row read "Fault · 3 alarms", and only opened it showed which fault."""
    for fan in FANS:
        trip(stage, fan)
    page = visit("#/alarms", role="operator", language=language)
    group = page.locator(".alarmrow.group", has_text=i18n.text("alarms.title.fault", language))
    expecting()(group.locator(".what > p")).to_contain_text(stage.view("fan-1")["fault"]["label"])


WRONG_MARKS = """async () => {
  const store = await import('/static/js/store.js');
  const text = { en: 'x', zh: 'x' };
  const quiet = { text, remedy: null, setting: null, subject: null, value: null, incident: null, acknowledged_ms: null,
    shelved_until_ms: null, shelved_by: null, shelved_reason: null };
  const drives = store.idsOf('drives').value;
  const wrong = [];
  for (let round = 0; round < 30; round += 1) {
    const active = [];
    for (let n = 0; n < 40; n += 1) {
      const isCleared = (n * 7 + round * round) % 11 > 0;
      if ((n + round) % 5 > 0) active.push({ ...quiet, id: `a${n}`, drive: drives[n % drives.length], priority: 'high',
        kind: n % 2 ? 'no_response' : 'stale', title: { en: `T${n % 4}`, zh: 'x' }, raised_ms: 1000 - n,
        cleared_ms: isCleared ? 1 : null });
    }
    store.applyDelta({ topics: { alarms: { active } } });
    await DRAWN;
    for (const row of document.querySelectorAll('.alarmrow')) {
      const isPlain = getComputedStyle(row.querySelector('.priority')).outlineStyle === 'solid';
      if (isPlain !== row.classList.contains('cleared')) wrong.push(`${round} ${row.className}`);
    }
  }
  return wrong;
}""".replace("DRAWN", DRAWN)


STRIP = """<section class="strip"><div class="banner alarm critical"><span class="priority critical">
  <svg class="icon" width="18" height="18"></svg></span><a><b>TITLE</b> · and the drives</a>
  <a class="more">and 414 more</a><button class="button">Acknowledge all 17</button></div></section>"""
WHOLE = """html => {
  document.body.innerHTML = html;
  const [strip, title, more] = ['.strip', 'b', '.more'].map((one) => document.querySelector(one));
  const { bottom } = strip.getBoundingClientRect();
  const link = title.parentElement;
  const lines = Math.round(title.getBoundingClientRect().height / parseFloat(getComputedStyle(link).lineHeight));
  const fits = more.scrollHeight <= more.clientHeight + 1;
  return [lines <= 2, fits, document.querySelector('button').getBoundingClientRect().bottom <= bottom];
}"""


def test_on_a_phone_the_strip_shows_the_whole_title_of_many_alarms(scripts: Any) -> None:
    """Regression: the button of a group took half of the strip, and "Stop not confirmed" was "Stop not confir…"."""
    page = scripts.context.new_page()
    page.set_viewport_size({"width": 360, "height": 740})
    page.goto(scripts.url)
    title = i18n.text("alarms.title.stop_unconfirmed", "en")
    assert page.evaluate(WHOLE, STRIP.replace("TITLE", title)) == [True, True, True]
    of_one_drive = STRIP.replace("<b>TITLE</b> · and the drives", f"Cooling tower 1: <b>{title}</b>").replace(
        " all 17", ""
    )
    inside = """html => {
      document.body.innerHTML = html;
      const boxOf = (one) => document.querySelector(one).getBoundingClientRect();
      const [title, link, strip] = ['b', '.banner a', '.strip'].map((one) => boxOf(one).bottom);
      return title <= link + 1 && link <= strip;
    }"""
    assert page.evaluate(inside, of_one_drive.replace("414", "8")), "the title of one drive's alarm is cut off"
    page.close()


MOVED_TEXTS = """async () => {
  const { html, render } = await import('/static/js/lib.js');
  const box = document.body.appendChild(document.createElement('div'));
  const Word = ({ text }) => text;
  for (const texts of [['a', 'b', 'c'], ['c', 'a', 'b']]) {
    render(html`<p>${texts.map((text) => html`<${Word} key=${text} text=${text} />`)}</p>`, box);
  }
  return box.textContent;
}"""


def test_a_text_moves_in_a_list_as_an_element_does(scripts: Any) -> None:
    """The style of a node that moves is brought up to date before; a text has none."""
    assert scripts.evaluate(MOVED_TEXTS) == "cab"


def test_the_mark_of_an_alarm_that_moves_in_the_list_shows_whether_it_still_holds(visit: Any) -> None:
    """Regression: the mark of an alarm that still held was without its colour, and that of a cleared one had it."""
    page = visit("#/alarms", role="operator")
    page.locator("h1").wait_for()
    hold_topics(page)
    assert page.evaluate(WRONG_MARKS) == []


def test_the_row_of_an_alarm_that_repeats_stays_with_its_open_dialog_and_shows_the_count(
    stage: Stage, visit: Any, alarms: Alarms
) -> None:
    """Each occurrence was a row of its own, twenty of them."""
    expect = expecting()
    alarms.raise_for("fan-2", subject="other")
    page = visit("#/alarms", role="operator")
    row = page.locator(".alarmrow:not(.group)", has_text="Extract fan")
    row.get_by_role("button", name=i18n.text("page.shelve", "en")).click()
    dialog = page.get_by_role("dialog")
    dialog.wait_for()
    for count in (2, 3):
        alarms.clear_for("fan-2", subject="other")
        alarms.raise_for("fan-2", subject="other")
        expect(row).to_contain_text(i18n.text("page.alarm_repeated", "en", n=count, time="").partition(",")[0])
    expect(row).to_have_count(1)
    expect(dialog).to_be_visible()
    page.keyboard.press("Escape")
    row.get_by_role("button", name=i18n.text("page.acknowledge", "en")).click()
    expect(row.locator(".alarmstate")).to_have_text(i18n.text("page.alarm_acknowledged", "en"))
    alarms.clear_for("fan-2", subject="other")
