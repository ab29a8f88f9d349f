"""Mistakes and terminals of a first day: each answer names what to type, and fits the terminal."""

from __future__ import annotations

import logging
import logging.handlers
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest
from click.testing import CliRunner, Result

from drivebus import i18n
from drivebus.__main__ import main as start_command_line
from drivebus.cli import output
from drivebus.cli.commands import serve
from drivebus.cli.demo import host
from drivebus.cli.errors import ExitCode
from drivebus.cli.main import cli
from drivebus.cli.tui import plain, view
from drivebus.service.process import logging_setup
from fixtures.service import SHOP_FILE

pytestmark = pytest.mark.usefixtures("commands_in_virtual_time")


def command(*words: str) -> Result:
    return CliRunner().invoke(cli, [*words, "--lang", "en"])


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("sunfar", "Similar: c300, c320, e300,"),
        ("Mitsubishi", "fr_a500, fr_a700, fr_d700,"),
        ("英威腾", "Similar: che100, chf100a, gd10,"),
        ("xyzzy", "there is no model xyzzy. `drivebus models --search WORD` finds one"),
    ],
)
def test_a_maker_in_place_of_a_model_is_answered_with_its_models(name: str, shown: str) -> None:
    """Regression: the answer was ``Similar: -.``"""
    result = command("status", "sim://c320@1", "--model", name, "--address", "1")
    assert result.exit_code == 2 and shown in result.stderr, result.stderr


@pytest.mark.parametrize(("language", "words"), [("en", "sync probe"), ("zh", "同步探测")])
def test_a_wrong_address_is_answered_without_a_word_of_the_glossary(language: str, words: str) -> None:
    """The message named the *sync probe*, which a newcomer must look up."""
    arguments = ["status", "sim://c320@1", "--model", "c320", "--address", "5", "--lang", language]
    result = CliRunner().invoke(cli, arguments)
    assert result.exit_code != 0 and i18n.text("hint.bus.offline", language)[:30] in result.stderr
    assert words not in result.stderr


@pytest.mark.parametrize("typed", ["sim：//c320@1", "ｓｉｍ：／／c320@1"])
def test_a_port_in_full_width_characters_is_suggested_in_half_width_ones(typed: str) -> None:
    """Regression: ``drivebus ports`` was suggested, and the typed text as the name of a service's drive."""
    result = command("status", typed, "--model", "c320", "--address", "1")
    assert "try sim://c320@1\n" in result.stderr and "--service" not in result.stderr


def test_a_missing_option_is_explained_as_in_the_help() -> None:
    """Regression: the roles that --role takes were only in the help."""
    result = command("user", "add", "plant.toml", "ann")
    assert result.exit_code == 2 and i18n.text("help.option.role", "en") in result.stderr


@pytest.mark.parametrize(
    ("typed", "meant"), [("start", "run"), ("estop", "stop"), ("version", "--version"), ("list", "models, ports")]
)
def test_the_word_of_another_program_leads_to_the_command(typed: str, meant: str) -> None:
    """Regression: ``start`` was answered with ``status``."""
    assert f"Did you mean {meant}?" in command(typed).stderr
    assert f"Did you mean {meant}?" not in command("user", typed).stderr


def test_a_missing_password_is_answered_with_where_it_is_read(tmp_path: Path) -> None:
    """Regression: the answer was the length of a password, which nobody had asked for."""
    plant = tmp_path / "plant.toml"
    plant.write_text('format = 1\n[plant]\nid = "p"\ndirectory = "state"\n', encoding="utf-8")
    result = command("user", "add", str(plant), "ann", "--role", "viewer")
    assert (result.exit_code, i18n.text("user_command.no_password", "en") in result.stderr) == (2, True)


def test_a_search_without_a_model_leads_on_and_explains_no_grades() -> None:
    result = command("models", "--search", "no such make")
    shown = " ".join(result.stdout.split())
    assert shown == i18n.text("models.none", "en", search="no such make") and "profile new" in shown


@pytest.mark.parametrize("name", ["serve", "check"])
def test_a_missing_plant_file_is_answered_with_the_command_that_writes_one(name: str, tmp_path: Path) -> None:
    """The remedy was only to check the path, also for a plant that has no file yet."""
    result = command(name, str(tmp_path / "plant.toml"))
    assert result.exit_code == ExitCode.USAGE
    assert "no such file" in result.stderr and "`drivebus init` writes a new plant.toml" in result.stderr


def test_an_ended_dialogue_without_an_answer_leaves_no_file(tmp_path: Path) -> None:
    """Regression: a file of 0 answers was written."""
    result = command("profile", "new", str(tmp_path / "acme.toml"))
    assert result.exit_code == 130 and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("terminal", ["dumb", "", None])
def test_a_terminal_without_a_cursor_gets_plain_lines(monkeypatch: pytest.MonkeyPatch, terminal: str | None) -> None:
    """Regression: the full-screen view filled a dumb terminal with control characters."""
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    monkeypatch.delenv("TERM", raising=False)
    if terminal is not None:
        monkeypatch.setenv("TERM", terminal)

    async def print_plain(*_: object) -> ExitCode:
        return ExitCode.FAILED

    monkeypatch.setattr(view, "_run_plain", print_plain)
    assert view.run_view(None, None, plain=False, period_s=1.0) is ExitCode.FAILED  # type: ignore[arg-type]


