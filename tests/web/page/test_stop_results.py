"""Results of stops in the stop bar: an unconfirmed one stays until reads confirm it, or a person dismisses it."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus import i18n
from drivebus.drives.state import DriveState
from fixtures.browser import Stage
from fixtures.browser_actions import DRAWN, expecting, go_to, hold_topics, unplugged, wait_until

CONFIRMED_MS = 2500
"""Time in which every drive of the plant is read again after the answer to a stop."""


def word(key: str, language: str = "en", **params: Any) -> str:
    return i18n.text(key, language, **params)


def answer_stop(page: Any, path: str, answer: Any, status: int = 200) -> None:
    """Answer the stops of a path in place of the service."""
    page.route(f"**/api/v1/{path}", lambda route: route.fulfill(status=status, json=answer))


@pytest.mark.parametrize("language", ["en", "zh"])
def test_an_unconfirmed_stop_stays_red_until_the_drive_is_read_at_standstill(
    stage: Stage, visit: Any, language: str
) -> None:
    """The red text stayed until the next stop, also after the drive had stopped."""
    page = visit("#/drive/fan-1", language=language)
    expect, name = expecting(), {"en": "Supply fan", "zh": "送风机"}[language]
    with unplugged(stage, "fans"):
        page.click("[data-stop=drive]")
        expect(page.locator(".stop-status.bad")).to_contain_text(name)
        page.wait_for_timeout(CONFIRMED_MS)
        expect(page.locator(".stop-status.bad")).to_contain_text(name)
    done = word("page.stop_done", language, what=name, why=word("page.stop_confirmed_later", language))
    expect(page.locator(".stop-status.good")).to_contain_text(done)
    expect(page.locator(".stop-status")).to_have_count(1)


def test_an_unconfirmed_stop_names_what_is_left_until_it_is_dismissed(stage: Stage, visit: Any) -> None:
    """The next stop, of another drive, replaced it; nothing else took it away."""
    page = visit("#/drive/pump-1")
    expect, red = expecting(), page.locator(".stop-status.bad")
    answer_stop(page, "stop", {"outcomes": {}, "buses": {"fans": {"unconfirmed": ["fan-1", "gone"]}}})
    page.click("[data-stop=all]")
    expect(red).to_contain_text(word("page.stop_unconfirmed", n=1, names="gone"))
    page.click("[data-stop=drive]")
    expect(page.locator(".stop-status.good")).to_have_count(1)
    expect(red).to_contain_text("gone")
    red.locator("[data-do=dismiss-stop]").click()
    expect(page.locator(".stop-status")).to_have_class("stop-status good")
    page.click("[data-do=dismiss-stop]")
    expect(page.locator(".stop-status")).to_have_text(word("page.stop_note"))


def test_a_stop_that_the_server_has_got_again_no_longer_says_that_it_does_not_answer(visit: Any) -> None:
    """Regression: after a restart it said so for minutes, while the service waited for the motors to stop."""
    page = visit("#/fleet")
    away = ["the server"]
    page.route("**/api/v1/stop", lambda route: route.abort() if away else None)
    page.click("[data-stop=all]")
    everything = word("page.stop_scope_all")
    expect, status = expecting(), page.locator(".stop-status")
    expect(status).to_contain_text(word("page.stop_trying", what=everything))
    away.clear()
    expect(status).to_contain_text(word("page.stop_sending", what=everything))


OUTCOME = {"status": "failed", "text": {"en": "NOT SENT", "zh": "x"}, "notes": [], "frames": []}
ERROR = {"code": "x", "kind": "x", "params": {}, "text": {"en": "NOT SENT", "zh": "x"}}


@pytest.mark.parametrize(
    "error", [ERROR | {"outcome": None}, ERROR | {"outcome": OUTCOME | {"key": "drives.stop_withheld"}}]
)
def test_a_stop_that_was_not_sent_stays_although_the_drive_stands_still(visit: Any, error: Any) -> None:
    """Reads of a station that may be another model confirm nothing, and a stop that was not sent did not stop it."""
    page = visit("#/drive/pump-1")
    answer_stop(page, "drives/pump-1/stop", {"error": error}, 500)
    page.click("[data-stop=drive]")
    page.locator(".stop-status.bad").wait_for()
    page.wait_for_timeout(CONFIRMED_MS)
    assert page.locator(".stop-status.bad [data-do=dismiss-stop]").count() == 1


STOPPED = {"presence": "online", "stop_pending": False, "state": "stopped", "state_time_ms": 9000}
STATE_AFTER = """async ([entry, view]) => {
  const [store, { stops }] = await Promise.all(['store', 'control/stops'].map((one) => import(`/static/js/${one}.js`)));
  stops.value = [{ id: 1, target: { kind: 'all' }, phase: 'done', good: false, unconfirmed: ['x'], answered_ms: 5000,
    text: () => 'because', time_ms: 1, ...entry }];
  for (const state of [view, { ...view, state: 'running' }]) store.drive('x').value = state;
  const [{ good, acknowledged, text }] = stops.value;
  store.drive('x').value = null;
  stops.value = [];
  return good ? (acknowledged ? 'acknowledged' : 'confirmed') : text();
}"""


@pytest.mark.parametrize(
    ("entry", "view", "expected"),
    [
        ({}, {}, "confirmed"),
        ({}, {"state": "fault"}, "confirmed"),
        ({"acknowledgedDrives": ["y"]}, {}, "acknowledged"),
        ({}, {"presence": "offline"}, "because"),
        ({}, {"stop_pending": True}, "because"),
        ({}, {"state": "decelerating"}, "because"),
        ({}, {"state": "unknown"}, "because"),
        ({}, {"state_time_ms": 5900}, "because"),
        ({}, {"state_time_ms": None}, "because"),
        ({"withheld": ["x"]}, {}, "because"),
        ({"phase": "failed"}, {}, "because"),
        ({"unconfirmed": []}, {}, "because"),
        ({"unconfirmed": ["x", "y"]}, {}, "because"),
    ],
)
def test_only_a_later_read_of_the_output_off_confirms_a_stop(
    scripts: Any, entry: Any, view: Any, expected: str
) -> None:
    """A start after the confirmation changes no result."""
    assert scripts.evaluate(STATE_AFTER, [entry, STOPPED | view]) == expected


def test_the_page_groups_states_as_the_drives_do(scripts: Any) -> None:
    """Regression: on the page of a braking or paused drive the outcome of its start disappeared."""
    found = scripts.evaluate("import('/static/js/drive-states.js').then((m) => [m.OFF_STATES, m.TURNING_STATES])")
    assert {*found[0]} == {str(state) for state in DriveState if state.output_off}
    assert {*found[1]} == {str(state) for state in DriveState if state.turning}


REPLACED = (
    (("all", None), ("drive", "fan-1"), []),
    (("drive", "fan-1"), ("drive", "fan-1"), []),
    (("group", "air"), ("drive", "fan-1"), []),
    (("drive", "pump-1"), ("drive", "fan-1"), [1]),
    (("group", "water"), ("drive", "fan-1"), [1]),
    (("drive", "fan-1"), ("group", "air"), [1]),
    (("group", "air"), ("all", None), [1]),
)
"""Newer stop, older stop without a confirmed result, and what of the older one is left."""


def test_only_a_stop_of_the_same_drives_replaces_an_unconfirmed_one(visit: Any) -> None:
    page = visit("#/fleet")
    page.locator("option[value=air]").wait_for(state="attached")  # its drives are known
    page.route("**/stop", lambda route: route.fulfill(status=200, json={"outcomes": {}, "buses": {}}))
    script = """async (cases) => {
      const m = await import('/static/js/control/stops.js');
      const text = () => '';
      return cases.map(([newer, [kind, id]]) => {
        const target = { kind, id };
        m.stops.value = [{ id: 1, target, phase: 'done', good: false, unconfirmed: [], text, time_ms: 1 }];
        m.stop(...newer);
        return m.stops.value.slice(1).map((one) => one.id);
      });
    }"""
    left = page.evaluate(script, [[newer, older] for newer, older, _ in REPLACED])
    assert left == [expected for *_, expected in REPLACED]


@pytest.mark.parametrize("way", ["#/drive/fan-1", "#/fleet"])
@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_motion_that_was_read_before_a_stop_is_marked_until_the_drive_is_read_again(
    visit: Any, language: str, way: str
) -> None:
    """Regression: on a bus that is read every ten seconds the drive was shown as running for so long after a stop."""
    expect, page = expecting(), visit(way, language=language)
    mark = page.locator(".drivestate .state, .tile:has([data-drive=fan-1]) .state")
    show = """async ([state, stopped_ms]) => {
      const store = await import('/static/js/store.js');
      const last_stop = { kind: 'all', actor: 'ann', time_ms: store.serviceNow() + stopped_ms };
      store.applyDelta({ topics: { 'drives/fan-1': { state, last_stop } } });
    }"""
    hold_topics(page)
    hour_ms = 3_600_000
    running, last_known = word("drives.state_running", language), word("page.state_was", language)
    page.evaluate(show, ["running", hour_ms])
    expect(mark).to_contain_text(running)
    expect(mark).to_contain_text(last_known)
    expect(mark).to_have_class("state doubt")
    page.evaluate(show, ["stopped", hour_ms])  # a drive at rest is at rest after a stop too
    expect(mark).to_have_class("state calm")
    expect(mark).not_to_contain_text(last_known)
    page.evaluate(show, ["running", -hour_ms])
    expect(mark).to_have_class("state active")
    expect(mark).not_to_contain_text(last_known)


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_reason_of_the_last_stop_is_shown_whole(visit: Any, language: str) -> None:
    """At 1280 pixels it ended with an ellipsis, before its time."""
    page = visit("#/drive/fan-1", language=language)
    hold_topics(page)
    overflow = page.evaluate("""async () => {
      const store = await import('/static/js/store.js');
      const found = [];
      for (const kind of ['automatic', 'test', 'all']) {
        const last_stop = { kind, actor: 'administrator', time_ms: Date.now() };
        store.applyDelta({ topics: { 'drives/fan-1': { last_stop } } });
        while (document.querySelector('.last-stop')?.dataset.stopBy !== kind) await new Promise(requestAnimationFrame);
        const text = document.querySelector('.last-stop span');
        if (text.scrollHeight > text.clientHeight) found.push(kind);
      }
      return found;
    }""")
    assert overflow == []


def test_a_stop_has_the_time_of_the_service_where_the_browser_has_another(stage: Stage, visit: Any) -> None:
    """On a tablet whose clock was hours wrong it differed from the audit trail, and from the alarms beside it."""
    page = visit("#/drive/fan-1")
    page.add_init_script("{ const now = Date.now; Date.now = () => now() - 5 * 3_600_000; }")
    page.reload()
    page.wait_for_selector(".connection.live")
    page.click("[data-stop=drive]")
    page.locator(".stop-status.good").wait_for()
    shown = page.locator(".stop-status time").inner_text()
    recent = page.evaluate("""async () => {
      const [{ clock }, { serviceNow }] = await Promise.all(
        ["format", "store"].map((one) => import(`/static/js/${one}.js`)));
      return Array.from({ length: 60 }, (_, n) => clock(serviceNow() - n * 1000));
    }""")
    assert shown in recent
    wrong = page.evaluate("import('/static/js/format.js').then(({ clock }) => clock(Date.now()))")
    assert wrong.split(":")[0] != shown.split(":")[0]


ABORTS = """() => {
  window.aborts = [];
  const { fetch } = window, begun = performance.now();
  window.fetch = (url, options) => {
    const isStop = String(url).endsWith('/fan-1/stop');
    if (isStop) options.signal.addEventListener('abort', () => window.aborts.push(performance.now() - begun));
    return fetch(url, options);
  };
}"""
"""Script that records the milliseconds until each stop of the fan is given up."""


def test_a_stop_that_is_repeated_frees_the_connections_that_the_next_stop_needs(visit: Any) -> None:
    """Six stops of a drive with a long ramp held the six connections of the browser: a stop of all waited in it."""
    page = visit("#/drive/fan-1")
    held, ended = list[Any](), list[Any]()
    page.route("**/api/v1/drives/fan-1/stop", lambda route: held.append(route.request))
    page.on("requestfailed", lambda request: ended.append(request))
    page.evaluate(ABORTS)
    page.evaluate("() => { for (let n = 0; n < 3; n += 1) document.querySelector('[data-stop=drive]').click(); }")
    wait_until(page, lambda: len(held) == 3 and len(ended) == 2, "the connection of a replaced stop is not freed")
    assert [request in ended for request in held] == [True, True, False]
    assert min(page.evaluate("window.aborts")) > 1500, "a stop has time to reach the server"
    page.click("[data-stop=all]")
    expecting()(page.locator(".stop-status.good")).to_have_count(1)
    wait_until(page, lambda: all(request in ended for request in held), "the stop of all frees no connection")


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_session_that_controls_a_drive_shows_on_every_page_which_user_stopped_it(
    stage: Stage, visit: Any, language: str
) -> None:
    """The fleet page of the user who had started the drives did not say that a colleague had stopped them."""
    page = visit("#/drive/fan-1", role="operator", language=language)
    page.click("[data-do=take]")
    page.locator(".lease.own").wait_for()
    go_to(page, "fleet")
    notice = page.locator("[data-stopped-by]")
    name = {"en": "Supply fan", "zh": "送风机"}[language]
    for kind, stop in (
        ("drive", lambda: stage.call("drive.stop", drive="fan-1")),
        ("all", lambda: stage.call("plant.stop")),
    ):
        stop()
        sentence = word(f"page.foreign_stop_{kind}", language, actor="tester", name=name, time="TIME")
        expecting()(notice).to_have_count(1)
        for part in sentence.split("TIME"):
            expecting()(notice).to_contain_text(part.strip())
    notice.locator("[data-do=read]").click()
    expecting()(notice).to_have_count(0)


def test_only_a_new_stop_of_another_user_for_a_drive_of_this_session_is_announced(visit: Any) -> None:
    """Neither an old stop, nor one by the service or by this user; a start of the drive ends the notice."""
    script = """async () => {
      const [store, session, m] = await Promise.all(
        ['store', 'session', 'control/foreign-stops'].map((one) => import(`/static/js/${one}.js`)));
      const { user, session: own } = session.session.value;
      const stop = (kind, actor, time_ms) => ({ kind, actor, time_ms });
      const shown = [];
      for (const [last_stop, of] of [
        [stop('drive', 'bob', 1), own], [stop('drive', user, 2), own], [stop('automatic', 'drivebus', 3), own],
        [stop('group', 'bob', 4), 'another'], [stop('group', 'bob', 5), own], [stop('group', 'bob', 5), own],
        [null, own],
      ]) {
        store.applyDelta({ topics: { 'drives/x': { lease: { owner: user, session: of }, last_stop } } });
        await DRAWN;
        shown.push(m.foreignStops.value.length);
      }
      store.applyDelta({ topics: {}, removed: ['drives/x'] });
      return shown;
    }""".replace("DRAWN", DRAWN)
    assert visit("#/settings").evaluate(script) == [0, 0, 0, 0, 1, 1, 0]
