"""Errors of plausible command lines: in the user's language, with the expected value."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner, Result

from drivebus.cli import extras, output
from drivebus.cli.main import cli
from drivebus.service.auth.errors import AccessDenied
from drivebus.service.auth.rights import Right
from fixtures.service import SHOP_FILE


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    path = tmp_path / "plant.toml"
    path.write_text(SHOP_FILE)
    return path


def run_words(words: list[str], language: str = "zh") -> Result:
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
    ("run sim://c320@1 --model c320 --address 1 --frequency 1_0", "--frequency：收到 1_0，应为"),
    ("run sim://c320@1 --model c320 --address 1 --frequency ２５", "--frequency：收到２５，应为"),
    ("status sim://c320@1 --model c320 --address 1_0", "--address：收到 1_0，应为"),
    ("status sim://c320@1 --model c320 --address 1 --baud 9_600", "--baud：收到 9_600，应为"),
    ("monitor sim://c320@1 --period 1_0", "--period：收到 1_0，应为：0.1 到 86400 的数"),
    ("simulate --model c320 --address 1 --line-quality loss=0_1", "loss=0_1"),
    ("status tcp://127.0.0.1:1?timeout=1_0 --model c320 --address 1", "1_0"),
    ("audit list plant.toml --limit viele", "--limit：收到 viele，应为：1 到 100000 的整数"),
]


@pytest.mark.parametrize(("line", "message"), NUMBERS, ids=[line.partition(" --")[2] for line, _ in NUMBERS])
def test_the_error_of_an_invalid_number_has_the_allowed_range(
    line: str, message: str, plant: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(plant.parent)
    result = run_words(shlex.split(line))
    assert (result.exit_code, message in result.output) == (2, True), result.output


@pytest.mark.parametrize(
    ("language", "message"),
    [("en", "the command takes no further argument: {}\n"), ("zh", "该命令不再接受其他参数：{}\n")],
)
@pytest.mark.parametrize("extra", ["extra", "extra more"])
def test_an_argument_too_many_is_named_in_the_language_of_the_user(language: str, message: str, extra: str) -> None:
    """The message of click was printed in English."""
    result = run_words(["ports", *extra.split()], language)
    assert (result.exit_code, message.format(extra) in result.output) == (2, True), result.output


@pytest.mark.parametrize("group", ["control", "profile", "capture", "user", "audit"])
def test_a_missing_command_of_a_group_is_named_in_the_language_of_the_user(group: str) -> None:
    assert "缺少 COMMAND。" in CliRunner().invoke(cli, [group, "--lang", "zh"]).output


SERVER_COMMANDS = ["demo", "serve {plant}", "user add {plant} ann --role viewer"]


@pytest.mark.parametrize("line", SERVER_COMMANDS)
def test_a_command_without_its_server_packages_fails_before_it_starts_anything(
    line: str, plant: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``pip install .`` does not install them."""
    monkeypatch.setitem(extras.EXTRA_PACKAGES, "server", ("click", "no_such_package"))
    result = run_words(shlex.split(line.format(plant=plant)), "en")
    assert result.exit_code == 2
    assert "not installed: no_such_package." in result.output
    assert "'.[server]'" in result.output
    assert not (plant.parent / "state").exists()


@pytest.mark.parametrize(
    ("language", "expected"), [("en", "not installed: click, rich."), ("zh", "未安装：click、rich。")]
)
def test_the_base_installation_has_the_library_and_the_command_names_its_extra(language: str, expected: str) -> None:
    """``pip install .`` installs neither click nor rich."""
    source = """
import sys
sys.modules.update(dict.fromkeys(("click", "rich", "textual")))  # as if they were not installed
from drivebus import blocking
with blocking.open_bus("sim://vc660@1") as bus:
    print(blocking.Drive(bus, "vc660", 1).status().state)
from drivebus.__main__ import main
main()
"""
    done = subprocess.run(
        [sys.executable, "-c", source],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"DRIVEBUS_LANG": language, "PYTHONIOENCODING": "utf-8"},
    )
    assert (done.returncode, done.stdout.strip()) == (2, "stopped"), done.stderr
    assert expected in done.stderr and "'.[cli]'" in done.stderr and "Traceback" not in done.stderr


