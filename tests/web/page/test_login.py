"""Login: first start, login code in the address, wrong password, and an idle session."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from drivebus import i18n
from drivebus.service.auth.rights import Role
from drivebus.service.auth.sessions import SESSION_LIFETIME_S
from drivebus.service.auth.users import UserDatabase
from fixtures.browser import Stage
from fixtures.browser_actions import expecting
from fixtures.web_app import PASSWORD, USERS


@pytest.fixture
def new_plant(stage: Stage) -> Iterator[Stage]:
    """Return a plant without users."""
    stage.access.user_file.change(lambda _: UserDatabase())
    yield stage
    stage.access.user_file.change(lambda _: USERS)


def test_the_first_start_accepts_the_printed_secret_and_adds_the_administrator(new_plant: Stage, visit: Any) -> None:
    """There is no default password."""
    page = visit("#/fleet", role=None)
    page.fill("input[name=secret]", new_plant.access.setup_secret.issue())
    page.fill("input[name=name]", "ada")
    page.fill("input[name=password]", "a quite long sentence")
    page.click("button[type=submit]")
    page.locator(".connection.live").wait_for()
    assert page.locator(".user").inner_text() == "ada"
    assert [user.name for user in new_plant.access.database.users] == ["ada"]


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_plant_whose_users_are_missing_shows_what_to_do_and_no_form(
    new_plant: Stage, visit: Any, language: str
) -> None:
    file = new_plant.access.user_file
    new_plant.access.session_store.write(())
    file.path.unlink()
    file.__init__(file.path)  # type: ignore[misc]  # as in a new process
    page = visit("#/fleet", role=None, language=language)
    note = page.locator("[data-text=users-missing]")
    note.wait_for()
    assert note.inner_text() == i18n.text("auth.users_missing", language, file="users.json")
    assert page.locator("form").count() == 0


def test_a_login_code_in_the_address_works_once(stage: Stage, visit: Any) -> None:
    """The code is removed from the address bar at once and is rejected a second time."""
    code = stage.do(lambda: stage.access.issue_code("operator", 60.0))
    page = visit(f"#login={code}", role=None)
    page.locator(".connection.live").wait_for()
    assert code not in page.url and page.locator(".user").inner_text() == "operator"
    again = visit(f"#login={code}", role=None)
    again.locator("input[name=password]").wait_for()
    again.locator(f".notice.bad:has-text('{i18n.text('auth.wrong_code', 'en')}')").wait_for()
    assert code not in again.url


def test_a_login_code_pasted_into_the_open_page_logs_in(stage: Stage, visit: Any) -> None:
    """Only the hash of the address changes, so the browser does not load the page again."""
    page = visit("#/fleet", role=None)
    page.locator("input[name=password]").wait_for()
    code = stage.do(lambda: stage.access.issue_code("operator", 60.0))
    page.evaluate("code => { location.hash = `#login=${code}`; }", code)
    page.locator(".connection.live").wait_for()
    assert code not in page.url and page.locator(".user").inner_text() == "operator"


def test_the_end_of_a_session_leaves_no_value_of_a_drive_on_the_page_or_in_its_memory(visit: Any) -> None:
    page = visit("#/fleet")
    count = "import('/static/js/store.js').then((m) => m.idsOf('drives').value.length)"
    drawn = "new Promise((done) => requestAnimationFrame(() => setTimeout(done)))"
    page.locator(".tile").first.wait_for()
    assert page.evaluate(count) > 0
    page.get_by_role("button", name=i18n.text("page.log_out", "en")).click()
    page.locator("input[name=password]").wait_for()
    assert page.evaluate(f"{drawn}.then(() => {count})") == 0
    assert "Hz" not in page.locator("body").inner_text()


def test_a_wrong_password_shows_an_error_and_no_data_and_is_counted_at_the_next_login(stage: Stage, visit: Any) -> None:
    page = visit("#/fleet", role=None)
    page.fill("input[name=name]", "operator")
    page.fill("input[name=password]", PASSWORD + "?")
    page.click("button[type=submit]")
    page.locator(f".notice.bad:has-text('{i18n.text('auth.wrong_password', 'en')}')").wait_for()
    assert page.locator(".tile, .stopbar").count() == 0
    page.fill("input[name=password]", PASSWORD)
    page.click("button[type=submit]")
    notice = page.locator("[data-text=failed-logins]")
    notice.get_by_text(i18n.text("page.failed_logins", "en", n=1)).wait_for()
    notice.get_by_role("button").click()
    notice.wait_for(state="detached")


def test_an_idle_session_can_only_stop_until_the_password_is_entered(stage: Stage, visit: Any) -> None:
    """An idle session loses its rights to control, but never the right to stop."""
    page = visit("#/drive/fan-1", role="operator")
    page.locator("[data-do=take]:enabled").wait_for()
    for session in stage.access.sessions.of_user("operator"):
        session.active -= 3600.0
    page.evaluate("import('/static/js/session.js').then((m) => m.loadSession())")
    page.locator("form[data-do=unlock]").wait_for()
    assert page.locator("[data-do=take]:enabled").count() == 0
    page.click("[data-stop=drive]")
    page.locator(".stop-status.good").wait_for()
    page.fill("form[data-do=unlock] input[type=password]", PASSWORD)
    page.click("form[data-do=unlock] button[type=submit]")
    page.locator("[data-do=take]:enabled").wait_for()


def test_a_name_can_be_typed_at_once_on_the_login_page(visit: Any) -> None:
    page = visit("#/fleet", role=None)
    page.locator("input[name=name]:focus").wait_for()
    page.keyboard.type("operator")
    page.keyboard.press("Tab")
    page.keyboard.type(PASSWORD)
    page.keyboard.press("Enter")
    page.locator(".tile").first.wait_for()


def test_the_login_page_has_no_switch_of_the_alarm_sound(visit: Any) -> None:
    """There is no alarm to hear before a login."""
    page = visit("#/fleet", role=None)
    page.locator("input[name=password]").wait_for()
    assert page.locator(".prefs .button").count() == 2
    assert page.locator("[data-do=sound]").count() == 0


@pytest.mark.parametrize("size", [(1440, 900), (390, 844)])
@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_password_that_is_chosen_can_be_read_and_is_hidden_at_first(
    new_plant: Stage, visit: Any, language: str, size: tuple[int, int]
) -> None:
    """The first administrator types it once: a mistyped one that nobody saw locks the plant."""
    page = visit("#/fleet", role=None, language=language, size=size)
    page.get_by_label(i18n.text("page.login_password", language), exact=True).fill("a quite long sentence")
    field, eye = (
        page.locator("input[name=password]"),
        page.get_by_role("button", name=i18n.text("page.show_password", language)),
    )
    assert (field.get_attribute("type"), eye.get_attribute("aria-pressed")) == ("password", "false")
    eye.click()
    assert (field.get_attribute("type"), eye.get_attribute("aria-pressed")) == ("text", "true")
    assert field.input_value() == "a quite long sentence"
    box, beside = field.bounding_box(), eye.bounding_box()
    assert beside["x"] >= box["x"] + box["width"] and beside["x"] + beside["width"] <= size[0] - 10
    eye.click()
    assert field.get_attribute("type") == "password"


def test_no_name_password_or_secret_is_given_to_the_spelling_check_of_the_browser(new_plant: Stage, visit: Any) -> None:
    """Some browsers send what they check to a server of their maker, also a password while it is shown."""
    page = visit("#/fleet", role=None)
    page.get_by_role("button", name=i18n.text("page.show_password", "en")).click()
    fields = page.locator("form input")
    assert fields.count() == 3
    assert fields.evaluate_all("all => all.filter((field) => field.spellcheck).map((field) => field.name)") == []


def test_language_and_theme_are_the_same_in_each_tab_of_a_browser(visit: Any) -> None:
    """Regression: a second tab kept its language until its reload, and two screens of one desk differed."""
    first = visit("#/fleet", role=None)
    second = first.context.new_page()
    second.goto(first.url)
    for tab in (first, second):
        tab.locator(".prefs .button").nth(1).wait_for()
    first.locator(".prefs .button").nth(0).click()
    first.locator(".prefs .button").nth(1).click()
    second.wait_for_function("document.documentElement.lang === 'zh-CN'")
    second.locator(".prefs .button", has_text=i18n.text("page.theme_light", "zh")).wait_for()


def test_the_language_chosen_last_is_shown_and_stored_although_its_texts_came_first(scripts: Any) -> None:
    found = scripts.evaluate("""async () => {
      const load = (name) => import(`/static/js/${name}.js`);
      const [i18n, { loadPreference }] = await Promise.all(["i18n", "preferences"].map(load));
      const real = window.fetch;
      const late = { en: 60, zh: 0 };
      window.fetch = async (url) => {
        await new Promise((resolve) => { setTimeout(resolve, late[/(\\w+)\\.json/.exec(url)[1]]); });
        return real(url);
      };
      await Promise.all([i18n.chooseLanguage("en"), i18n.chooseLanguage("zh")]);
      window.fetch = real;
      return [i18n.language.value, loadPreference("language"), document.documentElement.lang];
    }""")
    assert found == ["zh", "zh", "zh-CN"]


ENDINGS = {
    "logout": lambda stage: stage.access.end_sessions("operator", "logout"),
    "ended": lambda stage: stage.access.end_sessions("operator", "ended"),
    "expired": lambda stage: expire(stage),
    "disabled": lambda stage: change(stage, disabled=True),
    "role": lambda stage: change(stage, role=Role.VIEWER),
    "password": lambda stage: change(stage, password=None),
    "removed": lambda stage: stage.access.change_database(lambda database: database.without_user("operator")),
}


async def expire(stage: Stage) -> None:
    for session in stage.access.sessions.of_user("operator"):
        session.opened -= SESSION_LIFETIME_S


async def change(stage: Stage, **fields: Any) -> None:
    await stage.access.change_database(
        lambda database: database.with_changed_user(replace(database.user("operator"), **fields))
    )


@pytest.mark.parametrize(("reason", "language"), list(zip(ENDINGS, itertools.cycle(["en", "zh"]), strict=False)))
def test_the_login_page_says_why_the_session_has_ended(stage: Stage, visit: Any, reason: str, language: str) -> None:
    """A reload of the page shows it again, and so does a page that was asleep and got no message."""
    expect = expecting()
    page = visit("#/fleet", role="operator", language=language)
    asleep = visit("#/fleet", role="operator", language=language)
    asleep.route_web_socket("**/api/v1/live*", lambda socket: None)
    asleep.reload()
    asleep.locator(".stopbar").wait_for()
    try:
        stage.do(lambda: ENDINGS[reason](stage))
        end = [i18n.text(f"auth.closed.{reason}", language), i18n.text("page.session_ended_stops", language)]
        expected = i18n.text("language.between_sentences", language).join(end)
        expect(page.locator("[data-text=session-ended]")).to_have_text(expected)
        page.reload()
        expect(page.locator("[data-text=session-ended]")).to_have_text(expected)
        asleep.click("[data-stop=all]")
        expect(asleep.locator("[data-text=session-ended]")).to_have_text(expected)
    finally:
        stage.access.user_file.change(lambda _: USERS)


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_stop_that_the_end_of_the_session_has_refused_is_named_on_the_login_page(
    stage: Stage, visit: Any, language: str
) -> None:
    """Regression: pressed while the server was away, it was not sent, and the login page had no word of it."""
    page = visit("#/drive/fan-1", role="operator", language=language)
    page.locator("[data-stop=drive]").wait_for()
    stage.lose_server()
    page.locator(".connection.lost").wait_for()
    page.click("[data-stop=drive]")
    page.locator(".stop-status.waiting").wait_for()
    stage.do(lambda: stage.access.end_sessions("operator", "ended"))
    stage.regain_server()
    name = {"en": "Supply fan", "zh": "送风机"}[language]
    failed = i18n.text("page.stop_failed", language, what=name, why="").strip()
    expecting()(page.locator(".loginpage .stop-status.bad")).to_contain_text(failed)
    page.locator(".loginpage [data-do=dismiss-stop]").click()
    expecting()(page.locator(".loginpage .stop-status")).to_have_count(0)


def test_a_log_out_in_another_tab_is_named_and_one_on_this_page_is_not(visit: Any) -> None:
    """The log-out removes the cookie of both tabs: only the message of the connection says it to the other one."""
    expect = expecting()
    page = visit("#/fleet", role="operator")
    other = page.context.new_page()
    other.goto(page.url)
    other.locator(".connection.live").wait_for()
    page.get_by_role("button", name=i18n.text("page.log_out", "en")).click()
    expect(other.locator("[data-text=session-ended]")).to_contain_text(i18n.text("auth.closed.logout", "en"))
    page.locator("input[name=password]").wait_for()
    assert page.locator("[data-text=session-ended]").count() == 0


def test_every_page_has_a_button_to_log_out(visit: Any) -> None:
    expect = expecting()
    page = visit("#/fleet", role="administrator")
    links = page.locator("header a[href^='#/'], nav a[href^='#/']")
    links.first.wait_for()
    addresses = {link.get_attribute("href") for link in links.all()} | {"#/drive/fan-1", "#/nothing"}
    assert {"#/fleet", "#/alarms", "#/settings"} <= addresses
    for address in sorted(addresses):
        page.evaluate("(address) => { location.hash = address; }", address)
        page.locator("main h1").first.wait_for()
        expect(page.get_by_role("button", name=i18n.text("page.log_out", "en"))).to_be_visible()
