"""Errors of plausible command lines: in the user's language, with the expected value."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner, Result

from drivebus import i18n
from drivebus.cli import errors, extras, output
from drivebus.cli.main import cli
from drivebus.drives.permissives import CommandKind
from drivebus.drives.state import DriveState
from drivebus.errors import (
    DrivebusError,
    EchoError,
    NoReply,
    OutcomeUnknown,
    ProtocolError,
    StartInhibited,
    StopUnconfirmed,
    TargetNotReached,
    TrailingError,
)
from drivebus.service.auth.errors import AccessDenied
from drivebus.service.auth.rights import Right
from fixtures.service import SHOP_FILE

pytestmark = pytest.mark.usefixtures("commands_in_virtual_time")


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


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize(
    ("line", "step"),
    [
        ("models vc660", "`drivebus models --search vc660`"),
        ("hold-ramp sim://vc660@1 --model vc660 --address 1", "`drivebus hold-ramp PORT 5`"),
        ("run sim://vc660@1 --model vc660 --address 1 --frequency 60 --detach", "add-a-profile"),
        ("hold-ramp sim://vc660@1 --model vc660 --address 1 1", "`drivebus run`"),
        ("pause sim://vc660@1 --model vc660 --address 1", "`drivebus run`"),
        ("decode --model vc660", "`drivebus decode --model vc660 01 "),
        ("completion", "`drivebus completion bash`"),
        ("status http://127.0.0.1:8080 --model c320 --address 1", "--service http://127.0.0.1:8080 --drive NAME"),
        ("status https://drives --model c320 --address 1", "--service https://drives --drive NAME"),
        ("status fan-1", "--service http://127.0.0.1:8080 --drive fan-1"),
        ("run fan-1 --frequency 5", "--service http://127.0.0.1:8080 --drive fan-1"),
        ("stop fan-1", "--service http://127.0.0.1:8080 --drive fan-1"),
        ("stop --all fan-1", "--service http://127.0.0.1:8080 --drive fan-1"),
        ("scan fan-1", "`drivebus monitor --service http://127.0.0.1:8080`"),
        ("monitor fan-1", "`drivebus monitor --service http://127.0.0.1:8080`"),
        ("status none.toml", "`drivebus check none.toml`"),
        ("run --group fans --frequency 5", "`drivebus set-frequency`"),
        ("run --service http://127.0.0.1:1 --group fans --frequency 5", "`drivebus set-frequency`"),
        ("run --frequency", "`drivebus run --help`"),
        ("status sim://c320@1 --model c321 --address 1", "`drivebus models --search WORD`"),
        ("run http://127.0.0.1:8080 --frequency 20", "--service http://127.0.0.1:8080 --drive NAME"),
        ("stop http://127.0.0.1:8080", "--service http://127.0.0.1:8080 --drive NAME"),
        ("stop --all http://127.0.0.1:8080", "--service http://127.0.0.1:8080 --drive NAME"),
        ("monitor http://127.0.0.1:8080", "`drivebus monitor --service http://127.0.0.1:8080`"),
        ("models show vc660", "`drivebus models --search vc660`"),
    ],
)
def test_a_refusal_names_the_next_step(line: str, step: str, language: str) -> None:
    assert step in run_words(shlex.split(line), language).output.replace("\n", " ")


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("command", ["calibrate", "acceptance", "scan"])
def test_a_command_of_a_port_says_that_it_does_not_work_through_a_service(command: str, language: str) -> None:
    """``calibrate`` had the option, connected and failed with a traceback: a service does not calibrate."""
    result = run_words([command, "--service", "http://127.0.0.1:1", "--drive", "fan-1"], language)
    step = i18n.text("cli.no_such_option.service", language)
    assert (result.exit_code, step in result.output.replace("\n", " ")) == (2, True), result.output


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_frequency_behind_the_option_of_another_command_is_answered_with_its_place(language: str) -> None:
    """``run`` takes --frequency: nothing named where ``set-frequency`` takes it."""
    words = ["set-frequency", "sim://vc660@1", "--frequency", "2", "--model", "vc660", "--address", "1"]
    result = run_words(words, language)
    step = "`drivebus set-frequency PORT 25`"
    assert (result.exit_code, step in " ".join(result.output.split())) == (2, True), result.output


@pytest.mark.parametrize(("model", "exit_code"), [("c320", 1), ("vc660", 3), ("dzb100", 1), ("df800", 3)])
def test_bytes_that_are_no_reply_are_answered_with_the_remedy_that_a_stop_promises_of_a_status(
    model: str, exit_code: int
) -> None:
    """Of two drives at one address the sentence named a byte only: the stop refers to ``status`` for the remedy."""
    result = CliRunner().invoke(
        cli, ["status", f"sim://{model}@2+{model}@2", "--model", model, "--address", "2", "--json"]
    )
    assert result.exit_code == exit_code, result.output
    hint = json.loads(result.stdout)["error"]["hint"]
    assert hint == i18n.text("hint.damaged_reply") and hint in result.stderr.replace("\n", " ")


@pytest.mark.parametrize("kind", ProtocolError.__subclasses__())
def test_every_reply_that_is_not_accepted_has_a_remedy(kind: type[ProtocolError]) -> None:
    """A C320 that answered each read with d.1 had none, which an unconfirmed stop promises of ``status``."""
    hint = errors.error_hint(kind("protocols.sunfar.echo.item", expected=0, found=1))
    assert hint is not None and ("not one to this request" in hint) == (kind is EchoError)
    withheld = NoReply("bus.suspect", station=1)
    withheld.__cause__ = kind("protocols.sunfar.echo.item", expected=0, found=1)
    assert errors.error_hint(withheld) is not None


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_write_that_doubled_replies_withhold_names_a_repeater_in_its_remedy(
    language: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only two drives at one address were named, to a reader who has one."""
    monkeypatch.setattr("drivebus.cli.output.language", lambda: language)
    hint = errors.error_hint(StartInhibited("drives.duplicate", station=1)) or ""
    assert hint == i18n.text("hint.bus.second_reply", language)
    assert ("repeater" if language == "en" else "中继器") in hint


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize(
    ("error", "step"),
    [
        (TargetNotReached("drives.start_failed", state=DriveState.FAULT), "drivebus reset"),
        (TargetNotReached("drives.started_and_tripped", state=DriveState.FAULT), "drivebus reset"),
        (TargetNotReached("drives.start_failed", state=DriveState.NOT_READY), "drivebus status"),
        (StartInhibited("drives.state_forbids", kind="start", state=DriveState.NOT_READY), "drivebus status"),
        (TargetNotReached("drives.start_ignored", state=DriveState.STOPPED, after_s=3.0), "keypad-settings"),
        (TargetNotReached("drives.write_differs", notation="F1.10", value=1, found=0, unit=""), "drivebus read"),
        (OutcomeUnknown("drives.write_unknown", notation="F1.10", value=1, unit="", why="no reply"), "drivebus read"),
        (StopUnconfirmed("drives.stop_port_lost", why="hang-up", sent=1), "drivebus ports"),
        (NoReply("bus.truncated", station=1, bytes=9, milliseconds=50, attempt=1), "reply_delay_s"),
        (NoReply("bus.offline", station=1), "echo=on"),
        (NoReply("bus.only_own_frame", station=1, milliseconds=50, attempt=1), "serial:///dev/ttyUSB0?echo=off"),
        (TrailingError("bus.second_reply", station=1), "echo=off"),
    ],
)
def test_what_a_drive_did_not_do_is_answered_with_the_next_step(
    error: DrivebusError, step: str, language: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each stood without a step, or with the advice to check the address of a drive that had answered."""
    monkeypatch.setattr("drivebus.cli.output.language", lambda: language)
    assert step in (errors.error_hint(error) or "")


@pytest.mark.parametrize("language", ["en", "zh"])
def test_after_a_stop_whose_replies_ended_no_address_is_searched_for(
    language: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The hint led to a scan for the address, although the drive had just reported its state at that address."""
    monkeypatch.setattr("drivebus.cli.output.language", lambda: language)
    error = StopUnconfirmed("drives.stop_reply_lost", found="running", failures=3)
    hint = errors.error_hint(error) or ""
    assert "drivebus status" in hint and "scan" not in hint
    assert ("at its keypad" if language == "en" else "在操作面板上停机") in hint


@pytest.mark.parametrize("line", ["status fan-1", "stop fan-1"])
def test_the_name_of_a_drive_in_place_of_a_port_is_not_answered_with_a_missing_model(line: str) -> None:
    """A drive of a service needs no model, and a scan of its name finds nothing."""
    result = run_words(line.split(), "en")
    assert (result.exit_code, "fan-1 is no port URL" in result.output) == (2, True), result.output
    assert "--model" not in result.output


@pytest.mark.parametrize("line", ["status sim://c320@1", "run --group fans --frequency 5"])
def test_the_json_of_a_refusal_has_the_next_step_that_the_terminal_shows(line: str) -> None:
    result = CliRunner().invoke(cli, [*line.split(), "--json"])
    hint = json.loads(result.stdout)["error"]["hint"]
    assert hint and hint in result.stderr.replace("\n", " "), result.output


@pytest.mark.parametrize("line", ["check none.toml", "status sim://c320@1 --model ./none.toml --address 1"])
def test_a_file_that_does_not_exist_is_not_called_found(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    output = run_words(shlex.split(line), "en").output
    assert "no such file: a " in output and "found" not in output, output


@pytest.mark.parametrize("language", ["en", "zh"])
def test_the_audit_trail_of_a_plant_that_has_not_run_names_the_command_that_runs_it(plant: Path, language: str) -> None:
    result = run_words(["audit", "verify", str(plant)], language)
    assert (result.exit_code, "`drivebus serve`" in result.output) == (2, True), result.output


@pytest.mark.parametrize("command", ["scan", "monitor"])
def test_a_port_that_is_none_is_refused_before_a_line_says_that_it_is_listened_to(command: str) -> None:
    output = run_words([command, "http://127.0.0.1:8080"], "en").output
    assert "--service http://127.0.0.1:8080" in output and "istening" not in output


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_jog_or_calibration_that_a_pause_forbids_names_the_stop_beside_the_run(language: str) -> None:
    """They begin at standstill: a run would turn the motor at its set frequency."""
    hint = i18n.text("hint.drives.state_forbids_paused", language)
    assert "`drivebus run`" in hint and "`drivebus stop`" in hint


def test_a_ramp_hold_that_the_model_lacks_is_not_announced() -> None:
    output = run_words(shlex.split("hold-ramp sim://c320@1 --model c320 --address 1 5")).output
    assert "Ctrl-C" not in output and "c320" in output


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
    ("language", "words", "expected"),
    [
        ("en", [], "not installed: click, rich."),
        ("zh", [], "未安装：click、rich。"),
        ("en", ["status", "--lang", "zh"], "未安装：click、rich。"),
    ],
)
def test_the_base_installation_has_the_library_and_the_command_names_its_extra(
    language: str, words: list[str], expected: str
) -> None:
    """``pip install .`` installs neither click nor rich. ``--lang`` was ignored by the message that says so."""
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
        [sys.executable, "-c", source, *words],
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
    ("check none.toml", "none.toml：文件不存在：应为"),
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


@pytest.mark.parametrize("words", [["passwd", "eve"], ["token", "eve"]], ids=lambda words: words[0])
def test_the_error_of_an_unknown_user_names_the_commands_that_list_and_add_users(plant: Path, words: list[str]) -> None:
    for language in ("en", "zh"):
        result = run_words(["user", words[0], str(plant), words[1]], language)
        assert "drivebus user list" in result.output and "drivebus user add" in result.output, result.output


def test_the_line_about_the_help_fits_a_narrow_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(output, "wrap_for", lambda text, _, indent=0: f"[{text}]")
    lines = run_words(["status", "sim://c320@3", "--model", "c320"], "en").output.splitlines()
    assert [line[:1] + line[-1:] for line in lines if "status --help" in line] == ["[]"], lines


def test_the_error_of_an_unknown_choice_lists_the_choices() -> None:
    assert "应为：bash、zsh、fish 之一" in run_words(["completion", "tcsh"]).output
    assert "expected one of bash, zsh, fish" in run_words(["completion", "tcsh"], "en").output


def test_chinese_sentences_are_joined_without_a_blank() -> None:
    assert "没有命令 statu。是否想用 status？" in run_words(["statu"]).output


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
    ("scan sim://c320@1 --models c320 --addresses 1～8", "1～8 → 1-8"),
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


DRIVE = "sim://c320@1 --model c320"
GIVEN_TWICE = [
    (f"status {DRIVE} --address 1 --address 2", "--address: given more than once (1, 2): give it once"),
    ("status sim://c320@1 --model c320 --model vc660 --address 1", "--model: given more than once (c320, vc660)"),
    (f"run {DRIVE} --address 1 --frequency 5 --frequency=50", "--frequency: given more than once (5, 50)"),
    ("stop --service a --service b --drive x", "--service: given more than once (a, b)"),
    (f"stop --all {DRIVE} --address 1-3 --address 5", "(1-3, 5): give all values together, --address 1-3,5"),
    (f"status {DRIVE} --address 1 --option a=1 --option a=2", "--option: given more than once (a=1, a=2)"),
    (f"write {DRIVE} --address 1 F1.7=1 F1.7=2", "given more than once (F1.7=1, F1.7=2)"),
    (f"write {DRIVE} --address 1 F1.7=1234567 F1.7=10.00001", "given more than once (F1.7=1234567, F1.7=10.00001)"),
]


@pytest.mark.parametrize(("line", "message"), GIVEN_TWICE)
def test_a_value_given_twice_is_refused_with_both(line: str, message: str) -> None:
    """The last one won silently: another drive than the first one named was commanded."""
    result = run_words(line.split(), "en")
    assert (result.exit_code, message in result.output) == (2, True), result.output
    chinese = message.partition("(")[2].partition(")")[0].replace(", ", "、")
    assert f"重复给出（{chinese}）" in run_words(line.split()).output


@pytest.mark.parametrize(
    ("addresses", "found"),
    [("--address 1 --address 2", "1,2"), ("--address=1-2 --address 2 --address 2", "1-2,2"), ("--address 1,2", "1,2")],
)
def test_a_stop_of_several_addresses_is_answered_with_the_whole_command(addresses: str, found: str) -> None:
    """It took two answers: first to write them together, then to add --all."""
    result = run_words(["stop", "sim://c320@1-2", *addresses.split(), "--model", "c320", "--format", "8E1"], "en")
    command = re.search(r"`drivebus (.*?)`", " ".join(result.output.split()))
    assert result.exit_code == 2 and command is not None, result.output
    assert command[1] == f"stop --all sim://c320@1-2 --model c320 --format 8E1 --lang en --address {found}"
    assert run_words(command[1].split(), "en").exit_code == 0
    assert "停多台请用 `drivebus stop --all" in run_words(["stop", "sim://c320@1-2", *addresses.split()]).output


@pytest.mark.parametrize("words", ["sim://c320@1-2 --quick", "sim://c320@1-2 --assume-model", "-- sim://c320@1-2"])
def test_the_whole_command_of_a_stop_has_no_word_with_which_it_would_be_refused(words: str) -> None:
    """Regression: the command that was to stop the drives was refused for its --quick."""
    result = run_words(["stop", "--model", "c320", "--address", "1,2", *words.split()], "en")
    command = re.search(r"`drivebus (.*?)`", " ".join(result.output.split()))
    assert command is not None, result.output
    assert run_words(command[1].split(), "en").exit_code == 0, command[1]


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        ("plant.toml", "`drivebus stop --all plant.toml`"),
        ("--group fans", "such as --service"),
        ("--drive fan-1", "such as --service"),
        ("--directory folder", "--directory needs --all"),
    ],
)
def test_a_stop_through_a_service_with_several_addresses_is_answered_with_no_command_that_is_refused(
    words: str, remedy: str
) -> None:
    result = run_words(["stop", *words.split(), "--address", "1,2"], "en")
    shown = " ".join(result.output.split())
    assert result.exit_code == 2 and remedy in shown and "--address 1,2`" not in shown


