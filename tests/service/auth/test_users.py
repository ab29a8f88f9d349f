"""User database: users, tokens, codes, and their file."""

from __future__ import annotations

import json
import os
import stat
import threading
import unicodedata
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from drivebus import i18n
from drivebus.errors import ConfigurationError
from drivebus.service.auth import users as users_module
from drivebus.service.auth.errors import (
    Conflict,
    InvalidInput,
    ResourceNotFound,
)
from drivebus.service.auth.names import _look_alikes, appearance, check_user_name, normalized_name
from drivebus.service.auth.rights import Right, Role
from drivebus.service.auth.users import OneTimeCode, Token, User, UserDatabase, UserFile

ADMIN = User("ann", Role.ADMINISTRATOR, "$hash", 1)
TOKEN = Token(id="t1", name="scada", user="ann", rights=(Right.VIEW,), digest="d" * 64, created_ms=1, expires_ms=2)


def test_the_last_administrator_cannot_be_removed_demoted_or_disabled() -> None:
    database = UserDatabase().with_user(ADMIN)
    for change in (
        lambda: database.without_user("ann"),
        lambda: database.with_changed_user(replace(ADMIN, role=Role.ENGINEER)),
        lambda: database.with_changed_user(replace(ADMIN, disabled=True)),
        lambda: database.with_changed_user(replace(ADMIN, password=None)),
    ):
        with pytest.raises(Conflict) as rejected:
            change()
        assert rejected.value.key == "auth.last_administrator"
    two = database.with_user(replace(ADMIN, name="bob"))
    assert two.without_user("ann").has_administrator


def test_without_an_administrator_other_users_may_be_changed() -> None:
    """As in a file that was written by hand."""
    vera = User("vera", Role.VIEWER, "$", 1)
    database = UserDatabase((vera,)).with_changed_user(replace(vera, role=Role.OPERATOR))
    assert database.user("vera").role is Role.OPERATOR and database.without_user("vera").users == ()
    with pytest.raises(ResourceNotFound) as rejected:
        database.with_changed_user(replace(vera, name="unknown"))
    assert rejected.value.key == "auth.no_such_user"


RIGHTS_BY_ROLE = {
    Role.VIEWER: {"view"},
    Role.OPERATOR: {"view", "stop", "operate"},
    Role.ENGINEER: {"view", "stop", "operate", "write_parameters", "save", "limit", "configure", "audit"},
    Role.ADMINISTRATOR: {
        "view",
        "stop",
        "operate",
        "write_parameters",
        "save",
        "limit",
        "configure",
        "audit",
        "administer",
    },
}


@pytest.mark.parametrize("role", list(Role))
def test_each_role_has_exactly_its_rights(role: Role) -> None:
    """Tokens and files contain these identifiers, so they must not change."""
    user = User("ann", role, "$", 1)
    assert {str(right) for right in user.rights} == RIGHTS_BY_ROLE[role]
    assert replace(user, disabled=True).rights == frozenset()
    assert [str(known) for known in Role] == ["viewer", "operator", "engineer", "administrator"]
    assert UserDatabase((user,)).rights_of("ANN") == user.rights and UserDatabase().rights_of("ann") == frozenset()


def test_a_right_is_shown_by_its_name_and_its_identifier() -> None:
    assert (Right.STOP.in_language("en"), Right.STOP.in_language("zh")) == ("stop", "停机（stop）")
    assert [key for right in Right if not i18n.known(key := f"page.right_{right}")] == []


def test_names_that_look_alike_belong_to_one_user() -> None:
    database = UserDatabase().with_user(ADMIN)
    assert database.find("ANN") == database.find("ａｎｎ") == ADMIN
    with pytest.raises(Conflict) as rejected:
        database.with_user(replace(ADMIN, role=Role.VIEWER))
    assert rejected.value.key == "auth.name_taken"


@pytest.mark.parametrize("name", ["", "a b", "a\nb", "a\x1b[31m", "_a", ".a", "x" * 65, "Ann", "a\u202eb", "a/b", '"'])
def test_an_invalid_name_is_rejected(name: str) -> None:
    with pytest.raises(InvalidInput) as rejected:
        UserDatabase().with_user(User(name, Role.VIEWER, None, 1))
    assert rejected.value.key == "auth.bad_name"


