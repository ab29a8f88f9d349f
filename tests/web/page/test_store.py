"""The page's modules for messages, lost connections and answers, called one by one in the browser."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from drivebus import i18n
from drivebus.web.live.messages import MAX_RENEWALS
from fixtures.browser import Stage, log_in
from fixtures.browser_actions import DRAWN, expecting


@pytest.fixture
def page(stage: Stage, visit: Any) -> Any:
    return visit("#/settings")


def evaluate(page: Any, module: str, call: str) -> Any:
    return page.evaluate(f"import('/static/js/{module}.js').then((m) => {call})")


SIGNAL = "{value: 25, unit: 'Hz', quality: 'good', reason: null, source_time_ms: 800}"


def test_a_delta_is_merged_into_the_known_values(scripts: Any) -> None:
    """Top-level keys are replaced whole, signals one by one with their times."""
    old = f"{{state: 'stopped', bus: 'a', signals: {{hz: {SIGNAL}, a: {SIGNAL}}}}}"
    hz = "{value: 30, unit: 'Hz', quality: 'good', reason: null, source_time_ms: 2000}"
    change = f"{{state: 'running', signals: {{hz: {hz}}}}}"
    found = evaluate(
        scripts, "store", f"m.mergeTopic('drives/x', m.mergeTopic('drives/x', null, {old}, 1, 1000), {change}, 7, 2000)"
    )
    assert (found["state"], found["bus"]) == ("running", "a")
    assert (found["signals"]["hz"]["value"], found["signals"]["hz"]["readAt"]) == (30, 7)
    assert (found["signals"]["a"]["value"], found["signals"]["a"]["readAt"]) == (25, -199)


def test_many_leases_are_renewed_in_messages_that_the_server_takes(scripts: Any) -> None:
    drives = "Array.from({length: 450}, (_, n) => `d${n}`)"
    found = evaluate(scripts, "live", f"m.renewMessages({drives})")
    assert [len(message["renew"]) for message in found] == [MAX_RENEWALS, MAX_RENEWALS, 50]
    assert [drive for message in found for drive in message["renew"]] == [f"d{n}" for n in range(450)]
    assert evaluate(scripts, "live", "m.renewMessages([])") == []


DELTAS_FASTER_THAN_FRAMES = """async (store) => {
  const ids = Array.from({length: 120}, (_, n) => `slow-${n}`);
  const topics = (n) => Object.fromEntries(ids.map((id) => [`drives/${id}`, {id, n, signals: {}}]));
  for (let n = 1; n <= 6; n += 1) {
    store.applyDelta({time_ms: n, topics: topics(n)});
    await new Promise(requestAnimationFrame);
  }
  const found = ids.map((id) => store.drive(id).peek()?.n ?? 0);
  store.applySnapshot({topics: {}});
  return found;
}"""


def test_a_slow_screen_shows_every_drive_though_all_change_in_each_message(scripts: Any) -> None:
    """With 120 drives the last ones were never drawn where a frame took the time of a message."""
    found = evaluate(scripts, "store", f"({DELTAS_FASTER_THAN_FRAMES})(m)")
    assert len(found) == 120
    assert min(found) >= 2


def test_control_of_a_drive_is_renewed_before_the_screen_shows_it(page: Any) -> None:
    call = """Promise.all(["store", "session"].map((name) => import(`/static/js/${name}.js`)))
    .then(([store, session]) => {
      const lease = {session: session.session.peek().session, owner: 'engineer'};
      store.applyDelta({topics: {'drives/fan-1': {lease}}});
      return [store.drive('fan-1').peek().lease, m.ownDrives()];
    })"""
    page.wait_for_function("() => import('/static/js/store.js').then((m) => m.drive('fan-1').peek() !== null)")
    assert evaluate(page, "control/leases", call) == [None, ["fan-1"]]


def test_a_feed_grows_to_its_newest_five_hundred(scripts: Any) -> None:
    """No list of the page grows without limit (I12)."""
    call = "m.mergeTopic('frames/a', {items: [1, 2], missed: 3}, Array.from({length: 600}, (_, n) => n), 1)"
    found = evaluate(scripts, "store", call)
    assert (len(found["items"]), found["items"][-1], found["missed"]) == (500, 599, 3)


def test_a_topic_missing_in_a_snapshot_is_removed(page: Any) -> None:
    message = "{time_ms: 0, topics: {'drives/other': {id: 'other', signals: {}}}}"
    evaluate(page, "store", f"m.applySnapshot({message})")
    page.wait_for_function(
        "() => import('/static/js/store.js').then((m) => m.drive('fan-1').peek() === null || m.drive('other').peek())"
    )


STOPS = (
    ("{outcome: {status: 'confirmed', text: 'x'}}", "confirmed"),
    ("{outcome: {status: 'acknowledged', text: 'x'}}", "acknowledged"),
    ("{outcome: {status: 'unknown', text: 'x'}}", "unconfirmed"),
    ("{outcomes: {a: {status: 'confirmed'}, b: {code: 'bus.no_reply'}}}", "unconfirmed"),
    ("{outcomes: {a: {status: 'confirmed'}, b: {status: 'acknowledged'}}}", "acknowledged"),
    ("{outcomes: {a: {status: 'confirmed'}}, buses: {l: {confirmed: true, unconfirmed: []}}}", "confirmed"),
    ("{outcomes: {a: {status: 'confirmed'}}, buses: {l: {confirmed: false, unconfirmed: ['b']}}}", "unconfirmed"),
    (
        "{outcomes: {a: {status: 'acknowledged'}}, buses: {l: {confirmed: false, acknowledged: ['a']}}}",
        "acknowledged",
    ),
    ("{outcomes: {}, buses: {l: {confirmed: false, unconfirmed: []}}}", "unconfirmed"),
    ("{outcomes: {}, buses: {}}", "unconfirmed"),
)


def test_only_a_confirmed_stop_is_shown_as_confirmed(scripts: Any) -> None:
    """Unconfirmed stops are listed drive by drive; an acknowledged one is neither confirmed nor a failure."""
    shown = "((r) => r.good ? (r.acknowledged ? 'acknowledged' : 'confirmed') : 'unconfirmed')"
    message = {answer: evaluate(scripts, "control/stops", f"{shown}(m.evaluateStop({answer}))") for answer, _ in STOPS}
    assert message == dict(STOPS)
    cases = (
        ("{outcomes: {a: {status: 'confirmed'}, b: {code: 'bus.no_reply'}}}", "page.stop_unconfirmed", "b"),
        ("{outcomes: {a: {status: 'acknowledged'}}, buses: {l: {unconfirmed: ['b']}}}", "page.stop_unconfirmed", "b"),
        ("{outcomes: {a: {status: 'confirmed'}, b: {status: 'acknowledged'}}}", "page.stop_acknowledged", "b"),
        ("{outcomes: {a: {status: 'confirmed'}}, buses: {l: {confirmed: true}}}", "page.stop_all_confirmed", ""),
        ("{outcomes: {}, buses: {l: {confirmed: false}}}", "page.stop_unconfirmed", "l"),
        ("{outcomes: {}, buses: {}}", "page.stop_no_drives", ""),
    )
    for answer, key, names in cases:
        text = evaluate(scripts, "control/stops", f"m.evaluateStop({answer}).text()")
        assert text == i18n.text(key, "en", n=1, names=names), answer
    of_many = "{buses: {l: {unconfirmed: Array.from({length: 72}, (_, n) => `d${n}`)}}}"
    text = evaluate(scripts, "control/stops", f"m.evaluateStop({of_many}).text()")
    assert text == i18n.text("page.stop_unconfirmed", "en", n=72, names="d0, d1, d2, d3, d4, d5, d6, d7 and 64 more")


def test_a_frequency_beyond_the_limits_is_not_sent(scripts: Any) -> None:
    texts = {"20": True, "0": True, "45": True, "45.1": False, "-1": False, "": False, "x": False}
    call = "m.frequencyError({!r}, {{minimum_hz: 0, maximum_hz: 45}}) === null"
    assert {text: evaluate(scripts, "control/frequency", call.format(text)) for text in texts} == texts
    capped = "m.frequencyError({!r}, {{minimum_hz: 0, maximum_hz: 45, setpoint_cap_hz: 5}}) === null"
    texts = {"5": True, "5.1": False}
    assert {text: evaluate(scripts, "control/frequency", capped.format(text)) for text in texts} == texts


def test_the_fleet_keeps_the_files_order_also_when_a_drives_page_was_opened_first(visit: Any) -> None:
    page = visit("#/drive/pump-1")
    page.evaluate("location.hash = '#/fleet'")
    page.wait_for_selector(".tile")
    shown = page.locator(".tilelink").evaluate_all("(all) => all.map((one) => one.dataset.drive)")
    assert shown == ["fan-1", "fan-2", "fan-3", "pump-1", "pump-2"]


@pytest.mark.parametrize("state", ["running", "stopped", "unknown", "fault"])
def test_a_drive_that_answers_is_counted_by_its_state_also_where_that_is_unknown(scripts: Any, state: str) -> None:
    """A DF800 never reports its state; regression: only the filter "all" showed it."""
    view = f"{{presence: 'online', state: '{state}', fault: null, alarms: {{}}}}"
    found = set(evaluate(scripts, "fleet/fleet-filter", f"[...m.kindsOf({view})]")) - {"abnormal"}
    assert found == {"all", state}


def test_a_silent_connection_makes_all_values_stale(stage: Stage, visit: Any) -> None:
    """The socket stays open without messages, as behind a frozen proxy; after two heartbeats all values are stale."""
    script = """
      const real = window.WebSocket;
      window.sockets = [];
      window.WebSocket = class extends real {
        constructor(...args) { super(...args); window.sockets.push(this); }
        set onmessage(act) { super.onmessage = act && ((event) => { if (!window.muted) act(event); }); }
      };
    """
    page = visit("#/fleet", role=None)
    page.add_init_script(script)
    page.reload()
    log_in(page, "operator")
    page.locator(".tile .value.good").first.wait_for()
    page.evaluate("window.muted = true")
    page.locator(".banner.bad").wait_for()
    assert page.locator(".tile .value.good").count() == 0
    assert page.locator(".tile.old").count() == 5
    assert page.locator("[data-stop=all]").is_enabled()
    page.evaluate("window.muted = false")
    page.locator(".connection.live").wait_for()
    page.locator(".tile .value.good").first.wait_for()


def test_an_alarm_that_no_user_has_acknowledged_goes_before_an_acknowledged_one_of_its_priority(scripts: Any) -> None:
    script = """async () => {
      const [store, m] = await Promise.all(['store', 'alarms/alarm-list'].map((one) => import(`/static/js/${one}.js`)));
      const alarm = (id, priority, acknowledged_ms, raised_ms) => ({
        id, priority, acknowledged_ms, raised_ms, shelved_until_ms: null });
      store.applyDelta({ topics: { alarms: { active: [
        alarm('read', 'critical', 5, 4), alarm('new', 'critical', null, 1), alarm('low', 'low', null, 9)] } } });
      await DRAWN;
      const found = [m.openAlarms().map(({ id }) => id), m.urgentAlarms().map(({ id }) => id)];
      store.applyDelta({ topics: { alarms: { active: [] } } });
      return found;
    }"""
    assert scripts.evaluate(script.replace("DRAWN", DRAWN)) == [["new", "read", "low"], ["new"]]


def test_an_alarm_that_is_cleared_and_not_acknowledged_is_listed_and_not_counted_as_active(scripts: Any) -> None:
    script = """async () => {
      const [store, m] = await Promise.all(['store', 'alarms/alarm-list'].map((one) => import(`/static/js/${one}.js`)));
      const alarm = (id, cleared_ms) => ({
        id, cleared_ms, priority: 'high', acknowledged_ms: null, raised_ms: 1, shelved_until_ms: null });
      store.applyDelta({ topics: { alarms: { active: [alarm('over', 5), alarm('holds', null)] } } });
      await DRAWN;
      const found = [m.openAlarms().length, m.uncleared(m.openAlarms()).map(({ id }) => id)];
      store.applyDelta({ topics: { alarms: { active: [] } } });
      return found;
    }"""
    assert scripts.evaluate(script.replace("DRAWN", DRAWN)) == [2, ["holds"]]


def test_equal_alarms_are_one_group_only_where_they_were_shelved_together(scripts: Any) -> None:
    """A group shows one author, reason and end, and is unshelved as a whole."""
    script = """async () => {
      const { groupAlarms } = await import('/static/js/alarms/alarm-groups.js');
      const alarm = (id, shelved_reason) => ({ id, shelved_reason, kind: 'stale', setting: 's', priority: 'low',
        subject: '', drive: '', value: null, shelved_by: 'ann', shelved_until_ms: 5 });
      const groups = groupAlarms([alarm(1, 'a'), alarm(2, 'b'), alarm(3, 'a'), alarm(4, 'a')]);
      return groups.map((group) => group.map(({ id }) => id));
    }"""
    assert scripts.evaluate(script) == [[1, 3, 4], [2]]


def test_alarms_of_one_kind_with_another_title_are_not_in_its_group(scripts: Any) -> None:
    """Drives that send bytes were counted under "No reply", and handed-over control under "Control lost"."""
    script = """async () => {
      const { groupAlarms } = await import('/static/js/alarms/alarm-groups.js');
      const alarm = (id, title) => ({ id, title: { en: title }, kind: 'no_response', setting: 's', priority: 'low',
        subject: '', drive: '', value: null });
      const [some, none] = ['No usable reply', 'No reply'];
      const groups = groupAlarms([alarm(1, none), alarm(2, some), alarm(3, none), alarm(4, none)]);
      return groups.map((group) => group.map(({ id }) => id));
    }"""
    assert scripts.evaluate(script) == [[1, 3, 4], [2]]


def test_the_drives_of_a_group_of_alarms_are_named_in_their_order_and_counted_beyond_six(scripts: Any) -> None:
    script = """async () => {
      await (await import('/static/js/i18n.js')).loadLanguage('en');
      const { groupSubject } = await import('/static/js/alarms/alarm-groups.js');
      return groupSubject([10, 9, 2, 1, 11, 3, 4, 5].map((n) => ({ drive: `motor ${n}`, subject: '' })));
    }"""
    names = "motor 1, motor 2, motor 3, motor 4, motor 5, motor 9"
    assert scripts.evaluate(script) == i18n.text("page.names_more", "en", names=names, n=2)


def closed_up(sentence: str) -> str:
    """Return a sentence without the spaces between two Chinese letters, as the page shows it."""
    return re.sub(r"(?<=[\u4e00-\u9fff]) (?=[\u4e00-\u9fff])", "", sentence)


def test_a_chinese_name_in_a_chinese_sentence_has_no_spaces_and_a_latin_one_has(scripts: Any) -> None:
    script = """async () => {
      const { loadLanguage, t } = await import('/static/js/i18n.js');
      await loadLanguage('zh');
      const texts = ['循环泵', 'fan-1', '排风 5 号'].map((name) => t('page.control_ask_title', { name }));
      await loadLanguage('en');
      return [...texts, t('page.control_ask_title', { name: 'fan-1' })];
    }"""
    titles = ["请求循环泵的控制权", "请求 fan-1 的控制权", "请求排风 5 号的控制权", "Ask for control of fan-1"]
    assert scripts.evaluate(script) == titles


def test_two_chinese_values_side_by_side_have_no_space_between_them_on_the_page(scripts: Any) -> None:
    evaluate(scripts, "i18n", "m.loadLanguage('zh')")
    values = [("九十", "转"), (90, "转"), ("九十", "Hz")]
    texts = [
        evaluate(scripts, "i18n", f"m.t('page.spark', {{high: {json.dumps(high)}, unit: '{unit}'}})")
        for high, unit in values
    ]
    evaluate(scripts, "i18n", "m.loadLanguage('en')")
    assert [text.rpartition("至")[2].strip() for text in texts] == ["九十转", "90 转", "九十 Hz"]


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_takeover_of_a_drive_is_shown_until_it_is_dismissed(stage: Stage, visit: Any, language: str) -> None:
    page = visit("#/drive/fan-1", role="operator", language=language)
    message = page.locator(".takeovers .banner")
    for taken in (False, True):
        page.click("[data-do=take]")
        page.locator(".lease.own").wait_for()
        if not taken:  # a released drive is not taken from the owner
            page.click(".lease.own button")
        stage.wait(lambda taken=taken: bool(stage.view("fan-1")["lease"]) is taken, "no lease")  # type: ignore[misc]
        stage.call("lease.take", drive="fan-1")
        page.locator(".lease:not(.own) .holder", has_text="tester").wait_for()
        expecting()(message).to_have_count(int(taken))
        if not taken:
            stage.call("lease.release", drive="fan-1")
    name = {"en": "Supply fan", "zh": "送风机"}[language]
    reply_text = closed_up(i18n.text("page.taken", language, owner="tester", name=name, time=r"\d\d:\d\d:\d\d"))
    page.evaluate("location.hash = '#/alarms'")
    page.reload()
    page.locator(".connection.live").wait_for()
    message.filter(has_text=name).wait_for()  # the drives' names come a moment after the connection
    assert re.search(reply_text, message.inner_text()) and page.get_attribute(".takeovers", "role") == "status"
    page.click("[data-do=read]")
    message.wait_for(state="detached")
    page.reload()
    page.locator(".connection.live").wait_for()
    assert message.count() == 0


def test_a_takeover_during_a_lost_connection_is_shown_without_a_time(page: Any) -> None:
    found = page.evaluate(
        """async () => {
      const [store, live, session, m] = await Promise.all(
        ['store', 'live', 'session', 'control/takeovers'].map((one) => import(`/static/js/${one}.js`)));
      const hold = (owner, of) => store.applyDelta({ topics: { 'drives/x': { lease: { owner, session: of } } } });
      hold('me', session.session.value.session);
      await DRAWN;
      live.connection.value = 'lost';
      hold('bob', 'another');
      await DRAWN;
      live.connection.value = 'live';
      return m.takeovers.value;
    }""".replace("DRAWN", DRAWN)
    )
    assert found == [{"drive": "x", "owner": "bob", "cause": "taken", "time_ms": None}]


def test_a_namesake_at_the_command_line_is_no_other_window_of_the_user(page: Any) -> None:
    """The page took that takeover for one in another window of the user."""
    found = page.evaluate(
        """async () => {
      const [store, session, m] = await Promise.all(
        ['store', 'session', 'control/takeovers'].map((one) => import(`/static/js/${one}.js`)));
      const { user, session: own } = session.session.value;
      const causes = [];
      for (const remote of [true, false]) {
        for (const of of [own, 'another']) {
          store.applyDelta({ topics: { 'drives/x': { lease: { owner: user, session: of, remote } } } });
          await DRAWN;
        }
        causes.push(m.takeovers.value.at(-1).cause);
      }
      return causes;
    }""".replace("DRAWN", DRAWN)
    )
    assert found == ["window", "taken"]


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_control_lease_that_ended_without_a_release_is_announced(visit: Any, language: str) -> None:
    page = visit("#/settings", language=language)
    page.evaluate(
        """async () => {
      const [store, session, live] = await Promise.all(
        ['store', 'session', 'live'].map((one) => import(`/static/js/${one}.js`)));
      while (!live.isLive.value) await new Promise((resolve) => { setTimeout(resolve, 20); });
      for (const lease of [{ owner: 'me', session: session.session.value.session }, null]) {
        store.applyDelta({ topics: { 'drives/fan-1': { lease } } });
        await DRAWN;
      }
    }""".replace("DRAWN", DRAWN)
    )
    name = {"en": "Supply fan", "zh": "送风机"}[language]
    page.locator(".takeovers .banner", has_text=name).wait_for()
    shown = page.locator(".takeovers .banner a").inner_text()
    ended = i18n.text("page.control_ended_ended", language, name=name, time=r"\d\d:\d\d:\d\d")
    assert re.fullmatch(closed_up(ended), shown)
    page.evaluate("""() => import('/static/js/control/takeovers.js').then((m) => {
      m.takeovers.value = [{ drive: 'fan-1', owner: null, cause: 'ended', time_ms: null }];
    })""")
    unseen = closed_up(i18n.text("page.control_ended_unseen", language, name=name))
    page.locator(".takeovers .banner a", has_text=unseen).wait_for()


def test_the_takeovers_of_one_user_are_one_sentence_that_one_press_dismisses(page: Any) -> None:
    """Regression: a group of 30 drives that an engineer took over left 20 notices, and 10 drives without one."""
    page.evaluate("""() => import('/static/js/control/takeovers.js').then((m) => {
      const taken = (drive, owner) => ({ drive, owner, cause: 'taken', time_ms: 1 });
      const items = Array.from({ length: 30 }, (_, n) => taken(`m${n}`, 'bob'));
      m.takeovers.value = [...items, taken('fan-1', 'eva')];
    })""")
    banners = page.locator(".takeovers .banner")
    banners.filter(has_text="m7 and 22 more").wait_for()
    assert banners.count() == 2
    banners.filter(has_text="bob").locator("[data-do=read]").click()
    banners.filter(has_text="bob").wait_for(state="detached")
    assert banners.count() == 1


def test_an_expired_session_leads_to_the_login_and_back(stage: Stage, visit: Any) -> None:
    """The page shows no data of an ended session."""
    page = visit("#/drive/fan-1")
    page.context.clear_cookies()
    page.keyboard.press("Shift")
    page.locator("input[name=password]").wait_for()
    log_in(page, "engineer")
    page.locator(".control").wait_for()


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_reason_of_an_uncertain_or_missing_value_is_beside_it(visit: Any, language: str) -> None:
    """The reason is visible without a mouse; a good value has none."""
    page = visit("#/drive/fan-1", language=language)
    for signal, reason in (("output_voltage", "profiles.scale_unpublished"), ("output_current", "drives.not_reported")):
        row = page.locator(".values th", has_text=i18n.text(f"signal.{signal}", language))
        row.locator(".reason", has_text=i18n.text(reason, language)).wait_for()
    good = page.locator(".values tr", has_text=i18n.text("signal.dc_bus_voltage", language))
    good.locator(".value.good").wait_for()
    assert good.locator(".reason").count() == 0


def test_parameters_are_read_compared_written_and_read_back(stage: Stage, visit: Any) -> None:
    """The user edits, reviews the difference and writes to RAM; saving is a separate step and happens once."""
    stage.call("waiver.grant", drive="fan-1", reason="watched bench")
    page = visit("#/drive/fan-1?tab=parameters")
    page.click("[data-do=take]")
    page.locator(".lease.own").wait_for()
    page.click("[data-do=read]")
    row = page.locator("tr", has=page.locator("code:text-is('F9.4')"))
    row.locator("td:nth-child(4):text-is('0')").wait_for()
    row.locator("input").fill("3,5")
    page.click("[data-do=review]")
    page.locator(".dialog .alarmtext").wait_for()
    assert page.locator("[data-do=write]").is_disabled()
    page.keyboard.press("Escape")
    row.locator("input").fill("3")
    page.click("[data-do=review]")
    page.locator(".dialog s:has-text('0')").wait_for()
    assert page.locator("[data-do=save]").count() == 0
    page.click("[data-do=write]")
    page.locator(".dialog .notice.good").wait_for()
    assert page.locator(".dialog .notice.good > div > p").count() == 1
    page.click("[data-do=save]")
    page.locator(".dialog [data-do=save]:disabled:not([aria-busy])").wait_for()
    page.keyboard.press("Escape")
    row.locator("td:nth-child(4):text-is('3')").wait_for()
    assert stage.call("parameters.read", drive="fan-1", names=["F9.4"])["parameters"]["F9.4"]["raw"] == 3
    stage.call("lease.take", drive="fan-1")
    stage.call("parameters.write", drive="fan-1", values={"F9.4": 0.0})


def test_a_value_redraws_its_own_tile_and_no_other(stage: Stage, visit: Any) -> None:
    """300 drives at 1 Hz stay smooth because each tile has its own signal and no list is rendered again."""
    page = visit("#/fleet")
    page.locator(".tile").nth(4).wait_for()
    stage.lose_server()
    page.locator(".tile.old").nth(4).wait_for()
    page.evaluate(DRAWN)
    drawn = page.evaluate("""async () => {
      const { options } = await import('/vendor/preact.js');
      const store = await import('/static/js/store.js');
      const found = [];
      const before = options.diffed;
      options.diffed = (vnode) => {
        if (vnode.type?.name === 'Tile') found.push(vnode.props.id);
        before?.(vnode);
      };
      const found_hz = { value: 12.34, unit: 'Hz', quality: 'good', reason: null, source_time_ms: 1 };
      const signals = { output_frequency: found_hz };
      store.applyDelta({ time_ms: 1, topics: { 'drives/fan-2': { state: 'running', signals } } });
      await new Promise((resolve) => { setTimeout(resolve, 1200); });
      options.diffed = before;
      return found;
    }""")
    stage.regain_server()
    assert drawn == ["fan-2"]


def test_no_sound_is_tried_before_the_first_key_on_the_page(page: Any) -> None:
    """The browser refused it, with a warning for each alarm."""
    page.evaluate(
        "() => { window.tried = 0; window.touched = { hasBeenActive: false }; "
        "Object.defineProperty(navigator, 'userActivation', { get: () => window.touched }); "
        "const Real = AudioContext; "
        "window.AudioContext = class extends Real { constructor() { super(); window.tried += 1; } }; }"
    )
    evaluate(page, "alarms/alarm-sound", "m.play()")
    assert page.evaluate("window.tried") == 0
    page.evaluate("window.touched = { hasBeenActive: true }")
    evaluate(page, "alarms/alarm-sound", "m.play()")
    assert page.evaluate("window.tried") == 1


def test_the_sound_that_one_tab_turns_off_is_off_in_every_tab_of_the_browser(visit: Any) -> None:
    """The button showed "off in this browser", and another tab went on to sound."""
    page = visit("#/settings")
    page.click("h1")  # a browser plays no sound before the first click
    other = page.context.new_page()
    other.goto(page.url)
    other.locator("[data-do=sound]").wait_for()
    for is_on in ("false", "true"):
        page.click("[data-do=sound]")
        for tab in (page, other):
            tab.locator(f"[data-do=sound][aria-pressed={is_on}]").wait_for()


@pytest.mark.parametrize("language", ["en", "zh"])
def test_after_a_reload_the_sound_button_says_that_the_browser_waits_for_a_click(visit: Any, language: str) -> None:
    """Regression: it said that the sound is on, and no alarm sounded. The click that permits it turns nothing off."""
    page = visit("#/settings", language=language)
    page.add_init_script(
        "window.touched = { hasBeenActive: false };"
        "Object.defineProperty(navigator, 'userActivation', { get: () => window.touched });"
        "addEventListener('pointerdown', () => { window.touched = { hasBeenActive: true }; });"
    )
    page.reload()
    button = page.locator("[data-do=sound]")
    button.locator(".icon-silenced").wait_for()
    assert button.get_attribute("title") == i18n.text("page.alarm_sound_waits", language)
    for how, icon in (("on", "sound"), ("off", "silenced"), ("on", "sound")):
        button.click()
        page.locator(f"[data-do=sound][title='{i18n.text(f'page.alarm_sound_{how}', language)}']").wait_for()
        assert button.locator(f".icon-{icon}").count() == 1


@pytest.mark.parametrize(
    ("real", "requested", "expected"), [("0.5", "0.5", None), ("15", "0.5", 15), ("15", "15", None), ("1", "0.5", None)]
)
def test_a_poll_interval_is_shown_where_it_is_longer_than_expected(
    scripts: Any, real: str, requested: str, expected: float | None
) -> None:
    view = f"{{poll_interval_s: {real}, requested_interval_s: {requested}}}"
    assert evaluate(scripts, "readings", f"m.slowInterval({view})") == expected


def test_a_date_is_shown_in_the_order_of_iso_8601(scripts: Any) -> None:
    """Regression: it was 22/11/2026, also in a browser of a country where the month comes first."""
    time_ms = "new Date(2026, 10, 22, 14, 3, 5).getTime()"
    shown = scripts.evaluate(f"import('/static/js/format.js').then(({{ moment }}) => moment({time_ms}))")
    assert shown == "2026-11-22 14:03:05"


@pytest.mark.parametrize(
    ("search", "expected"), [("", ["a", "b"]), ("英沃 vc", ["a"]), ("DELTA rtu", []), ("delta", ["b"])]
)
def test_models_are_found_by_words_of_either_language(scripts: Any, search: str, expected: list[str]) -> None:
    models = (
        "[{model: 'a', family: 'modbus', maker: {en: 'Yingwo', zh: '英沃'}, title: {en: 'VC660', zh: 'VC660'}}, "
        "{model: 'b', family: 'modbus', maker: {en: 'Delta', zh: '台达'}, title: {en: 'MS300', zh: 'MS300'}}]"
    )
    found = evaluate(scripts, "settings/model-list", f"m.matching({models}, '{search}').map((one) => one.model)")
    assert found == expected


CITED = {
    "en": [
        ("assumed", "steps of 0.1 Hz", "Source (assumed): steps of 0.1 Hz"),
        ("computed", "", "Source: computed"),
    ],
    "zh": [
        ("manual", "第 95 页：3000H", "出处（手册）：第 95 页：3000H"),
        ("assumed", "步长 0.1 Hz", "出处（假定）：步长 0.1 Hz"),
        ("computed", "", "出处：计算所得"),
    ],
}


@pytest.mark.parametrize("language", CITED)
def test_the_source_of_a_fact_has_its_kind_in_the_language_of_the_page(scripts: Any, language: str) -> None:
    """Regression: beside its source the kind was left out, so that an assumed step read like a published one."""
    evaluate(scripts, "i18n", f"m.loadLanguage('{language}')")
    shown = [
        evaluate(scripts, "drive/evidence", f"m.evidenceText({json.dumps({'kind': kind, 'text': {language: source}})})")
        for kind, source, _ in CITED[language]
    ]
    evaluate(scripts, "i18n", "m.loadLanguage('en')")
    assert shown == [expected for *_, expected in CITED[language]]