@pytest.mark.parametrize("alike", errors._SHARED_HINTS)
def test_errors_with_the_same_remedy_share_its_text(alike: str) -> None:
    hint = errors.error_hint(DrivebusError(alike))
    assert hint is not None and hint == errors.error_hint(DrivebusError(errors._SHARED_HINTS[alike]))
    assert not i18n.known(f"hint.{alike}"), "it would never be shown"


@pytest.mark.parametrize(
    ("state", "is_named"),
    [
        (DriveState.FAULT, True),
        (DriveState.PAUSED, True),
        (DriveState.STOPPED, True),
        (DriveState.DECELERATING, False),
    ],
)
def test_a_command_that_the_state_forbids_names_the_command_that_leaves_it(state: DriveState, is_named: bool) -> None:
    hint = errors.error_hint(StartInhibited("drives.state_forbids", state=state, kind=CommandKind.START))
    assert hint == (i18n.text(f"hint.drives.state_forbids_{state}", output.language()) if is_named else None)


@pytest.mark.parametrize("more", ["--address 1", "--option setpoint_step=0.01 --option setpoint_step=0.01"])
def test_a_stop_with_a_value_given_twice_alike_is_sent(more: str) -> None:
    result = run_words(f"stop {DRIVE} --address 1 {more}".split(), "en")
    assert (result.exit_code, "Confirmed" in result.output) == (0, True), result.output


