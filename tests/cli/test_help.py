"""Help of every command in both languages, with examples that parse."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator

import click
import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner

from drivebus import i18n, profiles
from drivebus.cli.click_ext import CliCommand, LazyGroup, Option
from drivebus.cli.main import SECTIONS, cli
from drivebus.cli.output import width
from drivebus.ports import parse_port_url
from drivebus.profiles import DriveProfile


def commands(group: LazyGroup = cli, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """Yield every command of the tree with its path."""
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        yield (*path, name), command
        if isinstance(command, LazyGroup):
            yield from commands(command, (*path, name))


TREE = list(commands())
IDS = [" ".join(path) for path, _ in TREE]


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize(("path", "command"), TREE, ids=IDS)
def test_every_command_has_help_with_an_example_in_both_languages(
    path: tuple[str, ...], command: click.Command, language: str
) -> None:
    result = CliRunner().invoke(cli, [*path, "--help", "--lang", language])
    assert result.exit_code == 0
    assert f"drivebus {path[0]}" in result.output
    assert not re.search(r"\b(help|cli)\.[a-z_]+", result.output), "a catalogue key without text"
    assert command.examples  # type: ignore[attr-defined]
    for example in command.examples:  # type: ignore[attr-defined]
        assert example in result.output
    assert ("示例" in result.output) == (language == "zh")


@pytest.mark.parametrize("path", [(), ("run",), ("user", "add")])
def test_the_usual_words_for_help_and_version_work(path: tuple[str, ...]) -> None:
    expected = CliRunner().invoke(cli, [*path, "--help", "--lang", "en"]).stdout
    for words in ([*path, "-h", "--lang", "en"], ["help", *path, "--lang", "en"]):
        assert CliRunner().invoke(cli, words).stdout == expected != ""
    assert CliRunner().invoke(cli, ["-V"]).stdout.startswith("drivebus ")
    assert json.loads(CliRunner().invoke(cli, ["--version", "--json"]).stdout).keys() == {"version"}


@pytest.mark.parametrize(("path", "command"), [(p, c) for p, c in TREE if isinstance(c, CliCommand)])
def test_every_example_parses(path: tuple[str, ...], command: CliCommand) -> None:
    for example in command.examples:
        words = shlex.split(example.partition(" >")[0])
        assert words[: len(path) + 1] == ["drivebus", *path]
        command.make_context("x", words[len(path) + 1 :])


LONG_EXAMPLES = {("comm-loss-test",), ("control", "request"), ("waive",)}
"""Commands of a service that need its URL, a drive and a reason or a frequency."""


@pytest.mark.parametrize(("path", "command"), [(p, c) for p, c in TREE if p not in LONG_EXAMPLES])
def test_an_example_fits_a_line_of_80_columns(path: tuple[str, ...], command: click.Command) -> None:
    for example in getattr(command, "examples", ()):
        assert len(f"  {example}") <= 80, example


SENDING = [
    (command, example)
    for _, command in TREE
    if isinstance(command, CliCommand) and any(param.name == "dry_run" for param in command.params)
    for example in command.examples
    if not any(word in example for word in (".dbcap --speed", "--service", "plant.toml", "--directory"))
]


@pytest.mark.parametrize("example", [example for _, example in SENDING])
def test_the_dry_run_of_every_example_that_sends_succeeds(example: str) -> None:
    result = CliRunner().invoke(
        cli, [*shlex.split(example)[1:], *(["--dry-run"] if "--dry-run" not in example else [])]
    )
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("path", [path for path, _ in TREE], ids=IDS)
def test_help_fits_a_terminal_of_eighty_cells(path: tuple[str, ...], language: str) -> None:
    result = CliRunner().invoke(cli, [*path, "--help", "--lang", language], env={"COLUMNS": "80"})
    heads = ("  drivebus ", "Usage:", "用法")
    too_wide = [line for line in result.output.splitlines() if width(line) > 80 and not line.startswith(heads)]
    assert too_wide == []


def test_the_language_option_is_accepted_before_and_after_the_command_and_after_help() -> None:
    pages = {
        CliRunner().invoke(cli, words).output
        for words in (["--lang", "zh", "stop", "--help"], ["stop", "--help", "--lang=zh"])
    }
    assert len(pages) == 1
    assert "停机" in pages.pop()


def test_the_locale_chooses_the_language_without_the_option() -> None:
    result = CliRunner().invoke(cli, ["--help"], env={"DRIVEBUS_LANG": "", "LC_ALL": "zh_CN.UTF-8"})
    assert "用法" in result.output


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["staus"], "没有命令 staus"),
        (["staus"], "是否想用 status"),
        (["status", "sim://c320@1", "--model", "c3200", "--address", "1"], "没有型号 c3200。相近：c320"),
        (["status", "--modle", "c320"], "没有选项 --modle"),
        (["status", "sim://c320@1", "--model", "c320"], "缺少 --address"),
        (["status", "sim://c320@1", "--model", "c320", "--address", "300"], "收到 300"),
        (["status", "sim://c320@1", "--model", "c320", "--address", "1", "--encoding", "x"], "ascii、hex、rtu"),
    ],
)
def test_a_usage_error_is_in_the_users_language_and_exits_with_2(words: list[str], text: str) -> None:
    result = CliRunner().invoke(cli, [*words, "--lang", "zh"])
    assert result.exit_code == 2
    assert text in result.output
    assert "--help" in result.output or "型号文件" in result.output


def test_a_usage_error_with_json_is_one_document() -> None:
    result = CliRunner().invoke(cli, ["status", "--json", "--model"])
    assert result.exit_code == 2
    assert json.loads(result.stdout)["exit"] == 2


SLOW_PACKAGES = tuple(f"drivebus.{name}" for name in ("drives", "bus", "ports", "simulator", "profiles"))


def modules_loaded_by(code: str) -> list[str]:
    code += "\nimport sys\nprint()\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()[-1].split()


def test_help_imports_no_slow_module() -> None:
    """The start-up time is measured by ``benchmarks/startup.py``."""
    loaded = modules_loaded_by(
        "import sys\n"
        "sys.argv = ['drivebus', '--help']\n"
        "from drivebus.cli.main import main\n"
        "try:\n    main()\nexcept SystemExit:\n    pass"
    )
    assert "drivebus.cli.main" in loaded
    slow = {"asyncio", "rich", "textual", "pydantic", "serialx", "tomllib"}
    assert [name for name in loaded if name.partition(".")[0] in slow] == []
    assert [name for name in loaded if name.startswith((*SLOW_PACKAGES, "drivebus.cli.commands."))] == []


def test_a_command_imports_the_bus_and_the_profiles_only_when_it_runs() -> None:
    """The completion of the shell imports the module of a command; ``acceptance`` extends a class of the bench."""
    modules = [place.partition(":")[0] for section in SECTIONS.values() for place in section.values()]
    loaded = modules_loaded_by("\n".join(f"import {name}" for name in modules if not name.endswith(".acceptance")))
    assert "drivebus.cli.commands.status" in loaded
    slow = [name for name in loaded if name.startswith(SLOW_PACKAGES)]
    assert slow == [], "import them in the function that needs them, or under TYPE_CHECKING"


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_each_shell_has_a_completion_script(shell: str) -> None:
    result = CliRunner().invoke(cli, ["completion", shell])
    assert result.exit_code == 0
    assert "_DRIVEBUS_COMPLETE" in result.output
    document = json.loads(CliRunner().invoke(cli, ["completion", shell, "--json"]).output)
    assert document["script"] in result.output


@pytest.mark.parametrize(
    ("words", "incomplete", "expected"),
    [
        (["stop"], "si", ("sim://", "plain")),
        (["init", "/dev/ttyUSB0"], "tc", ("tcp://", "plain")),
        (["status"], "/tmp/dri", ("/tmp/dri", "file")),
        (["stop", "--all"], "pl", ("pl", "file")),
        (["serve"], "pl", ("pl", "file")),
        (["run", "x", "--record"], "", ("", "file")),
        (["run", "x", "--model"], "c32", ("c320", "plain")),
        (["run", "x", "--model"], "./my", ("./my", "file")),
        (["scan", "x", "--models"], "vc660,c32", ("vc660,c320", "plain")),
    ],
)
def test_the_shell_completes_ports_models_and_files(
    words: list[str], incomplete: str, expected: tuple[str, str]
) -> None:
    """A plant file, a capture and a link to a pty were not completed at all."""
    found = ShellComplete(cli, {}, "drivebus", "_DRIVEBUS_COMPLETE").get_completions(words, incomplete)
    assert [(item.value, item.type) for item in found] == [expected]


def test_completion_lists_the_commands() -> None:
    env = {"_DRIVEBUS_COMPLETE": "bash_complete", "COMP_WORDS": "drivebus set", "COMP_CWORD": "1"}
    result = CliRunner().invoke(cli, [], prog_name="drivebus", env=env)
    assert "set-frequency" in result.output


def test_no_option_type_of_click_can_reject_a_value() -> None:
    """Errors of click's own types are English only; text, flags and any path are never rejected."""
    types = {param.name: param.type for _, command in TREE for param in command.params}
    never_rejecting = (click.types.StringParamType, click.types.BoolParamType)
    left = {
        name: option_type for name, option_type in types.items() if type(option_type).__module__.startswith("click.")
    }
    refusing = {
        name
        for name, option_type in left.items()
        if not isinstance(option_type, never_rejecting) and not _accepts_every_path(option_type)
    }
    assert refusing == set()


