"""An operator's day in a real browser on a real plant with simulated drives, in both languages."""

from __future__ import annotations

import re
from typing import Any

import pytest

from drivebus import i18n
from drivebus.drives.operations.steps import BusConditions
from drivebus.drives.permissives import unmet_bus_permissives
from drivebus.simulator.motor import Trip
from fixtures.browser import Stage
from fixtures.browser_actions import DRAWN, expecting, wait_until
from fixtures.service import WIDEST_LIMITS


def take(page: Any) -> None:
    page.click("[data-do=take]")
    page.wait_for_selector(".lease.own")


def run_at(page: Any, hertz: str) -> None:
    """Arm and confirm a start, and wait for its outcome, because a stop in between would void it."""
    page.fill(".control .frequency input[inputmode=decimal]", hertz)
    page.click("[data-step=first]")
    with page.expect_response("**/run"):
        page.click("[data-step=second]")


def running(stage: Stage, drive: str) -> bool:
    return stage.view(drive)["state"] in ("running", "accelerating")


@pytest.mark.parametrize("language", ["en", "zh"])
def test_an_operator_acknowledges_resets_runs_and_stops_all_also_after_a_lost_server(
    stage: Stage, visit: Any, language: str
) -> None:
    """Log in, see a trip, acknowledge, reset, run, change the setpoint, see the trend, stop all, lose the server and
    regain it."""

    def word(key: str, **params: Any) -> str:
        return i18n.text(key, language, **params)

    stage.call("waiver.grant", drive="fan-1", reason="watched bench")
    page = visit("#/fleet", language=language, role="operator")
    tile = page.locator(".tile", has=page.locator("[data-drive=fan-1]"))
    tile.locator(f".state:has-text('{word('drives.state_stopped')}')").wait_for()

    stage.station("fan-1", lambda drive: drive.trip(Trip.OVERHEAT))
    tile.locator(f".state.alarm:has-text('{word('drives.state_fault')}')").wait_for()
    page.locator(".banner.alarm.critical").wait_for()
    page.click("[data-do=acknowledge]")
    page.locator(".banner.alarm.critical").wait_for(state="detached")

    page.click("[data-drive=fan-1]")
    page.locator(".active-fault").wait_for()
    assert page.locator(".active-fault h2").inner_text().count("Fu.") == 1
    take(page)
    page.locator(".active-fault [data-do=incident]").wait_for()
    page.click(".active-fault [data-do=reset]")
    page.locator(".active-fault").wait_for(state="detached")

    run_at(page, "20")
    page.locator(f".drivestate:has-text('{word('drives.state_running')}')").wait_for()
    page.locator(f".control .notice.good:has-text('{word('page.outcome_confirmed')}')").wait_for()
    page.fill(".control .frequency input[inputmode=decimal]", "30")
    page.press(".control .frequency input[inputmode=decimal]", "Enter")
    page.locator(".bigvalues figure:first-child .number:has-text('30.00')").wait_for()
    page.locator(".trend-plot canvas").wait_for()

    page.click("[data-stop=all]")
    # On a busy machine the answer may come before the read of a drive.
    confirmed = "|".join(re.escape(word(key)) for key in ("page.stop_all_confirmed", "page.stop_confirmed_later"))
    page.locator(".stop-status.good", has_text=re.compile(confirmed)).wait_for()
    stage.wait(lambda: stage.view("fan-1")["state"] == "stopped", "the next poll does not report it")

    stage.lose_server()
    page.locator(".banner.bad[role=alert]").wait_for()
    page.locator(f".drivestate:has-text('{word('page.state_was')}')").wait_for()
    page.locator(".bigvalues .value.bad").first.wait_for()
    assert page.locator(".control .main:enabled, .lease.own").count() == 0
    page.evaluate("location.hash = '#/history'")
    page.locator("main .notice.bad").wait_for()
    stage.regain_server()
    page.locator("main .trend").wait_for()
    page.go_back()
    page.locator(".bigvalues figure:first-child .value.good").wait_for()