def test_an_option_that_may_be_repeated_takes_several_values() -> None:
    coding = ["--option", "setpoint_coding=hex-0.1", "--option", "query_coding=hex-0.1"]
    assert run_words(["status", "sim://dzb100@1", "--model", "dzb100", "--address", "1", *coding]).exit_code == 0


@pytest.mark.parametrize(("model", "encoding"), [("c320", "rtu"), ("vc660", "ascii"), ("gd10", "hex")])
def test_simulate_refuses_an_encoding_that_its_drives_do_not_answer(model: str, encoding: str) -> None:
    """It was ignored, and the drives answered in another one."""
    words = ["simulate", "--model", model, "--address", "1", "--encoding", encoding, "--bind", "tcp://127.0.0.1:0"]
    result = run_words(words, "en")
    assert result.exit_code == 2
    assert f"the simulated {model} answers in " in result.output and f"only; found {encoding}" in result.output
    assert f"编码应答；给定的是 {encoding}" in run_words(words).output


@pytest.mark.parametrize(
    "line",
    [
        "status sim://c320@1 --model C320 --address 1 --json",
        "status sim://C320@1 --model c320 --address 1 --json",
        "decode --model C320 2A 30 30 34 30 33 30 30 30 30 30 31 42 37 0D --json",
        "scan sim://c320@1 --models C320,VC660 --addresses 1 --listen-seconds 0 --dry-run --json",
        "init sim://c320@1 --scan --models C320 --addresses 1 --listen-seconds 0 -o - --json",
    ],
)
def test_the_name_of_a_model_is_taken_in_any_case(line: str) -> None:
    result = run_words(line.split(), "en")
    assert result.exit_code == 0, result.output
    assert "C320" not in result.stdout.replace("sim://C320", "")