@pytest.mark.parametrize(
    "name",
    [
        "สมหญิง",
        "ไพฑูรย์",
        "น้ำ",
        "हिन्दी",
        "फ़ैज़",
        "தமிழ்",
        "বাংলা",
        "ဦးကျော်",
        "ភាសា",
        "සිංහල",
        "བོད",
        "adébáyọ̀",
        "m\u0304.2@x",
        "دَوِد",
    ],
)
def test_a_name_whose_letters_have_marks_is_accepted(name: str) -> None:
    """Vowel signs and tone marks of Thai, Hindi and others are no letters in Unicode: their names were refused."""
    stored = normalized_name(name)  # as ``AuthService`` stores it
    found = UserDatabase().with_user(User(stored, Role.VIEWER, None, 1)).find(name)
    assert found is not None and found.name == stored


@pytest.mark.parametrize("name", ["น้ำ", "ດຳ"])
def test_the_vowel_am_of_thai_and_lao_is_stored_as_it_is_written(name: str) -> None:
    """Its compatibility form has two characters, which are drawn in another place where a tone mark precedes them."""
    assert normalized_name(name) == name == normalized_name(unicodedata.normalize("NFKC", name))


@pytest.mark.parametrize(
    "name",
    [
        "ि",
        "7ि",
        "a-ิ",
        "aि",
        "a\u0338",
        "a\u0335",
        "i\u0307",
        "a\u034f",
        "a\u20dd",
        "ह\ufe0f",
        "ក\u17b4",
        "ann\u1160",
        "김\u3164",
        "ก\u0e34\u0e34\u0e34\u0e34\u0e34\u0e34",
        "กิ" * 33,
        "हि\u200dन्दी",
        "王\u0301",
    ],
    ids=ascii,
)
def test_a_mark_without_its_letter_and_one_that_hides_or_covers_letters_is_rejected(name: str) -> None:
    with pytest.raises(InvalidInput) as rejected:
        UserDatabase().with_user(User(normalized_name(name), Role.VIEWER, None, 1))
    assert rejected.value.key == "auth.bad_name"


@pytest.mark.parametrize("name", ["กิิ", "שָָרה", "q̣̣", "ạ̣", "क्क््"])
def test_a_letter_with_the_same_mark_twice_is_rejected(name: str) -> None:
    """Both marks are drawn in one place: the name looked like that of another user."""
    with pytest.raises(InvalidInput) as rejected:
        check_user_name(normalized_name(name))
    assert rejected.value.key == "auth.bad_name"
    assert "64 characters, marks included" in str(rejected.value)


@pytest.mark.parametrize(("name", "alike"), [("น้ำ", "นํ้า"), ("ນ້ຳ", "ນໍ້າ"), ("กิ้", "ก้ิ")])
def test_the_order_in_which_the_marks_of_a_letter_are_written_makes_no_other_name(name: str, alike: str) -> None:
    """Two users had names that are drawn in the same way."""
    for first, second in ((name, alike), (alike, name)):
        database = UserDatabase().with_user(User(normalized_name(first), Role.VIEWER, None, 1))
        with pytest.raises(Conflict) as rejected:
            database.with_user(User(normalized_name(second), Role.VIEWER, None, 1))
        assert rejected.value.key == "auth.name_taken"


@pytest.mark.parametrize(("name", "alike"), [("आशा", "अाशा"), ("ओम", "अाेम"), ("আলি", "অালি"), ("ঔৡ", "ঔৠ"), ("ဩ", "သြ")])
def test_a_name_that_another_sequence_of_letters_and_marks_looks_like_is_taken(name: str, alike: str) -> None:
    database = UserDatabase().with_user(User(name, Role.VIEWER, None, 1))
    with pytest.raises(Conflict):
        database.with_user(User(alike, Role.VIEWER, None, 1))