def test_a_stop_pressed_while_the_server_is_away_reaches_the_drives_when_it_is_back(stage: Stage, visit: Any) -> None:
    """Stale data and a lost connection do not prevent a stop; its outcome is shown."""
    stage.call("waiver.grant", drive="fan-1", reason="watched bench")
    page = visit("#/drive/fan-1")
    take(page)
    run_at(page, "20")
    stage.wait(lambda: running(stage, "fan-1"), "it does not run")
    stage.lose_server()
    page.locator(".banner.bad[role=alert]").wait_for()
    page.click("[data-stop=drive]")
    page.locator(
        f".stop-status.waiting:has-text('{i18n.text('page.stop_trying', 'en', what='Supply fan')}')"
    ).wait_for()
    assert running(stage, "fan-1")
    stage.regain_server()
    page.locator(".stop-status.good").wait_for()
    assert not running(stage, "fan-1")


def test_a_stop_is_repeated_while_the_plant_is_unavailable_or_the_token_is_old(stage: Stage, visit: Any) -> None:
    """Two temporary errors are followed by the plant's own answer, which is shown."""
    page = visit("#/fleet", role="operator")
    problem = {"kind": "x", "text": {"en": "not now", "zh": "x"}, "params": {}, "outcome": None}
    answers = [
        {"status": 503, "json": {"error": problem | {"code": "plant.unavailable", "status": 503}}},
        {"status": 403, "json": {"error": problem | {"code": "auth.csrf", "status": 403}}},
    ]
    held: list[Any] = []
    page.route("**/api/v1/stop", lambda route: route.fulfill(**answers.pop(0)) if answers else held.append(route))
    page.click("[data-stop=all]")
    wait_until(page, lambda: bool(held), "the stop is not repeated after both errors")
    page.locator(".stop-status.waiting").wait_for()
    held[0].fulfill(json={"outcomes": {"fan-1": {"status": "confirmed"}}, "buses": {}})
    page.locator(".stop-status.good").wait_for()


def test_a_stop_needs_no_lease_and_takes_none_away(stage: Stage, visit: Any) -> None:
    """There is no second step, and the user who controls the drive keeps the control."""
    stage.call("waiver.grant", drive="fan-1", reason="watched bench")
    owner, other = visit("#/drive/fan-1"), visit("#/drive/fan-1", role="operator")
    take(owner)
    run_at(owner, "20")
    stage.wait(lambda: running(stage, "fan-1"), "it does not run")
    assert other.locator("[data-step=first]").is_disabled()
    assert other.locator(".lease .holder").inner_text() == i18n.text("page.lease_other", "en", owner="engineer")
    other.click("[data-stop=drive]")
    other.locator(".stop-status.good").wait_for()
    assert not running(stage, "fan-1")
    assert stage.view("fan-1")["lease"]["owner"] == "engineer"


def test_a_group_is_stopped_from_its_filter(stage: Stage, visit: Any) -> None:
    page = visit("#/fleet?group=water", role="operator")
    page.locator(".fleettools .choice button:first-child:has-text('2')").wait_for()
    with page.expect_response("**/api/v1/groups/water/stop") as answered:
        page.click("[data-stop=group]")
    assert answered.value.json()["outcomes"].keys() == {"pump-1", "pump-2"}
    page.locator(".stop-status.good").wait_for()


def arm_group(stage: Stage, visit: Any, group: str, *drives: str) -> Any:
    """Return the page after the first step of a start of all drives of a group, at 20 Hz."""
    for drive in drives:
        stage.call("waiver.grant", drive=drive, reason="watched bench")
    page = visit(f"#/fleet?group={group}")
    page.click(".grouppanel summary")
    page.click(f".grouppanel .button:has-text('{i18n.text('page.lease_take_all', 'en', n=len(drives))}')")
    page.fill(".grouppanel input[inputmode=decimal]", "20")
    page.click("[data-step=first]:enabled")
    return page