@pytest.mark.parametrize("words", [["--model", ""], ["--model", " "], ["--model="]])
def test_an_empty_model_is_called_a_missing_name(words: list[str]) -> None:
    """There was "no model .", as an empty path is the present folder."""
    line = ["status", "sim://c320@1", *words, "--address", "1"]
    assert "expected the name of a model such as c320" in run_words(line, "en").output
    assert "应为：型号名称，例如 c320" in run_words(line).output


FREQUENCIES = [
    ("-5", "`drivebus run` turns backward with --reverse", "反转用 `drivebus run` 的 --reverse"),
    ("50Hz", "write the number in Hz, without a unit", "单位固定为 Hz，只写数字"),
    ("50赫兹", "write the number in Hz, without a unit", "单位固定为 Hz，只写数字"),
    ("５０Ｈｚ", "write the number in Hz, without a unit", "单位固定为 Hz，只写数字"),
    ("12,5", "write a decimal point: 12.5", "小数点请写成“.”：12.5"),
    ("12，5", "write a decimal point: 12.5", "小数点请写成“.”：12.5"),
    ("5000", "a frequency from 0 to 4000 in Hz", "0 到 4000 的频率，单位 Hz"),
]


@pytest.mark.parametrize(("typed", "english", "chinese"), FREQUENCIES, ids=[case[0] for case in FREQUENCIES])
def test_a_mistyped_frequency_is_answered_with_what_to_type(typed: str, english: str, chinese: str) -> None:
    words = ["run", "sim://c320@1", "--model", "c320", "--address", "1", "--frequency", typed]
    result = run_words(words, "en")
    assert (result.exit_code, english in result.output) == (2, True), result.output
    assert chinese in run_words(words).output


