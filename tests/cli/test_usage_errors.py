"""Plausible mistakes at the command line: each is told in the user's language, with what was expected."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import click
import pytest
from click.testing import CliRunner, Result

from drivebus.cli import extras
from drivebus.cli.main import cli
from drivebus.service.auth.errors import AccessDenied
from drivebus.service.auth.rights import Right
from fixtures.service import SHOP_FILE


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    path = tmp_path / "plant.toml"
    path.write_text(SHOP_FILE)
    return path


def said(words: list[str], language: str = "zh") -> Result:
    return CliRunner().invoke(cli, [*words, "--lang", language])


NUMBERS = [
    ("monitor sim://c320@1 --period abc", "--period：收到 abc，应为：0.1 到 86400 的数"),
    ("monitor sim://c320@1 --duration -1", "--duration：收到 -1，应为：0.01 到 604800 的数"),
    ("monitor x.dbcap --speed 0", "--speed：收到 0，应为：0.01 到 1000 的数"),
    ("scan sim://c320@1 --listen-seconds nan", "--listen-seconds：收到 nan，应为：0 到 86400 的数"),
    ("demo --terminal --period 0", "--period：收到 0，应为"),
    ("simulate --model c320 --address 1 --ramp 0", "--ramp：收到 0，应为：0.1 到 3600 的数"),
    ("simulate --model c320 --address 1 --seed 1.5", "--seed：收到 1.5，应为：0 到 4294967295 的整数"),
    ("user token plant.toml ann --days 0", "--days：收到 0，应为：1 到 366 的整数"),
    ("audit list plant.toml --limit viele", "--limit：收到 viele，应为：1 到 100000 的整数"),
]


@pytest.mark.parametrize(("line", "message"), NUMBERS, ids=[line.partition(" --")[2] for line, _ in NUMBERS])
def test_a_value_that_can_not_be_is_told_in_the_users_language_with_what_can(
    line: str, message: str, plant: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(plant.parent)
    result = said(shlex.split(line))
    assert (result.exit_code, message in result.output) == (2, True), result.output


NEEDING = ["demo", "serve {plant}", "user add {plant} ann --role viewer"]


@pytest.mark.parametrize("line", NEEDING)
def test_what_needs_the_server_packages_says_so_before_anything_begins(
    line: str, plant: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`pip install .` leaves them out; a web process that ends at once, or a traceback, tells nobody what to do."""
    monkeypatch.setitem(extras.EXTRA_PACKAGES, "server", ("click", "no_such_package"))
    result = said(shlex.split(line.format(plant=plant)), "en")
    assert result.exit_code == 2
    assert "not installed: no_such_package." in result.output
    assert "'.[server]'" in result.output
    assert not (plant.parent / "state").exists()


def test_the_users_can_be_listed_without_the_server_packages(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(extras.EXTRA_PACKAGES, "server", ("no_such_package",))
    assert said(["user", "list", str(plant)]).exit_code == 0


def test_a_file_that_the_system_refuses_is_named_without_a_traceback(tmp_path: Path) -> None:
    file = str(tmp_path / "none" / "bus.dbcap")
    result = said(["scan", "sim://c320@1", "--models", "c320", "--addresses", "1", "--record", file])
    assert result.exit_code == 2
    assert file in result.output
    assert "Traceback" not in result.output


def test_two_passwords_that_differ_are_asked_for_again_in_the_users_language(
    plant: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    typed = iter(["correct horse 1", "correct horse 2", "xylo-phone 77!", "xylo-phone 77!"])
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr(click, "prompt", lambda *_, **__: next(typed))
    from drivebus.cli import output
    from drivebus.cli.commands import user

    output.parse_global_options(["--lang", "zh"])
    message: list[str] = []
    monkeypatch.setattr(output, "print_note", lambda key, **_: message.append(output.text(key)))
    assert user._prompt_password() == "xylo-phone 77!"
    assert message == ["两次输入不一致，请重新输入。"]


FILES = [
    ("check none.toml", 'none.toml：文件不存在：实际为 "none.toml"'),
    ("serve none.toml", "none.toml：文件不存在"),
    ("init --answers none.toml", "none.toml：文件不存在"),
    ("init --answers torn.toml", "torn.toml:2：不是有效的 TOML"),
    ("check torn.toml", "torn.toml:2：不是有效的 TOML"),
    ("profile check none.toml", "none.toml：文件不存在"),
]


@pytest.mark.parametrize(("line", "message"), FILES, ids=[line for line, _ in FILES])
def test_a_file_that_is_missing_or_torn_is_named_with_its_line_and_no_marks_for_what_it_lacks(
    line: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "torn.toml").write_text("format = 1\n[plant\n")
    result = said(shlex.split(line))
    assert (result.exit_code, message in result.output) == (2, True), result.output
    assert ":?" not in result.output and "：-：" not in result.output


def test_nobody_types_a_password_for_a_user_that_is_not_there(plant: Path) -> None:
    result = said(["user", "passwd", str(plant), "nobody"])
    assert (result.exit_code, "没有用户 nobody" in result.output) == (1, True), result.output


def test_a_word_that_is_none_of_the_few_is_told_as_one_of_them() -> None:
    assert "应为：bash, zsh, fish 之一" in said(["completion", "tcsh"]).output
    assert "expected one of bash, zsh, fish" in said(["completion", "tcsh"], "en").output


def test_chinese_sentences_stand_without_a_blank_between_them() -> None:
    assert "没有命令 staus。是否想用 status？" in said(["staus"]).output


def test_a_right_is_named_in_the_users_language_with_how_a_token_writes_it() -> None:
    error = AccessDenied("auth.forbidden", right=Right.OPERATE)
    assert error.text("zh") == "您没有此权限：操作（operate）。"
    assert error.text("en") == "You do not have the right operate."
    assert json.loads(json.dumps(error.params)) == {"right": "operate"}


def test_who_was_added_is_told_with_the_role_in_the_users_language(plant: Path) -> None:
    words = ["user", "add", str(plant), "ann", "--role", "operator", "--lang", "zh"]
    assert "已添加 ann，角色为操作员。" in CliRunner().invoke(cli, words, input="correct horse 77\n").output


@pytest.mark.parametrize(
    ("language", "words"), [("en", "not installed: no_such_package."), ("zh", "未安装：no_such_package。")]
)
def test_the_full_screen_view_names_the_missing_extra(
    language: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from drivebus.errors import ConfigurationError

    monkeypatch.setitem(extras.EXTRA_PACKAGES, "tui", ("no_such_package",))
    with pytest.raises(ConfigurationError) as caught:
        extras.require_extra("tui")
    text = caught.value.text(language)
    assert words in text and "'drivebus[tui]'" in text and "--plain" in text