def test_an_armed_start_names_its_group_and_does_not_move_to_another_group(stage: Stage, visit: Any) -> None:
    page = arm_group(stage, visit, "air", "fan-1", "fan-2", "fan-3")
    page.locator("[data-step=second]").wait_for()
    assert page.locator(".confirm strong").inner_text() == i18n.text("page.step_two_group", "en")
    assert "Air" in page.locator(".confirm").inner_text()
    page.evaluate("location.hash = '#/fleet?group=water'")
    page.locator("#group-title:has-text('Water')").wait_for()
    assert page.locator("[data-step=second], .confirm").count() == 0
    page.click(".grouppanel summary")
    assert page.input_value(".grouppanel input[inputmode=decimal]") == ""


def test_the_outcome_of_a_group_start_ends_with_the_stop_of_the_group(stage: Stage, visit: Any) -> None:
    """Regression: "Confirmed: the drive reports running" stood beside drives that had been stopped."""
    page = arm_group(stage, visit, "water", "pump-1", "pump-2")
    page.click("[data-step=second]")
    outcome = page.locator(".grouppanel .notice", has_text=i18n.text("page.outcome_confirmed", "en"))
    outcome.wait_for()
    page.click("[data-stop=group]")
    outcome.wait_for(state="detached")


def test_a_drive_that_has_tripped_since_a_group_start_is_not_reported_as_running(stage: Stage, visit: Any) -> None:
    """Beside "2 of 30 tripped" stood the names of both: "Confirmed: the drive reports running"."""
    page = arm_group(stage, visit, "water", "pump-1", "pump-2")
    page.click("[data-step=second]")
    outcome = page.locator(".grouppanel .notice", has_text=i18n.text("page.outcome_confirmed", "en"))
    expecting()(outcome).to_contain_text(i18n.text("page.all_drives", "en", n=2))
    stage.station("pump-1", lambda drive: drive.trip(Trip.OVERHEAT))
    expecting()(outcome).not_to_contain_text(i18n.text("page.all_drives", "en", n=2))
    expecting()(outcome.locator("li")).to_have_text(re.compile("^Feed pump: "))


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_start_of_a_group_with_a_blocked_drive_is_disabled_with_its_reason(
    stage: Stage, visit: Any, language: str
) -> None:
    """Regression: the button was enabled beside "These can't be started now", and the service refused."""
    for drive in ("fan-1", "fan-2"):
        stage.call("waiver.grant", drive=drive, reason="watched bench")
    page = visit("#/fleet?group=air", language=language)
    page.click(".grouppanel summary")
    page.click(f".grouppanel .button:has-text('{i18n.text('page.lease_take_all', language, n=3)}')")
    page.fill(".grouppanel input[inputmode=decimal]", "20")
    setpoint = page.locator(f".grouppanel .button:has-text('{i18n.text('page.set_frequency', language)}')")
    expecting()(setpoint).to_be_enabled()
    start = page.locator(".grouppanel [data-step=first]")
    expecting()(start).to_be_disabled()
    why = i18n.text("page.group_start_blocked", language, n=1, of=3)
    expecting()(start).to_have_accessible_description(why)
    assert page.locator(".grouppanel .hint", has_text=why).is_visible()
    stage.call("waiver.grant", drive="fan-3", reason="watched bench")
    expecting()(start).to_be_enabled()
    expecting()(start).to_have_accessible_description("")


WATCH_SECOND_STEP = """() => {
  window.armed = 0;
  const count = () => { window.armed += document.querySelectorAll("[data-step=second]:enabled").length; };
  new MutationObserver(count).observe(document.body, { subtree: true, childList: true, attributes: true });
}"""