@pytest.mark.parametrize("name", ["ann", "王伟", "li.wei-2@plant", "7"])
def test_a_name_in_any_script_is_accepted(name: str) -> None:
    user = User(name, Role.VIEWER, None, 1)
    assert UserDatabase().with_user(user).find(name) == user


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("аdam0", "auth.mixed_scripts"),
        ("pαul", "auth.mixed_scripts"),
        ("王аnn", "auth.mixed_scripts"),
        ("हำ", "auth.mixed_scripts"),
        ("drivebus", "auth.reserved_name"),
        ("stop-all", "auth.reserved_name"),
    ],
)
def test_a_name_that_passes_for_another_is_rejected(name: str, key: str) -> None:
    with pytest.raises(InvalidInput) as rejected:
        UserDatabase().with_user(User(name, Role.VIEWER, None, 1))
    assert rejected.value.key == key


@pytest.mark.parametrize(
    "name", ["михаил", "νίκο", "王wei", "さとうケン", "김ann", "müller", "佐々木", "サーバー", "aひカ漢한ㄅ々ー"]
)
def test_a_name_of_one_script_or_an_east_asian_one_with_latin_letters_is_accepted(name: str) -> None:
    assert UserDatabase().with_user(User(name, Role.VIEWER, None, 1)).find(name) is not None


@pytest.mark.parametrize(
    ("name", "alike"),
    [
        ("сара", "capa"),
        ("հօո", "hon"),
        ("ᏚᎪᎡᎪ".casefold(), "sara"),
        ("οκ", "ок"),
        ("๐", "०"),
        ("раӏ", "pal"),
        ("ᴋarl", "karl"),
        ("δ", "ⵠ"),
    ],
    ids=[
        "Cyrillic",
        "Armenian",
        "Cherokee",
        "Greek and Cyrillic",
        "Thai and Devanagari digits",
        "palochka",
        "small capital",
        "through a third letter",
    ],
)
def test_a_name_in_another_script_that_looks_like_an_existing_one_is_taken(name: str, alike: str) -> None:
    for first, second in ((name, alike), (alike, name)):
        database = UserDatabase().with_user(User("anna", Role.VIEWER, None, 1))
        database = database.with_user(User(first, Role.VIEWER, None, 1))
        with pytest.raises(Conflict) as rejected:
            database.with_user(User(second, Role.VIEWER, None, 1))
        assert rejected.value.key == "auth.name_taken"


def test_no_letter_is_replaced_by_one_that_is_replaced_itself() -> None:
    """Regression: two letters that look like a third one were told apart where the third one looks like a fourth."""
    letters = "".join(map(chr, _look_alikes()))
    assert appearance(appearance(letters)) == appearance(letters)


def test_names_that_only_resemble_each_other_in_one_script_are_both_accepted() -> None:
    database = UserDatabase()
    for name in ("user1", "userl", "rn", "m", "王伟", "玉伟", "สมชาย"):
        database = database.with_user(User(name, Role.VIEWER, None, 1))
    assert len(database.users) == 7


@pytest.mark.parametrize("label", ["a\x1b[31m", "a\nb", "a\u202eb", "a\u200fb", "a\u200bb", " ", "\u3164"])
def test_the_name_of_a_token_is_visible_text_without_control_characters(label: str) -> None:
    with pytest.raises(InvalidInput) as rejected:
        UserDatabase().with_user(ADMIN).with_token(replace(TOKEN, name=label))
    assert rejected.value.key == "auth.bad_label"


def test_a_token_that_may_start_a_drive_may_stop_it() -> None:
    """Without the right to stop, it could not even renew its control of the motor that it had started."""
    database = UserDatabase().with_user(ADMIN)
    with pytest.raises(InvalidInput) as rejected:
        database.with_token(replace(TOKEN, rights=(Right.VIEW, Right.OPERATE)))
    assert rejected.value.key == "auth.operate_without_stop"
    database.with_token(replace(TOKEN, rights=(Right.STOP, Right.OPERATE)))


def test_a_stored_token_that_may_start_a_drive_may_stop_it(tmp_path: Path) -> None:
    """A version before could give ``operate`` alone."""
    path = tmp_path / "users.json"
    tokens = (TOKEN, replace(TOKEN, id="t2", rights=(Right.OPERATE, Right.STOP, Right.VIEW)))
    UserFile(path).change(lambda database: replace(database.with_user(ADMIN), tokens=tokens))
    stored = json.loads(path.read_text())
    stored["tokens"][1]["rights"].remove("stop")
    path.write_text(json.dumps(stored))
    assert UserFile(path).read().tokens == tokens