@pytest.mark.parametrize(
    "line",
    [
        "status sim://c320@1",
        "run sim://c320@1 --frequency 5",
        "read sim://c320@1 F0.1",
        "write /dev/ttyUSB0 F0.1=1",
        "set-frequency COM3 25",
        "stop sim://c320@1",
    ],
)
def test_a_port_beside_a_service_is_named_as_replaced_by_it(line: str) -> None:
    """It was one argument too many, or the name of a parameter."""
    words = [*line.split(), "--service", "http://127.0.0.1:1", "--drive", "fan-1"]
    port = line.split()[1]
    english, chinese = (run_words(words, language).output for language in ("en", "zh"))
    assert "--service replaces PORT" in english and f"leave out {port}, or leave out --service" in english
    assert f"请去掉 {port}，或去掉 --service" in chinese


def test_a_folder_in_place_of_a_file_is_no_matter_of_a_permission(tmp_path: Path) -> None:
    for words in (["check", str(tmp_path)], ["init", "--answers", str(tmp_path), "-o", str(tmp_path / "new.toml")]):
        english, chinese = (run_words(words, language).output for language in ("en", "zh"))
        assert "a folder in place of a file" in english and "right to read" not in english
        assert "应为文件，却是目录" in chinese and "权限" not in chinese


