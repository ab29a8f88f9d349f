"""A stop is sent without a home and in an unknown language; where it can't be, the error says what stops the drive."""

from __future__ import annotations

import sys
from itertools import count
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner, Result

from drivebus.cli.click_ext import CliCommand
from drivebus.cli.errors import ExitCode
from drivebus.cli.main import cli
from drivebus.errors import PermissionDenied, ServiceUnavailable
from drivebus.i18n import LANGUAGE_VARIABLE

C320 = ("sim://c320@1", "--model", "c320", "--address", "1")
VC660 = ("sim://vc660@1", "--model", "vc660", "--address", "1")
NOT_SENT = "NO STOP WAS SENT. Stop the drive now at its keypad or by its hard-wired stop."


pytestmark = pytest.mark.usefixtures("clean_simulated_buses")


def invoke(*words: str, lang: str = "en") -> Result:
    return CliRunner().invoke(cli, [*words, "--lang", lang])


@pytest.mark.skipif(sys.platform == "win32", reason="accounts of POSIX")
@pytest.mark.parametrize(
    "words", [("stop", *C320), ("stop", "--all", *C320), ("coast", *VC660)], ids=lambda words: " ".join(words[:2])
)
def test_a_user_without_a_home_can_stop(monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]) -> None:
    """A container that runs as a number without an account ended each command with a traceback."""
    import pwd

    def no_account(uid: int) -> Any:
        raise KeyError(uid)

    for name in ("HOME", "XDG_STATE_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(pwd, "getpwuid", no_account)
    with pytest.raises(RuntimeError):
        Path.home()
    result = invoke(*words)
    assert (result.exit_code, "onfirmed" in result.stdout) == (0, True), result.exception


@pytest.mark.parametrize(
    "words",
    [
        ("stop",),
        ("stop", *C320, "--adress", "1"),
        ("stop", "sim://c320@1", "--model", "c320", "--address", "31"),
        ("stop", *C320, "--baud", "fast"),
        ("stop", "sim://c321@1", "--model", "c321", "--address", "1"),
        ("stop", "plant.toml"),
        ("stop", "--all", "no-plant.toml"),
        ("stop", "--all", "sim://c320@1", "--model", "c320", "--address", "31"),
        ("stop", "--service", "host:8080", "--drive", "fan-1"),
        ("stop", "--group", "fans"),
        ("coast", "sim://vc660@1"),
        ("halt", *C320),
        ("stpo", *C320),
        ("coast", *VC660, "--drive", "fan-1"),
        ("coast", "sim://nothing@1", "--model", "~no-account/own.toml", "--address", "1"),
    ],
    ids=lambda words: " ".join(words),
)
def test_a_stop_that_ends_with_2_says_that_none_was_sent_and_what_stops_the_drive(words: tuple[str, ...]) -> None:
    """The error was named, but not that the motor turns on."""
    result = invoke(*words)
    assert result.exit_code == ExitCode.USAGE
    assert NOT_SENT in result.stderr.splitlines()[-1]
    assert result.stderr.count("NO STOP WAS SENT") == 1
    assert "未发送停机命令" in invoke(*words, lang="zh").stderr


@pytest.mark.parametrize("content", [None, b"\xff", b"[plant", b"[plant]\nid = 3\n"])
def test_a_plant_file_without_use_names_the_stops_that_need_none(tmp_path: Path, content: bytes | None) -> None:
    plant = tmp_path / "plant.toml"
    if content is not None:
        plant.write_bytes(content)
    result = invoke("stop", "--all", str(plant))
    assert result.exit_code == ExitCode.USAGE
    assert "`drivebus stop --all PORT --model MODEL`" in result.stderr
    assert NOT_SENT in result.stderr.splitlines()[-1]


@pytest.mark.parametrize("words", [("stop", *C320), ("stop", "--all", *C320), ("coast", *VC660)], ids=" ".join)
def test_no_stop_is_sent_where_a_users_file_has_the_name_of_the_model(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, words: tuple[str, ...]
) -> None:
    """Which of the two the user means is not known, and the command word that stops one drive may start another."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    folder = tmp_path / "drivebus" / "profiles"
    folder.mkdir(parents=True)
    for name in ("c320", "vc660"):
        (folder / f"{name}.toml").write_text('format = 1\nextends = "df800"\n')
    result = invoke(*words)
    assert (result.exit_code, result.stdout) == (ExitCode.USAGE, "")
    assert str(folder) in result.stderr and "rename the file" in result.stderr
    assert NOT_SENT in result.stderr.splitlines()[-1]


def test_a_stop_that_a_service_refuses_says_that_none_was_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> Any:
        raise PermissionDenied("auth.no_right", right="operate")

    monkeypatch.setattr("drivebus.cli.remote.client.call_once", refuse)
    result = invoke("stop", "--service", "http://127.0.0.1:8080", "--all")
    assert result.exit_code == ExitCode.FAILED
    assert NOT_SENT in result.stderr


def test_a_service_that_may_have_sent_the_stop_is_not_reported_as_one_that_did_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def lose(*_: object) -> Any:
        raise ServiceUnavailable("service.no_service", service="http://127.0.0.1:8080")

    monkeypatch.setattr("drivebus.cli.remote.client.call_once", lose)
    result = invoke("stop", "--service", "http://127.0.0.1:8080", "--all")
    assert result.exit_code == ExitCode.UNKNOWN
    assert NOT_SENT not in result.stderr


@pytest.mark.parametrize(
    "words",
    [("stop", *C320), ("--lang", "fr", "stop", *C320), ("stop", "--all", *C320), ("coast", *VC660)],
    ids=lambda words: " ".join(words[:3]),
)
def test_a_stop_in_an_unknown_language_is_sent_in_the_preferred_one(
    monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    """``--lang fr`` left the motor running."""
    monkeypatch.setenv(LANGUAGE_VARIABLE, "zh")
    result = CliRunner().invoke(cli, [*words, *(() if "--lang" in words else ("--lang", "fr"))])
    assert (result.exit_code, "确认" in result.stdout) == (0, True), result.output
    assert result.stderr.splitlines()[-1] == "语言不明：--lang：收到 fr，应为：en、zh 之一"


@pytest.mark.parametrize(
    ("options", "note"),
    [
        ("--lang fr --lang en", "Language unclear: --lang: given more than once (fr, en)"),
        ("--lang en --lang zh", "语言不明：--lang：重复给出（en、zh）"),
        ("--lang", "Language unclear: --lang needs a value"),
        ("--lang --json", "Language unclear: --lang needs a value"),
        ("--lang=", "Language unclear: --lang: found"),
        ("--json --json", ""),
        ("--json=yes", "Ignored: --json takes no value"),
        ("--record a.dbcap --record b.dbcap", "Not recorded: --record: given more than once (a.dbcap, b.dbcap)"),
        ("--record", "Not recorded: --record needs a value"),
        ("--record --json", "Not recorded: --record needs a value"),
        ("--record --lang --json=1", "Not recorded: --record needs a value"),
        ("--record no-folder/a.dbcap", "Not recorded: no-folder/a.dbcap"),
        ("--record a.txt", "Not recorded: --record: found a.txt"),
    ],
)
@pytest.mark.parametrize("words", [("stop", *C320), ("stop", "--all", *C320)], ids=("one drive", "all drives"))
def test_no_option_of_the_output_prevents_a_stop(
    words: tuple[str, ...], options: str, note: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A repeated ``--lang`` or ``--record``, or one without a value, left the motor running."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(LANGUAGE_VARIABLE, "en")
    result = CliRunner().invoke(cli, [*words, *options.split()])
    assert result.exit_code == 0, result.output
    assert any(word in result.stdout for word in ("onfirm", "确认"))
    assert note in result.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("words", [("reset", *C320, "--lang", "fr"), ("--lang", "fr", "reset", *C320)])
def test_a_command_that_stops_nothing_is_refused_in_an_unknown_language(words: tuple[str, ...]) -> None:
    result = CliRunner().invoke(cli, words)
    assert (result.exit_code, result.stdout) == (ExitCode.USAGE, "")
    assert "--lang" in result.stderr.splitlines()[0]


@pytest.mark.parametrize("words", [("status", "sim://c320@1"), ("reset", *C320, "--adress", "1")])
def test_a_command_that_stops_nothing_says_nothing_of_a_stop(words: tuple[str, ...]) -> None:
    result = invoke(*words)
    assert result.exit_code == ExitCode.USAGE
    assert NOT_SENT not in result.stderr


def test_ctrl_c_before_a_stop_has_begun_says_that_none_was_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    """It ended with 130 and an empty line."""

    def interrupt(*_: object, **__: object) -> click.Context:
        raise KeyboardInterrupt

    monkeypatch.setattr(CliCommand, "make_context", interrupt)
    result = invoke("stop", *C320)
    assert result.exit_code == ExitCode.INTERRUPTED
    assert "nothing was sent, no stop either" in result.stderr


def test_ctrl_c_during_a_command_is_not_reported_as_one_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object, **__: object) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr("drivebus.cli.commands.models.command.callback", interrupt)
    result = invoke("models")
    assert result.exit_code == ExitCode.INTERRUPTED
    assert "nothing was sent" not in result.stderr


@pytest.mark.parametrize(
    ("words", "code", "sentence"),
    [
        (("stop", "/dev/ttyNone", *C320[1:]), ExitCode.UNKNOWN, "STOP NOT SENT"),
        (("stop", *C320, "--adress", "1"), ExitCode.USAGE, NOT_SENT),
    ],
)
@pytest.mark.parametrize("interrupted", [1, 2, 3])
def test_ctrl_c_while_an_error_is_printed_neither_loses_it_nor_ends_in_a_traceback(
    monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], code: ExitCode, sentence: str, interrupted: int
) -> None:
    """A second Ctrl-C as the sentence came ended an attached run with a traceback and another exit code."""
    prints, echo = count(1), click.echo

    def echo_interrupted(*given: Any, **named: Any) -> None:
        if next(prints) == interrupted:
            raise KeyboardInterrupt
        echo(*given, **named)

    monkeypatch.setattr(click, "echo", echo_interrupted)
    try:
        result = invoke(*words)
    except KeyboardInterrupt:
        pytest.fail("Ctrl-C ended the command while its error was printed")
    assert result.exit_code == code
    assert sentence in result.stderr