def test_a_token_cannot_have_more_rights_than_its_user() -> None:
    database = UserDatabase().with_user(ADMIN).with_user(User("vera", Role.VIEWER, "$", 1))
    with pytest.raises(InvalidInput) as rejected:
        database.with_token(replace(TOKEN, user="vera", rights=(Right.VIEW, Right.STOP, Right.OPERATE)))
    assert (rejected.value.key, rejected.value.params) == ("auth.beyond_role", {"rights": ("operate", "stop")})
    with pytest.raises(InvalidInput):
        database.with_token(replace(TOKEN, rights=()))
    with pytest.raises(ResourceNotFound):
        database.with_token(replace(TOKEN, user="unknown"))


def test_a_user_has_a_limited_number_of_tokens_and_expired_ones_make_room() -> None:
    """A thousand tokens of one viewer slowed the requests with tokens of all users down to a third."""
    database = UserDatabase().with_user(User("li", Role.VIEWER, "x", 0)).with_user(User("wu", Role.VIEWER, "x", 0))

    def token(number: int, user: str = "li", created_ms: int = 0) -> Token:
        return Token(
            id=f"{user}-{number}",
            name="t",
            user=user,
            rights=(Right.VIEW,),
            digest=str(number),
            created_ms=created_ms,
            expires_ms=created_ms + 1000 + number,
        )

    for number in range(100):
        database = database.with_token(token(number))
    with pytest.raises(Conflict) as rejected:
        database.with_token(token(100, created_ms=999))
    assert rejected.value.key == "auth.too_many_tokens"
    assert len(database.with_token(token(1, "wu")).tokens) == 101
    later = database.with_token(token(1, "wu")).with_token(token(100, created_ms=1049))
    assert [kept.id for kept in later.tokens] == [*(f"li-{n}" for n in range(50, 100)), "wu-1", "li-100"]


def test_a_removed_user_loses_tokens_and_codes() -> None:
    database = UserDatabase().with_user(ADMIN).with_user(User("vera", Role.VIEWER, "$", 1))
    database = database.with_token(replace(TOKEN, user="vera")).with_code(OneTimeCode("c", "vera", 9), 0)
    after = database.with_token(TOKEN).without_user("vera")
    assert (after.users, after.tokens, after.codes) == ((ADMIN,), (TOKEN,), ())
    with pytest.raises(ResourceNotFound) as rejected:
        after.without_token("t2")
    assert rejected.value.key == "auth.no_such_token"
    assert after.without_token("t1").tokens == ()


def test_a_removed_token_or_code_leaves_the_others() -> None:
    other, codes = replace(TOKEN, id="t2"), (OneTimeCode("c1", "ann", 9), OneTimeCode("c2", "ann", 9))
    database = replace(UserDatabase().with_user(ADMIN).with_token(TOKEN).with_token(other), codes=codes)
    assert database.without_token("t1").tokens == (other,)
    assert database.without_code("c1").codes == codes[1:]
    with pytest.raises(ResourceNotFound):
        database.with_code(OneTimeCode("c3", "unknown", 9), 0)


def test_a_new_code_removes_expired_ones() -> None:
    database = (
        UserDatabase()
        .with_user(ADMIN)
        .with_code(OneTimeCode("old", "ann", 5), 0)
        .with_code(OneTimeCode("new", "ann", 50), 5)
    )
    assert [code.digest for code in database.codes] == ["new"]


def test_the_file_is_private_and_holds_the_database(tmp_path: Path) -> None:
    path = tmp_path / "state" / "users.json"
    UserFile(path).change(lambda database: database.with_user(ADMIN).with_token(TOKEN))
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.with_suffix(".lock").stat().st_mode) == 0o600
    assert UserFile(path).read() == UserDatabase((ADMIN,), (TOKEN,))
    assert json.loads(path.read_text())["users"][0]["role"] == "administrator"