def test_a_dry_run_fits_a_narrow_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(output, "wrap_for", lambda text, _, indent=0: f"{' ' * indent}[{text}]")
    words = ("run", "sim://c320@1", "--model", "c320", "--address", "1", "--frequency", "10", "--dry-run")
    lines = command(*words).stdout.splitlines()
    assert sum(line.startswith("  [2A ") for line in lines) == 3 == sum(line.endswith(" ms]") for line in lines)


def test_the_notes_of_a_plain_view_fit_a_narrow_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Source:
        @staticmethod
        def messages() -> list[str]:
            return ["Only reads are sent."]

    monkeypatch.setattr(output, "wrap_for", lambda text, *_: f"[{text}]")
    source: Any = Source()
    assert plain._print_new_messages(source, 0) == 1
    assert capsys.readouterr().out == "[Only reads are sent.]\n"


def test_the_log_of_the_demo_is_in_the_language_of_the_command_and_leaves_no_drive_running(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Regression: ``drivebus demo --lang zh`` logged in English, and warned at Ctrl-C of drives that ended with it.

    Its first line was the checkpoint of an audit trail that ends with it too.
    """
    handler = logging.handlers.BufferingHandler(100)
    for name in ("drivebus", None):
        log = logging.getLogger(name)
        monkeypatch.setattr(log, "handlers", log.handlers)
        monkeypatch.setattr(log, "propagate", log.propagate)
        caplog.set_level(log.level, name)  # set again after the test
    monkeypatch.setattr(logging_setup, "NonBlockingQueueHandler", lambda lines: handler)
    monkeypatch.setattr(logging_setup, "QueueListener", Mock())
    monkeypatch.setattr(logging_setup.atexit, "register", lambda *_: None)
    monkeypatch.setenv(i18n.LANGUAGE_VARIABLE, "en")
    monkeypatch.setattr(host.signal, "signal", lambda *_: None)

    async def log_events(*_: object) -> ExitCode:
        for kind in ("stop", "not_stopped", "checkpoint"):
            logging_setup.log_event({"kind": kind, "drive": "pump-1", "text": {"en": f"en {kind}", "zh": f"zh {kind}"}})
        return ExitCode.DONE

    monkeypatch.setattr(host, "_run_with_page", log_events)
    assert CliRunner().invoke(cli, ["demo", "--lang", "zh"]).exit_code == 0
    assert [record.getMessage() for record in handler.buffer] == ["zh stop"]


@pytest.mark.parametrize(("at_terminal", "left_out"), [(True, ("checkpoint",)), (False, ())])
def test_serve_at_a_terminal_begins_with_the_address_and_not_with_a_checkpoint(
    at_terminal: bool, left_out: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A line of 64 digits stood before the address of the page; a log that is kept has it."""
    calls: list[Any] = []
    monkeypatch.setattr(logging_setup, "configure_logging", lambda *_, **options: calls.append(options))
    monkeypatch.setattr(serve, "sys", SimpleNamespace(stderr=SimpleNamespace(isatty=lambda: at_terminal)))
    monkeypatch.setattr(serve, "_run", lambda *_: None)
    monkeypatch.setattr(serve.asyncio, "run", lambda _: ExitCode.DONE)
    monkeypatch.setattr(serve.signal, "signal", lambda *_: None)
    plant = tmp_path / "plant.toml"
    plant.write_text(SHOP_FILE)
    assert serve._serve(str(plant), ("web",), "text") is ExitCode.DONE
    assert calls == [{"without_events": left_out}]


@pytest.mark.parametrize("wrapped", [False, True])
def test_ctrl_c_while_the_command_line_is_loaded_ends_it_without_a_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], wrapped: bool
) -> None:
    """Python 3.11 wraps it where it falls into the making of a class."""

    class Loading(ModuleType):
        def __getattr__(self, name: str) -> Any:
            if wrapped:
                raise RuntimeError("Error calling __set_name__") from KeyboardInterrupt()
            raise KeyboardInterrupt

    monkeypatch.setitem(sys.modules, "drivebus.cli.main", Loading("drivebus.cli.main"))
    with pytest.raises(SystemExit) as ended:
        start_command_line()
    assert ended.value.code == ExitCode.INTERRUPTED
    assert "nothing was sent, no stop either" in capsys.readouterr().err


@pytest.mark.parametrize("module", ["drivebus.cli.extras", "drivebus.errors", "drivebus.terminal", "drivebus.cli.main"])
@pytest.mark.parametrize("language", ["en", "zh"])
def test_ctrl_c_in_the_first_moment_of_a_command_ends_it_without_a_traceback(module: str, language: str) -> None:
    """In the first tenth of a second, and in a whole one on a busy computer, it did."""
    program = f"""
import sys
class Interrupting:
    def find_spec(self, name, *_):
        if name == {module!r}:
            sys.meta_path.remove(self)
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupting())
sys.argv[1:] = ["stop", "--lang", {language!r}]
from drivebus.__main__ import main
main()
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (ExitCode.INTERRUPTED, "")
    assert ended.stderr.strip() == i18n.text("cli.interrupted_early", language)


def test_an_error_while_the_command_line_is_loaded_is_not_reported_as_ctrl_c(monkeypatch: pytest.MonkeyPatch) -> None:
    class Broken(ModuleType):
        def __getattr__(self, name: str) -> Any:
            raise RuntimeError("broken")

    monkeypatch.setitem(sys.modules, "drivebus.cli.main", Broken("drivebus.cli.main"))
    with pytest.raises(RuntimeError, match="broken"):
        start_command_line()
