"""Output on a terminal whose encoding lacks characters of the texts."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

STATUS = ("status", "sim://c320@1", "--model", "c320", "--address", "1")


def run(*words: str, command: tuple[str, ...] = STATUS, **environment: str) -> subprocess.CompletedProcess[bytes]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("LC_", "LANG", "DRIVEBUS_LANG"))}
    arguments = [sys.executable, "-m", "drivebus", *command, *words]
    return subprocess.run(arguments, capture_output=True, env=kept | environment, check=True)


@pytest.mark.parametrize("encoding", ["latin-1", "cp866"])
def test_a_terminal_without_utf_8_shows_plain_characters_and_json_their_escapes(encoding: str) -> None:
    r"""A missing value was ``\u2013`` there, and each ``…`` of a message ``\u2026``."""
    shown = run("--lang", "en", PYTHONIOENCODING=encoding)
    [line] = [line for line in shown.stdout.decode(encoding).splitlines() if line.startswith("set_frequency")]
    assert " - " in line and b"\\u" not in shown.stdout and shown.stderr == b""
    document = run("--lang", "zh", "--json", PYTHONIOENCODING=encoding)
    reading = json.loads(document.stdout.decode(encoding))["readings"]["set_frequency"]
    assert reading["value"] is None and any("该型号" in str(value) for value in reading.values())
    assert document.stderr == b""


@pytest.mark.parametrize(
    ("encoding", "environment"),
    [
        ("ascii", {"PYTHONIOENCODING": "ascii"}),
        ("big5", {"PYTHONIOENCODING": "big5"}),  # it has other characters than the texts
        ("ascii", {"LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}),
    ],
)
def test_a_terminal_without_chinese_characters_shows_english_and_says_once_how_to_set_it(
    encoding: str, environment: dict[str, str]
) -> None:
    r"""Chinese texts were lines of ``\u8bbe\u5b9a``."""
    english = run("--lang", "en", **environment)
    for words, chosen in ((("--lang", "zh"), {}), ((), {"DRIVEBUS_LANG": "zh"})):
        shown = run(*words, **environment, **chosen)
        assert without_digits(shown.stdout) == without_digits(english.stdout)
        [note] = shown.stderr.decode(encoding).lower().splitlines()
        assert f"the encoding of this output, {encoding}, has no chinese" in note and "pythonioencoding=utf-8" in note


@pytest.mark.parametrize("environment", [{"LANG": "C"}, {"PYTHONIOENCODING": "utf-8"}, {"PYTHONIOENCODING": "gbk"}])
def test_a_terminal_with_chinese_characters_shows_chinese(environment: dict[str, str]) -> None:
    """Python prints UTF-8 in the locale C too."""
    shown = run("--lang", "zh", **environment)
    assert "输出频率" in shown.stdout.decode(environment.get("PYTHONIOENCODING", "utf-8")) and shown.stderr == b""


def test_a_file_keeps_the_chosen_language_whatever_the_encoding_of_the_terminal(tmp_path: Path) -> None:
    """A plant file was written in English."""
    file = tmp_path / "plant.toml"
    scan = ("init", "sim://c320@1", "--scan", "-o", str(file))
    written = run("--lang", "zh", command=scan, PYTHONIOENCODING="ascii")
    assert written.stdout.isascii() and "我的工厂" in file.read_text(encoding="utf-8")


def test_a_completion_is_not_preceded_by_the_note_on_the_encoding() -> None:
    asked = {"_DRIVEBUS_COMPLETE": "bash_complete", "COMP_WORDS": "drivebus sta", "COMP_CWORD": "1"}
    shown = run(PYTHONIOENCODING="ascii", DRIVEBUS_LANG="zh", **asked)
    assert (shown.stdout, shown.stderr) == (b"plain,status\n", b"")


def without_digits(text: bytes) -> bytes:
    """Return a text without its measured values."""
    return re.sub(rb"[0-9]+", b"", text)