def test_a_rejected_change_writes_nothing(tmp_path: Path) -> None:
    file = UserFile(tmp_path / "users.json")
    file.change(lambda database: database.with_user(ADMIN))
    before = file.path.read_bytes()
    with pytest.raises(Conflict):
        file.change(lambda database: database.without_user("ann"))
    assert file.path.read_bytes() == before


def test_a_change_by_another_program_is_read_at_the_next_access(tmp_path: Path) -> None:
    file, other = UserFile(tmp_path / "users.json"), UserFile(tmp_path / "users.json")
    file.change(lambda database: database.with_user(ADMIN))
    assert other.read().users == (ADMIN,)
    assert other.read() is other.read(), "read once while it does not change"
    file.change(lambda database: database.with_token(TOKEN))
    assert other.read().tokens == (TOKEN,)


@pytest.mark.parametrize("content", ["", "{", "[]", '{"users": [{"name": 1}]}', '{"users": [{"name": "a"}]}'])
def test_a_file_with_other_content_is_rejected_and_never_overwritten(tmp_path: Path, content: str) -> None:
    path = tmp_path / "users.json"
    path.write_text(content)
    with pytest.raises(ConfigurationError) as raised:
        UserFile(path).read()
    assert raised.value.params["file"] == str(path) and raised.value.params["problem"]
    assert raised.value.key == "auth.store_unusable"
    with pytest.raises(ConfigurationError):
        UserFile(path).change(lambda database: database.with_user(ADMIN))
    assert path.read_text() == content


def test_the_error_of_a_damaged_user_file_names_the_place_and_no_hash(tmp_path: Path) -> None:
    """It is printed and logged: it quoted a part of the file, in English and over several lines."""
    path = tmp_path / "users.json"
    UserFile(path).change(lambda database: database.with_user(replace(ADMIN, password="$argon2id$v=19$m=8")))
    whole = path.read_text()
    entry = {"en": "users.0.password is missing or has a wrong value", "zh": "users.0.password 缺失或值不正确"}
    content = {"en": "its content is not the expected JSON", "zh": "其内容不是所要求的 JSON"}
    for damaged, problem in ((whole.replace('"$', '["$').replace('8"', '8"]'), entry), (whole[:-9], content)):
        path.write_text(damaged)
        with pytest.raises(ConfigurationError) as raised:
            UserFile(path).read()
        for language, expected in problem.items():
            text = raised.value.text(language)
            assert expected in text and "argon2" not in text and "\n" not in text and "http" not in text


def test_a_broken_edit_of_the_user_file_prevents_no_stop_and_is_not_overwritten(tmp_path: Path) -> None:
    file = UserFile(tmp_path / "users.json")
    file.change(lambda database: database.with_user(ADMIN))
    file.read()
    file.path.write_text("{ oops")
    assert file.read().users == (ADMIN,)
    with pytest.raises(ConfigurationError):
        file.change(lambda database: database.with_token(TOKEN))
    assert file.path.read_text() == "{ oops"
    repaired = UserFile(tmp_path / "other.json").change(lambda database: database.with_user(replace(ADMIN, name="bob")))
    (tmp_path / "other.json").replace(file.path)
    assert file.read() == repaired