@pytest.mark.parametrize(
    ("name", "english", "chinese"),
    [("none.toml", "No such file or directory. Check the path", "请检查路径"), (".", "is a folder", "是目录")],
)
def test_a_missing_file_of_answers_is_no_matter_of_a_permission(
    name: str, english: str, chinese: str, tmp_path: Path
) -> None:
    words = ["profile", "new", str(tmp_path / "new.toml"), "--answers", str(tmp_path / name)]
    assert english in run_words(words, "en").output and "permission" not in run_words(words, "en").output
    assert chinese in run_words(words).output and "权限" not in run_words(words).output


@pytest.mark.parametrize(
    ("line", "chinese", "next_step"),
    [
        ("coast sim://dzb100@1 --model dzb100", "自由停车", "`drivebus stop` 使其减速停机"),
        ("stop --quick sim://dzb100@1 --model dzb100", "快速停机", "不带 --quick 的 `drivebus stop`"),
        ("loopback sim://c320@1 --model c320", "回路测试", "`drivebus models --search c320 --json`"),
    ],
)
def test_a_command_that_a_model_lacks_is_named_in_chinese_with_the_next_step(
    line: str, chinese: str, next_step: str
) -> None:
    result = run_words([*line.split(), "--address", "1"])
    assert f"没有此命令：{chinese}；未发送" in result.output and next_step in result.output, result.output


@pytest.mark.parametrize("names", ["F0.0,F0.1", "F0.0, F0.1", "F0.0，F0.1", "F0.0、F0.1", "F0.0;F0.1"])
def test_names_that_a_comma_joins_are_shown_apart(names: str) -> None:
    words = ["read", "sim://c320@1", *names.split(), "--model", "c320", "--address", "1"]
    assert "write F0.0 F0.1, with blanks between the names\n" in run_words(words, "en").output
    assert "请写作 F0.0 F0.1，各名称之间用空格\n" in run_words(words).output


