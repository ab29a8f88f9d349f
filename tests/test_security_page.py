"""Data of the security page: complete, in both languages, and each named test exists."""

from __future__ import annotations

import csv
import re
from collections import Counter
from pathlib import Path

import pytest

from drivebus.service.auth.devices import DEVICE_KEY_FILE
from drivebus.service.auth.rights import Right, Role
from drivebus.service.auth.service import AuthService
from drivebus.service.auth.sessions import SessionStore, secret_digest
from drivebus.service.auth.setup_secret import SETUP_SECRET_FILE
from drivebus.service.auth.users import Token, User, UserDatabase
from drivebus.service.config.model import USER_FILE
from fixtures.web_app import FAST_HASHER

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "security"
LEVELS = {"asvs": {"1": 70, "2": 183}, "iec62443": {"1": 34, "2": 19}}
"""Requirements of each level: ASVS 5.0.0, and IEC 62443-4-2 for a software application."""
CHINESE = re.compile(r"[\u3000-\u9fff\uff00-\uffef]")
PAGES = [ROOT / "docs" / "explanation" / name for name in ("security.md", "security.zh.md")]
MAX_NAME_LENGTH = 24  # argon2id, no-store, 4xx: names that are the same in both languages


def rows(name: str) -> list[dict[str, str]]:
    with (FOLDER / f"{name}.tsv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE))


@pytest.mark.parametrize("name", ["asvs", "iec62443", "attacks"])
def test_each_named_test_exists(name: str) -> None:
    for row in rows(name):
        path, _, test = row["evidence"].partition("::")
        if path:
            text = (ROOT / path).read_text(encoding="utf-8")
            assert not test or re.search(rf"^(async )?def {test}\(", text, re.MULTILINE), row


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_each_link_of_the_page_to_a_test_has_the_name_of_a_test_in_that_file(page: Path) -> None:
    """Four promises named tests that had other names, which no search could find."""
    links = re.findall(r"\[([^\]]+)\]\(\.\./\.\./(tests/[^)#]+\.py)\)", page.read_text(encoding="utf-8"))
    assert len(links) > 100
    unknown = [
        (text, path)
        for text, path in links
        if text != Path(path).name
        and f"def test_{text.replace(' ', '_')}(" not in (ROOT / path).read_text(encoding="utf-8")
    ]
    assert unknown == []


@pytest.mark.parametrize("name", LEVELS)
def test_every_requirement_is_listed_once_with_its_state(name: str) -> None:
    found = rows(name)
    assert Counter(row["level"] for row in found) == LEVELS[name]
    assert len({row["number"] for row in found}) == len(found)
    assert {row["state"] for row in found} == {"met", "na", "missing"}
    assert [row["number"] for row in found if (row["state"] == "met") is not bool(row["evidence"])] == []
    assert [row["number"] for row in found if row["state"] != "met" and not row["reason_en"]] == []


@pytest.mark.parametrize("name", ["asvs", "iec62443", "attacks"])
def test_every_text_is_in_both_languages(name: str) -> None:
    for row in rows(name):
        for column in (key.removesuffix("_en") for key in row if key.endswith("_en")):
            en, zh = row[f"{column}_en"], row[f"{column}_zh"]
            assert bool(en) is bool(zh), row
            assert not CHINESE.search(en), row
            assert CHINESE.search(zh) or (en == zh and len(zh) <= MAX_NAME_LENGTH), row


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_key_of_the_state_directory_is_on_the_page(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for file in (USER_FILE, SessionStore(ROOT).path.name, DEVICE_KEY_FILE, SETUP_SECRET_FILE, "NAME.audit.key"):
        assert f"`{file}`" in text


def page_scripts() -> dict[str, str]:
    folder = ROOT / "src" / "drivebus" / "web" / "static" / "js"
    found = {file.name: file.read_text(encoding="utf-8") for file in folder.rglob("*.js")}
    assert len(found) > 90
    return found


def test_the_page_stores_preferences_in_the_browser_and_nothing_else() -> None:
    scripts = page_scripts()
    storage = re.compile(r"localStorage|sessionStorage|indexedDB|document\.cookie|\bcaches\.")
    assert [name for name, text in scripts.items() if storage.search(text)] == ["preferences.js"]
    names = {name for text in scripts.values() for name in re.findall(r'\bsavePreference\((\w+|"\w+")', text)}
    assert {name.strip('"') for name in names} == {
        "name",  # the definition
        "language", "theme", "fleet", "history", "sound", "gesture_help", "takeovers",
    }  # fmt: skip


def test_passwords_can_be_pasted_and_filled_in_by_a_password_manager() -> None:
    scripts = page_scripts()
    inputs = [tag for text in scripts.values() for tag in re.findall(r"<\$\{PasswordField\}.*? />", text, re.DOTALL)]
    assert len(inputs) >= 6
    assert [name for name, text in scripts.items() if 'type="password"' in text] == []
    assert [tag for tag in inputs if not re.search(r"autocomplete=(\$\{|\"(current|new)-password)", tag)] == []
    assert [name for name, text in scripts.items() if re.search("onpaste|[\"']paste[\"']", text, re.IGNORECASE)] == []


def test_a_token_outlives_a_new_password_and_rests_while_its_user_is_disabled(tmp_path: Path) -> None:
    """It belongs to a program; the page says so, and how to withdraw it."""
    auth = AuthService(tmp_path)
    user = User("report", Role.VIEWER, FAST_HASHER.hash("first"), 0)
    token = Token(
        id="t",
        name="t",
        user="report",
        rights=(Right.VIEW,),
        digest=secret_digest("dbt_secret"),
        created_ms=0,
        expires_ms=auth.wall_ms() + 60_000,
    )
    auth.user_file.change(lambda _: UserDatabase().with_user(user).with_token(token))
    for password, disabled, valid in (("second", False, True), ("second", True, False), ("second", False, True)):
        changed = User("report", Role.VIEWER, FAST_HASHER.hash(password), 0, disabled)
        auth.user_file.change(lambda database, changed=changed: database.with_changed_user(changed))  # type: ignore[misc]
        found = auth.token_credential("dbt_secret", "10.0.0.9")
        assert (found is not None and Right.VIEW in found.actor.rights) is valid