def _accepts_every_path(type_: object) -> bool:
    return isinstance(type_, click.Path) and type_.file_okay and type_.dir_okay and not type_.exists


def _has_loopback(profile: DriveProfile) -> bool:
    return profile.modbus is not None and profile.modbus.loopback


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize(
    ("key", "has_it"),
    [
        ("help.pause.long", lambda profile: "pause" in profile.capabilities),
        ("help.hold-ramp.long", lambda profile: "hold_ramp" in profile.capabilities),
        ("help.loopback.long", _has_loopback),
        ("help.option.stop_quick", lambda profile: "quick_stop" in profile.capabilities),
        ("help.stop.long", lambda profile: "status" not in profile.capabilities),
    ],
)
def test_the_models_that_a_help_names_are_all_that_have_it_or_called_examples(
    key: str, has_it: Callable[[DriveProfile], bool], language: str
) -> None:
    """The loop-back test of six models and the quick stop of 23 read as those of one and of two."""
    having = {name for name in profiles.models() if has_it(profiles.load(name))}
    sentence = i18n.text(key, language)
    named = {word.lower() for word in re.findall(r"(?<![A-Za-z0-9])[A-Z]+[0-9]{2,4}(?![A-Za-z0-9])", sentence)}
    named &= set(profiles.models())
    assert named and named <= having
    assert named == having or re.search("such as|例如", sentence)


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize(("path", "command"), TREE, ids=IDS)
def test_only_a_command_with_a_port_takes_a_default_from_it(
    path: tuple[str, ...], command: click.Command, language: str
) -> None:
    """``simulate`` makes its port itself; its help had the baud rate of ``the PORT`` as the default."""
    has_port = any("PORT" in (param.metavar or "") for param in command.params if isinstance(param, click.Argument))
    texts = {i18n.text(f"help.option.{name}", language) for name in ("baud", "format")}
    shown = {option.help_text() for option in command.params if isinstance(option, Option)}
    assert has_port or not texts & shown


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_service_without_a_drive_is_answered_with_where_its_drives_are_listed(language: str) -> None:
    words = ["status", "--service", "http://127.0.0.1:1", "--lang", language]
    result = CliRunner().invoke(cli, words)
    assert i18n.text("hint.service.no_drive", language) in result.stderr
    assert "drivebus monitor --service" in result.stderr