def test_the_users_can_be_listed_without_the_server_packages(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(extras.EXTRA_PACKAGES, "server", ("no_such_package",))
    assert run_words(["user", "list", str(plant)]).exit_code == 0


def test_a_file_that_cannot_be_created_is_named_without_a_traceback(tmp_path: Path) -> None:
    file = str(tmp_path / "none" / "bus.dbcap")
    result = run_words(["scan", "sim://c320@1", "--models", "c320", "--addresses", "1", "--record", file])
    assert result.exit_code == 2
    assert file in result.output
    assert "Traceback" not in result.output


def test_the_language_and_format_of_an_invocation_end_with_it() -> None:
    assert run_words(["check", "none.toml", "--json"], "zh").exit_code == 2
    assert output.language() == "en" and not output.as_json()


def test_two_different_passwords_are_prompted_for_again_in_the_users_language(
    plant: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inputs = iter(["correct horse 1", "correct horse 2", "xylo-phone 77!", "xylo-phone 77!"])
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr(click, "prompt", lambda *_, **__: next(inputs))
    from drivebus.cli.commands import user

    output.parse_global_options(["--lang", "zh"])
    notes: list[str] = []
    monkeypatch.setattr(output, "print_note", lambda key, **_: notes.append(output.text(key)))
    assert user._prompt_password() == "xylo-phone 77!"
    assert notes == ["两次输入不一致，请重新输入。"]


FILES = [
    ("check none.toml", 'none.toml：文件不存在：实际为 "none.toml"'),
    ("serve none.toml", "none.toml：文件不存在"),
    ("init --answers none.toml", "none.toml：文件不存在"),
    ("init --answers invalid.toml", "invalid.toml:2：不是有效的 TOML"),
    ("check invalid.toml", "invalid.toml:2：不是有效的 TOML"),
    ("profile check none.toml", "none.toml：文件不存在"),
]


@pytest.mark.parametrize(("line", "message"), FILES, ids=[line for line, _ in FILES])
def test_the_error_of_a_missing_or_invalid_file_has_its_name_and_line_without_placeholders(
    line: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "invalid.toml").write_text("format = 1\n[plant\n")
    result = run_words(shlex.split(line))
    assert (result.exit_code, message in result.output) == (2, True), result.output
    assert ":?" not in result.output and "：-：" not in result.output


def test_an_unknown_user_is_an_error_before_the_password_is_entered(plant: Path) -> None:
    result = run_words(["user", "passwd", str(plant), "eve"])
    assert (result.exit_code, "没有用户 eve" in result.output) == (1, True), result.output


def test_the_error_of_an_unknown_choice_lists_the_choices() -> None:
    assert "应为：bash、zsh、fish 之一" in run_words(["completion", "tcsh"]).output
    assert "expected one of bash, zsh, fish" in run_words(["completion", "tcsh"], "en").output


def test_chinese_sentences_are_joined_without_a_blank() -> None:
    assert "没有命令 staus。是否想用 status？" in run_words(["staus"]).output


def test_a_missing_right_is_named_in_the_users_language_and_as_in_a_token() -> None:
    error = AccessDenied("auth.forbidden", right=Right.OPERATE)
    assert error.text("zh") == "您没有此权限：操作（operate）。"
    assert error.text("en") == "You do not have the right operate."
    assert json.loads(json.dumps(error.params)) == {"right": "operate"}


def test_an_added_user_is_printed_with_the_role_in_the_users_language(plant: Path) -> None:
    words = ["user", "add", str(plant), "ann", "--role", "operator", "--lang", "zh"]
    assert "已添加 ann，角色为操作员。" in CliRunner().invoke(cli, words, input="copper kettle marble 77\n").output


@pytest.mark.parametrize(
    ("language", "expected"), [("en", "not installed: no_such_package."), ("zh", "未安装：no_such_package。")]
)
def test_the_full_screen_view_names_the_missing_extra(
    language: str, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from drivebus.errors import ConfigurationError

    monkeypatch.setitem(extras.EXTRA_PACKAGES, "tui", ("no_such_package",))
    with pytest.raises(ConfigurationError) as caught:
        extras.require_extra("tui")
    text = caught.value.text(language)
    assert expected in text and "'.[tui]'" in text and "--plain" in text


FULL_WIDTH = [
    ("status sim：//c320@1 --model c320 --address 1", "sim：//c320@1 → sim://c320@1"),
    ("status tcp://127.0.0.1：4001 --model c320 --address 1", "tcp://127.0.0.1：4001 → tcp://127.0.0.1:4001"),
    ("stop sim：//c320@1 --model c320 --address 1", "sim：//c320@1 → sim://c320@1"),
    ("status sim://c320@1 －－model c320 --address 1", "－－model → --model"),
    ("status sim://c320@1 ——model c320 --address 1", "——model → --model"),
    ("status sim://c320@1 --model ｃ320 --address １", "ｃ320 → c320、１ → 1"),
    ("read sim://c320@1 F0．1 --model c320 --address 1", "F0．1 → F0.1"),
    ("write sim://c320@1 F0.1＝2 --model c320 --address 1", "F0.1＝2 → F0.1=2"),
    ("write sim://c320@1 F0.1=２ --model c320 --address 1", "F0.1=２ → F0.1=2"),
    ("run sim://c320@1 --model c320 --address 1 --frequency ２．５", "２．５ → 2.5"),
    ("stop --all sim://c320@1 --model c320 --address 1，2", "1，2 → 1,2"),
]


@pytest.mark.parametrize(("line", "pair"), FULL_WIDTH, ids=[pair for _, pair in FULL_WIDTH])
def test_full_width_characters_of_a_failed_command_line_are_named_with_what_to_type(line: str, pair: str) -> None:
    result = run_words(line.split())
    assert result.exit_code != 0
    assert f"含有中文输入法的全角字符，请改用半角：{pair}\n" in result.output, result.output
    items = pair.replace("、", ", ")
    assert f"Full-width characters of a Chinese input method; type half-width ones: {items}\n" in (
        run_words(line.split(), "en").output
    )


def test_the_full_width_signs_of_a_reason_and_of_a_file_name_are_not_named() -> None:
    words = ["waive", "--service", "http://127.0.0.1:1", "--all", "--reason", "fan （2）： attended"]
    assert "全角" not in run_words(words).output
    assert "全角" not in run_words(["check", "风机（2）.toml"]).output


def test_a_missing_service_says_that_the_command_takes_no_port() -> None:
    """The sentence named the option only, and a PORT had been given."""
    output_en, output_zh = (run_words(["waive", "sim://c320@1"], language).output for language in ("en", "zh"))
    assert "works on a running service and takes no PORT" in output_en and "http://127.0.0.1:8080" in output_en
    assert "作用于运行中的服务，不接受 PORT" in output_zh


@pytest.mark.parametrize(
    ("line", "hint"),
    [
        ("status sim://c320@1", "`drivebus scan PORT` finds the models that fit"),
        ("stop --all sim://c320@1", "`drivebus scan PORT` finds the models that fit"),
        ("simulate --address 1", "`drivebus models` lists them"),
        ("status sim://c320@1 --model c320", "`drivebus scan PORT` finds the station address"),
        ("stop sim://c320@1 --model c320", "`drivebus scan PORT` finds the station address"),
        ("status", "`drivebus ports` lists the serial ports"),
    ],
)
def test_a_missing_value_says_where_it_is_found(line: str, hint: str) -> None:
    result = run_words(line.split(), "en")
    assert (result.exit_code, hint in result.output) == (2, True), result.output


def test_a_simulated_drive_has_no_address_to_be_found_by_a_scan() -> None:
    assert "drivebus scan" not in run_words(["simulate", "--model", "c320"], "en").output


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ("vc660", "--option x: model vc660 has no such option; expected one of pulses"),
        ("gd10", "--option x: model gd10 has no options; leave it out"),
    ],
)
def test_simulate_refuses_an_option_that_the_model_does_not_have(model: str, message: str) -> None:
    """It was ignored, and the drive was simulated without it."""
    result = run_words(["simulate", "--model", model, "--address", "1", "--option", "x=1"], "en")
    assert (result.exit_code, message in result.output) == (2, True), result.output


def test_an_invalid_profile_option_is_explained_by_an_example_of_an_option() -> None:
    """The example was one of a parameter to write."""
    result = run_words(["status", "sim://c320@1", "--model", "c320", "--address", "1", "--option", "a"], "en")
    assert "found a, expected NAME=VALUE, such as setpoint_coding=hex-0.1" in result.output


@pytest.mark.parametrize("url", ["tcp://10.0.0.5", "rfc2217://10.0.0.5:", "tcp://[::1]"])
def test_a_url_without_a_tcp_port_says_that_it_is_missing_with_an_example(url: str) -> None:
    """The whole host was called "no address"."""
    words = ["status", url, "--model", "c320", "--address", "1"]
    example = f"{url.rstrip(':')}:4001"
    assert "the TCP port after the host is missing" in run_words(words, "en").output
    assert example in run_words(words, "en").output
    assert "缺少 TCP 端口" in run_words(words).output and example in run_words(words).output