def test_a_start_that_is_blocked_while_its_first_step_is_answered_has_no_second_step(stage: Stage, visit: Any) -> None:
    """The second button came enabled, and could be pressed until the screen was drawn again."""
    stage.call("waiver.grant", drive="fan-1", reason="watched bench")
    page = visit("#/drive/fan-1")
    take(page)
    page.fill(".control .frequency input[inputmode=decimal]", "20")
    held: list[tuple[Any, Any]] = []
    page.route("**/arm", lambda route: held.append((route, route.fetch())))
    page.click("[data-step=first]")
    wait_until(page, lambda: bool(held), "the first step is not sent")
    stage.call("plant.stop")
    page.locator("#start-blockers").wait_for()
    page.evaluate(WATCH_SECOND_STEP)
    ((route, answer),) = held
    assert answer.status == 200
    with page.expect_response("**/arm"):
        route.fulfill(response=answer)
    page.locator("[data-step=first]:not([aria-busy])").wait_for()
    page.wait_for_timeout(300)
    assert page.evaluate("window.armed") == 0
    assert page.locator("[data-step=second], [data-step=first]:enabled").count() == 0


@pytest.mark.parametrize("language", ["en", "zh"])
def test_no_frequency_is_offered_to_a_drive_under_a_start_inhibit(stage: Stage, visit: Any, language: str) -> None:
    """The button was enabled, and the service refused the frequency."""
    page = visit("#/drive/fan-1", language=language)
    take(page)
    sent: list[str] = []
    page.on("request", lambda request: sent.append(request.url))
    entry, button = page.locator(".control .frequency input[inputmode=decimal]").first, page.locator("[data-do=set]")
    entry.fill("20")
    expecting()(button).to_be_enabled()
    stage.call("plant.stop")
    expecting()(button).to_be_disabled()
    reason = i18n.text("drives.start_inhibited", language, station=1)
    expecting()(button).to_have_accessible_description(re.compile(re.escape(reason)))
    assert page.locator("#start-blockers", has_text=reason).is_visible()
    entry.press("Enter")
    page.click("[data-do=release]")
    expecting()(button).to_be_enabled()
    assert not [url for url in sent if url.endswith("set-frequency")]


def test_a_group_gets_a_frequency_as_long_as_one_of_its_drives_takes_it(stage: Stage, visit: Any) -> None:
    page = visit("#/fleet?group=water")
    page.click(".grouppanel summary")
    page.click(f".grouppanel .button:has-text('{i18n.text('page.lease_take_all', 'en', n=2)}')")
    page.fill(".grouppanel input[inputmode=decimal]", "20")
    button = page.locator(f".grouppanel .button:has-text('{i18n.text('page.set_frequency', 'en')}')")
    expecting()(button).to_be_enabled()
    stage.call("plant.stop")
    expecting()(button).to_be_disabled()
    pump = stage.service.plant.drives["pump-1"]

    async def release() -> None:
        pump.bus.release_start([pump.config.address])

    stage.do(release)
    expecting()(button).to_be_enabled()


def test_the_page_knows_what_refuses_a_frequency_too(scripts: Any) -> None:
    keys = scripts.evaluate("import('/static/js/control/frequency.js').then((m) => m.SETPOINT_BLOCKERS)")
    everything = BusConditions(now=0.0, start_inhibited=True, foreign_master=True, duplicate_address=True)
    assert keys == [error.key for error in unmet_bus_permissives(1, everything)]


COUNT_TONES = """() => {
  window.tones = 0;
  const start = OscillatorNode.prototype.start;
  OscillatorNode.prototype.start = function (...at) { window.tones += 1; return start.apply(this, at); };
}"""