@pytest.mark.parametrize("language", ["en", "zh"])
def test_a_damaged_reply_is_answered_with_a_second_master_and_the_setting_for_an_adapter_that_echoes(
    language: str,
) -> None:
    """A VC660 behind one was answered with its wiring, and nothing named ``echo=on``, which makes it answer."""
    hint = i18n.text("hint.damaged_reply", language)
    assert {"en": "second master", "zh": "另一个主站"}[language] in hint
    url = re.search(r"serial:///[^)）\s]+", hint)
    assert url is not None
    assert parse_port_url(url[0]).options == {"echo": "on"}


@pytest.mark.parametrize(
    ("words", "shown"),
    [
        ("user token", ["default: view; e.g. --right", "default: 90; e.g. --days"]),
        ("loopback", ["default: 10; e.g. --count"]),
        ("scan", ["default: 2; e.g. --listen-seconds"]),
        ("demo", ["default: 8080; e.g. --port"]),
        ("acceptance", ["default: 5; e.g. --frequency", "default: .; e.g. --folder"]),
    ],
)
def test_the_help_of_an_option_has_the_value_that_it_has_without_it(words: str, shown: list[str]) -> None:
    """A token was made for 90 days and one right, and a scan listened for 2 s, without a word about it."""
    text = " ".join(CliRunner().invoke(cli, [*words.split(), "--help", "--lang", "en"]).output.split())
    assert all(part in text for part in shown)
    zh = CliRunner().invoke(cli, [*words.split(), "--help", "--lang", "zh"]).output
    assert "".join(zh.split()).count("默认") >= len(shown)


@pytest.mark.parametrize(
    ("language", "words"), [("en", "addresses without a reply are counted"), ("zh", "无应答的站号只计数")]
)
def test_the_help_of_stop_does_not_promise_a_confirmation_of_addresses_without_a_reply(
    language: str, words: str
) -> None:
    """``stop --all PORT`` was to list each address that does not report stopped; it counts those without a reply."""
    assert words in i18n.text("help.stop.long", language)