def test_a_user_file_that_is_damaged_while_the_service_runs_is_logged_once_for_each_damage(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The users of before stayed in force without a word."""
    file = UserFile(tmp_path / "users.json")
    file.change(lambda database: database.with_user(ADMIN))
    file.read()
    whole = file.path.read_text()
    for text in ("{ oops", whole, "{ oops"):
        file.path.write_text(text)
        for _ in range(3):
            assert file.read().users == (ADMIN,)
    found = [record.message for record in caplog.records if "stay in force" in record.message]
    assert len(found) == 2 and "users.json" in found[0]


def test_a_fifo_in_the_place_of_the_user_file_never_blocks_its_reader(tmp_path: Path) -> None:
    """Its reader waited for good, and with it the page and `drivebus user`."""
    for name in ("users.json", "users.lock"):
        os.mkfifo(tmp_path / name)
    with pytest.raises(ConfigurationError, match="Invalid argument"):
        UserFile(tmp_path / "users.json").read()
    (tmp_path / "users.json").unlink()
    with pytest.raises(ConfigurationError, match="No such device"):
        UserFile(tmp_path / "users.json").change(lambda database: database.with_user(ADMIN))


def test_a_damaged_user_file_is_parsed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each request parsed it again: with a large file each stop over the page waited for that."""
    file = UserFile(tmp_path / "users.json")
    file.change(lambda database: database.with_user(ADMIN))
    file.read()
    whole = file.path.read_text()
    parsed: list[Path] = []
    read = users_module.read_regular_file
    monkeypatch.setattr(users_module, "read_regular_file", lambda path: parsed.append(path) or read(path))
    for number, text in enumerate(("{ oops", "{ oops again", whole), start=1):
        file.path.write_text(text)
        for _ in range(5):
            assert file.read().users == (ADMIN,)
        assert len(parsed) == number
    never_read = UserFile(tmp_path / "other.json")
    never_read.path.write_text("{ oops")
    for _ in range(5):
        with pytest.raises(ConfigurationError, match=r"other\.json can't be used: its content"):
            never_read.read()
    assert len(parsed) == 4


def test_a_user_file_that_is_removed_while_the_service_runs_prevents_no_stop_and_begins_no_set_up(
    tmp_path: Path,
) -> None:
    """Without its users the page would refuse every stop, and the next visitor with the set-up secret take over."""
    file = UserFile(tmp_path / "users.json")
    assert file.read() == UserDatabase(), "there was none yet"
    before = file.change(lambda database: database.with_user(ADMIN))
    file.read()
    kept = file.path.read_bytes()
    file.path.unlink()
    assert file.read() == before
    with pytest.raises(ConfigurationError, match="No such file"):
        file.change(lambda database: database.with_token(TOKEN))
    assert not file.path.exists()
    file.path.write_bytes(kept)
    assert file.change(lambda database: database.with_token(TOKEN)).tokens == (TOKEN,)


def test_users_that_another_program_replaces_are_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A file that replaced the removed one changed the users of a running service, and the log did not show it."""
    file = UserFile(tmp_path / "users.json")
    file.read()
    file.change(lambda database: database.with_user(ADMIN))
    file.change(lambda database: database.with_token(TOKEN).with_user(replace(ADMIN, name="carl")))
    assert len(file.read().users) == 2 and caplog.messages == [], "own changes are in the audit trail"
    file.path.unlink()
    file.read()
    (removed,) = caplog.messages
    assert str(file.path) in removed and "stay in force" in removed
    caplog.clear()
    new = [replace(ADMIN, name=f"u{number:02d}") for number in range(11)]
    carl = replace(ADMIN, name="carl", role=Role.VIEWER)
    UserFile(file.path).change(lambda _: UserDatabase((*new, carl)))
    assert len(file.read().users) == 12
    assert caplog.messages == [
        f"{file.path} was changed by another program; "
        f"users added: 11 ({', '.join(user.name for user in new[:10])}, …); "
        "users removed: 1 (ann); users changed: 1 (carl); tokens removed: 1 (t1)"
    ]
    file.change(lambda database: database.without_user("u00"))
    UserFile(file.path).change(lambda database: database.with_code(OneTimeCode("d", "carl", 9), 1))
    assert file.read().codes and len(caplog.messages) == 1, "a one-time code is no user"


def test_concurrent_changes_of_this_program_are_not_logged_as_those_of_another(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A thread may read what it wrote before its newest change: the log named tokens as removed that were not."""
    file = UserFile(tmp_path / "users.json")
    file.change(lambda _: UserDatabase().with_user(User("li", Role.VIEWER, "x", 0)))
    file.read()
    contents = []
    for number in range(3):
        file.change(lambda before, name=f"u{number}": before.with_user(User(name, Role.VIEWER, "x", 0)))  # type: ignore[misc]
        contents.append(file.path.read_bytes())
    file.read()
    for content in contents:
        file.path.write_bytes(content)
        file.read()
    assert not caplog.records
    other = UserFile(file.path)
    other.change(lambda before: before.without_user("u1"))
    assert file.read().find("u1") is None and "u1" in caplog.text


def test_an_earlier_state_that_is_restored_is_logged_also_where_this_program_once_wrote_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A copy of the file that is put back revives a user who was removed, and a token that was withdrawn."""
    now = 1000.0
    monkeypatch.setattr(users_module, "time", SimpleNamespace(monotonic=lambda: now), raising=False)
    file = UserFile(tmp_path / "users.json")
    file.change(lambda _: UserDatabase().with_user(ADMIN).with_user(User("li", Role.VIEWER, "x", 0)).with_token(TOKEN))
    file.read()
    earlier = file.path.read_bytes()
    file.change(lambda before: before.without_user("li").without_token(TOKEN.id))
    file.read()
    now += 11.0
    file.path.write_bytes(earlier)
    assert file.read().find("li") is not None
    assert "users added: 1 (li)" in caplog.text and "tokens added: 1 (t1)" in caplog.text


def test_a_state_that_could_not_be_written_is_logged_where_another_program_writes_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = UserFile(tmp_path / "users.json")
    file.change(lambda _: UserDatabase().with_user(ADMIN))
    file.read()

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as context, pytest.raises(ConfigurationError):
        context.setattr("os.fsync", full)
        file.change(lambda before: before.with_token(TOKEN))
    UserFile(file.path).change(lambda before: before.with_token(TOKEN))
    file.read()
    assert "tokens added: 1 (t1)" in caplog.text


def test_a_change_begins_with_the_file_whatever_was_read_before(tmp_path: Path) -> None:
    """A thread that read an older content a moment ago must not bring a removed user back."""
    file = UserFile(tmp_path / "users.json")
    before = file.change(lambda _: UserDatabase().with_user(User("li", Role.VIEWER, "x", 0)))
    file.read()
    file.change(lambda present: present.without_user("li"))
    file.read()
    file._loaded = file._loaded[0], before
    assert file.change(lambda present: present.with_user(User("wu", Role.VIEWER, "x", 0))).find("li") is None


def test_concurrent_changes_of_two_programs_are_both_stored(tmp_path: Path) -> None:
    def add(n: int) -> None:
        UserFile(tmp_path / "users.json").change(lambda database: database.with_user(replace(ADMIN, name=f"u{n}")))

    threads = [threading.Thread(target=add, args=(n,)) for n in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(UserFile(tmp_path / "users.json").read().users) == 8


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), OSError("No space left on device")])
def test_a_full_disk_leaves_the_old_file(error: OSError, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = UserFile(tmp_path / "users.json")
    file.change(lambda database: database.with_user(ADMIN))

    def full(_: int) -> None:
        raise error

    with monkeypatch.context() as context:
        context.setattr("os.fsync", full)
        with pytest.raises(ConfigurationError) as raised:
            file.change(lambda database: database.with_token(TOKEN))
    assert str(raised.value.params["problem"]) == "No space left on device"
    assert UserFile(file.path).read() == UserDatabase((ADMIN,))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["users.json", "users.lock"]


def test_leftovers_of_a_killed_program_are_harmless(tmp_path: Path) -> None:
    """Files of another user are harmless too: none is written to, and no link is followed."""
    for left in (".users.json.new", "users.lock"):
        (tmp_path / left).touch(0o644)
    (tmp_path / ".users.json.new").unlink()
    (tmp_path / ".users.json.new").symlink_to(tmp_path / "elsewhere")
    UserFile(tmp_path / "users.json").change(lambda database: database.with_user(ADMIN))
    assert UserFile(tmp_path / "users.json").read().users == (ADMIN,)
    assert not (tmp_path / "elsewhere").exists()
    (tmp_path / "users.lock").unlink()
    (tmp_path / "users.lock").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ConfigurationError):
        UserFile(tmp_path / "users.json").change(lambda database: database.without_user("ann"))
    assert not (tmp_path / "elsewhere").exists()


def test_the_directory_of_the_file_is_private(tmp_path: Path) -> None:
    path = tmp_path / "a" / "state" / "users.json"
    UserFile(path).change(lambda database: database.with_user(ADMIN))
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    loop = tmp_path / "loop.json"
    loop.symlink_to(loop)
    with pytest.raises(ConfigurationError) as raised:
        UserFile(loop).read()
    assert raised.value.params["file"] == str(loop)