def test_an_urgent_alarm_sounds_and_is_counted_in_the_title_until_acknowledged(stage: Stage, visit: Any) -> None:
    page = visit("#/fleet", role="operator")
    page.evaluate(COUNT_TONES)
    stage.station("fan-1", lambda drive: drive.trip(Trip.OVERHEAT))
    expecting()(page).to_have_title(re.compile(r"^\(1\) "))
    page.wait_for_function("() => window.tones > 0")
    played = page.evaluate("window.tones")
    assert played % 2 == 0, "each sound has two tones"
    page.click("[data-do=acknowledge]")
    expecting()(page).to_have_title(re.compile(r"^[^(]"))
    page.click("[data-do=sound]")
    page.locator("[data-do=sound][aria-pressed=false]").wait_for()
    played = page.evaluate("window.tones")
    stage.station("fan-2", lambda drive: drive.trip(Trip.OVERHEAT))
    expecting()(page).to_have_title(re.compile(r"^\(1\) "))
    page.evaluate(DRAWN)
    assert page.evaluate("window.tones") == played


def test_a_viewer_is_offered_no_command(stage: Stage, visit: Any) -> None:
    """The server rejects commands anyway; the page does not offer them."""
    page = visit("#/drive/fan-1", role="viewer")
    page.locator(".control").wait_for()
    for offered in ("[data-do=take]", "[data-step=first]", "[data-jog]", ".stop", "[data-do=stop]"):
        assert page.locator(offered).count() == 0


def test_a_forbidden_direction_is_not_offered_and_stays_forbidden(stage: Stage, visit: Any) -> None:
    """A later change of another limit does not allow the direction again."""
    stage.call("drive.limits", drive="fan-2", **WIDEST_LIMITS | {"reverse": False})
    try:
        page = visit("#/drive/fan-2")
        only = i18n.text("page.limits_only", "en", way="forward")
        page.locator(f".row:has-text('{only}')").wait_for()
        assert page.locator(".control .choice button").count() == 1
        page.click(f"text={i18n.text('page.limits_change', 'en')}")
        page.fill(".dialog input[inputmode=decimal] >> nth=1", "40")
        page.click(".dialog button[type=submit]")
        page.locator(".dialog").wait_for(state="detached")
        view = stage.view("fan-2")
        assert (view["maximum_hz"], view["directions"]) == (40.0, ["forward"])
    finally:
        stage.call("drive.limits", drive="fan-2", **WIDEST_LIMITS)


def test_a_start_needs_two_steps_within_its_seconds(stage: Stage, visit: Any) -> None:
    """The first step alone moves nothing, and Escape cancels it."""
    stage.call("waiver.grant", drive="fan-1", reason="watched bench")
    page = visit("#/drive/fan-1")
    take(page)
    requests: list[str] = []
    page.on("request", lambda request: requests.append(request.url.rpartition("/")[2]))
    for invalid in ("46", "-1", "2,5", "1e1", "0x10", "5²", "twenty", ""):  # a browser's number field makes 2,5 25
        page.fill(".control .frequency input[inputmode=decimal]", "20")
        page.locator("[data-step=first]:enabled").wait_for()
        page.fill(".control .frequency input[inputmode=decimal]", invalid)
        page.locator("[data-step=first]:disabled").wait_for()
    page.fill(".control .frequency input[inputmode=decimal]", " ２０．５")
    page.click("[data-step=first]")
    page.locator("[data-step=second]").wait_for()
    assert "20.50 Hz" in page.locator(".confirm").inner_text()
    page.locator(".confirm:focus").wait_for()
    page.keyboard.press("Escape")
    page.focus("[data-step=first]")
    page.keyboard.down("Enter")
    page.locator("[data-step=second]").wait_for()
    for _ in range(3):  # a held key repeats: it must not take the second step
        page.keyboard.down("Enter")
    page.keyboard.up("Enter")
    page.keyboard.press("Escape")
    page.locator("[data-step=first]").wait_for()
    assert "arm" in requests and "run" not in requests
    stage.wait(lambda: stage.view("fan-1")["state"] == "stopped", "it moves, or does not answer")