def test_a_stop_of_addresses_beyond_the_range_names_them_all() -> None:
    """It named the first one only."""
    words = ["stop", "--all", "sim://c320@1", "--model", "c320", "--address", "1-40"]
    message = "nothing was sent: c320 has the addresses 0-30, not 31-40. Give --address 1-30\n"
    assert message in run_words(words, "en").output
    assert message in run_words([*words, "--dry-run"], "en").output
    assert "没有 31-40。请用 --address 1-30\n" in run_words(words).output


def test_a_stop_of_a_plant_without_all_says_how_its_drives_are_stopped() -> None:
    """The model was asked for, as if the file were a port."""
    assert "`drivebus stop --all plant.toml` stops all its drives" in run_words(["stop", "plant.toml"], "en").output
    assert "`drivebus stop --all plant.toml` 停下其全部变频器" in run_words(["stop", "plant.toml"]).output


@pytest.mark.parametrize(
    "option", ["--bauds 9600,,19200", "--bauds 9_600", "--formats 8N1,", "--models c320,,vc660", "--models ,"]
)
def test_an_empty_field_of_a_list_is_refused(option: str) -> None:
    """A value may be missing there: the scan ran without it."""
    result = run_words(["scan", "sim://c320@1", *option.split(), "--dry-run"], "en")
    assert (result.exit_code, f"found {option.split()[1]}, expected" in result.output) == (2, True), result.output


def test_every_usage_line_has_one_form_for_the_file_of_a_plant() -> None:
    for command in ("check", "serve"):
        assert f"drivebus {command} [OPTIONS] PLANT.toml\n" in run_words([command, "--help"], "en").output


@pytest.mark.parametrize(
    ("line", "listed"),
    [
        ("status plc --model c320 --address 1", "应为 /dev/ttyUSB0、COM3、"),
        ("read sim://c320@1 X --model c320 --address 1", "F0.1、F1.10 (F1.0-F1.255)、FC.03"),
        ("decode --model dzb100 58 03 06 30", "应为 C、P、R、Q 之一"),
        ("status sim://c320@1 --model c320 --address 1 --baud 57600", "4800、9600、19200；8N1、8E1、8O1）"),
    ],
)
def test_the_items_of_a_chinese_list_are_separated_by_its_own_comma(line: str, listed: str) -> None:
    assert listed in run_words(line.split()).output
    english = listed.replace("应为 ", "expected one of ").replace(" 之一", "").replace("、", ", ").replace("；", "; ")
    assert english.rstrip("）") in run_words(line.split(), "en").output


@pytest.mark.parametrize("words", [["--dry-run"], ["--detach"], ["--detach", "--wait"]])
@pytest.mark.parametrize("target", [["sim://c320@1", "--model", "c320"], ["sim://vc660@1", "--model", "vc660"]])
def test_a_run_at_0_hz_says_what_to_expect(target: list[str], words: list[str]) -> None:
    """The output was on without a note that the motor starts with the next frequency."""
    line = ["run", *target, "--address", "1", "--frequency", "0", *words]
    for language in ("en", "zh"):
        result = run_words(line, language)
        assert (result.exit_code, i18n.text("drives.run_at_zero", language) in result.output) == (0, True)
    assert i18n.text("drives.run_at_zero") not in run_words([*line[: -1 - len(words)], "1", *words], "en").output


SLIPS = [
    ("run 25 {drive}", "the port stands first: sim://c320@1 before 25", "端口写在最前：sim://c320@1 在 25 之前"),
    ("read F0.1 {drive}", "the port stands first: sim://c320@1 before F0.1", "端口写在最前"),
    ("set-frequency 25 {drive}", "the port stands first: sim://c320@1 before 25", "端口写在最前"),
    ("stop all {drive}", "all has no dashes: type --all", "all 前缺少短横线：请输入 --all"),
    ("run {drive} --frequency 5 reverse", "type --reverse", "请输入 --reverse"),
    ("run {drive} --frequency --dry-run", "--frequency needs a value.", "--frequency 需要一个值。"),
    ("run {drive} --frequency 5 --drive --dry-run", "--drive needs a value.", "--drive 需要一个值。"),
    ("run {drive} --frequency 5 --reverse=yes", "--reverse takes no value", "--reverse 不带值"),
    ("run {drive} 25", "as an option: --frequency 25", "作为选项给出：--frequency 25"),
    ("run {drive} --frequency=25 Hz", "argument: Hz; write the number without a unit", "Hz；只写数字，不写单位"),
    ("run {drive} -frequency 25", "Did you mean --frequency?", "是否想用 --frequency？"),
    ("run {drive} —frequency 25", "—frequency → --frequency", "—frequency → --frequency"),
    ("run {drive} –frequency 25", "–frequency → --frequency", "–frequency → --frequency"),
    ("set-frequency {drive} -5", "`drivebus run` turns backward with --reverse", "反转用 `drivebus run` 的 --reverse"),
    ("set-frequency {drive}", "behind the port: `drivebus set-frequency PORT 25`", "写在端口之后"),
    ("set {drive} 25", "Did you mean set-frequency?", "是否想用 set-frequency？"),
    ("trend fan-1", "are on the page of a running service", "在运行中的服务的网页上"),
    ("read {drive}", "`drivebus read PORT F0.1 output_frequency`", "写在端口之后"),
    ("read {drive} F0,1", "write F0.1, with blanks between the names", "请写作 F0.1，"),
    ("read {drive} F0.1=5", "`drivebus write` sets values", "写入请用 `drivebus write`"),
    ("status --drive fan-1", "give its address too, such as --service", "还须给出其地址，例如 --service"),
    ("status --service http://127.0.0.1:1 fan-1", "by name: --drive fan-1", "按名称识别变频器：--drive fan-1"),
    ("status --service 127.0.0.1:1 --drive fan-1", "expected http://HOST:PORT", "应为 http://HOST:PORT"),
    ("stop --service plant.toml --drive fan-1", "expected http://HOST:PORT", "应为 http://HOST:PORT"),
    ("run --service http://127.0.0.1:1 --drive fan-1", "--frequency is missing.", "缺少 --frequency。"),
    ("status c320@1 --model c320 --address 1", "; try sim://c320@1", "；试试 sim://c320@1"),
    ("status tcp:10.0.0.5:4001 --model c320 --address 1", "; try tcp://10.0.0.5:4001", "；试试 tcp://10.0.0.5:4001"),
    ("serve", "`drivebus init` writes the file of a plant.", "`drivebus init` 生成工厂配置文件。"),
    ("jog {drive} 5", "as an option: --frequency 25", "作为选项给出：--frequency 25"),
    ("scan sim://c320@1 --models c320 --addresses 8-1", "a range from low to high", "范围从小到大"),
    ("user add plant.toml", "behind the file of the plant: plant.toml anna", "写在工厂配置文件之后：plant.toml anna"),
    ("doctor", "Did you mean ports, check, acceptance?", "是否想用 ports、check、acceptance？"),
    ("describe c320", "Did you mean decode, models?", "是否想用 decode、models？"),
    ("trace sim://c320@1", "Did you mean monitor, capture?", "是否想用 monitor、capture？"),
    ("run {drive} --speed 10", "Did you mean --frequency?", "是否想用 --frequency？"),
    ("run {drive} --frequency 10 --direction back", "Did you mean --reverse?", "是否想用 --reverse？"),
    ("status sim://c320@1 --model c320 --slave 1", "Did you mean --address?", "是否想用 --address？"),
    ("stop --all --model c320 --address 1", "which bus or plant? Give a PORT", "哪条总线或哪个工厂？请给出 PORT"),
]


@pytest.mark.parametrize(("line", "english", "chinese"), SLIPS, ids=[line for line, _, _ in SLIPS])
def test_a_slip_of_the_command_line_is_answered_with_what_to_type(line: str, english: str, chinese: str) -> None:
    words = line.format(drive="sim://c320@1 --model c320 --address 1").split()
    result = run_words(words, "en")
    assert (result.exit_code, english in result.output) == (2, True), result.output
    assert chinese in run_words(words).output
