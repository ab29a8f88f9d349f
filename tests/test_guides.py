"""Tutorials, how-to and explanation pages: in both languages, links lead to files, commands parse, programs run."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import click
import pytest

from drivebus import profiles
from drivebus.cli.click_ext import LazyGroup
from drivebus.cli.main import cli
from test_examples import run

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGES = sorted(page for folder in ("tutorials", "how-to", "explanation") for page in (DOCS / folder).glob("*.md"))
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
NAMES = [f"{page.parent.name}/{page.name}" for page in PAGES]


def blocks(page: Path) -> list[tuple[str, str]]:
    return FENCE.findall(page.read_text(encoding="utf-8"))


def command_lines(page: Path, kind: str | None = None) -> list[list[str]]:
    """Return the ``drivebus`` commands of a page; those in blocks marked ``sh`` need no hardware."""
    texts = [text for language, text in blocks(page) if language in ("", "sh") and kind in (None, language)]
    lines = [line for text in texts for line in text.splitlines() if line.startswith("drivebus ") and "…" not in line]
    return [shlex.split(line, comments=True) for line in lines]


def check(words: list[str]) -> None:
    """Parse a command line. Raises click's error where it is wrong."""
    command: click.Command = cli
    position = 1
    while isinstance(command, LazyGroup):
        found = command.get_command(click.Context(command), words[position])
        assert found is not None, words
        command, position = found, position + 1
    command.make_context("x", words[position:])


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_a_page_exists_in_both_languages_and_names_the_other(page: Path) -> None:
    other = page.name.replace(".zh.md", ".md") if page.name.endswith(".zh.md") else page.name.replace(".md", ".zh.md")
    assert (page.parent / other).is_file()
    assert f"]({other})" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_every_link_leads_to_an_existing_file(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    targets = {target.partition("#")[0] for target in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in target}
    assert [target for target in targets if target and not (page.parent / target).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_every_command_line_of_a_page_parses(page: Path) -> None:
    for words in command_lines(page):
        check(words)


RUNNING = [(page, words) for page in PAGES if ".zh" not in page.name for words in command_lines(page, "sh")]


@pytest.mark.parametrize(("page", "words"), RUNNING, ids=[" ".join(words[1:3]) for _, words in RUNNING])
def test_a_command_that_needs_no_hardware_runs(page: Path, words: list[str], tmp_path: Path) -> None:
    command = [sys.executable, "-m", "drivebus", *words[1:]]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=90, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_the_commands_that_run_are_the_same_in_both_languages(page: Path) -> None:
    other = page.with_name(page.name.replace(".zh.md", ".md"))
    assert command_lines(page, "sh") == command_lines(other, "sh")


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_programs_and_profiles_of_a_page_work(page: Path, tmp_path: Path) -> None:
    for language, text in blocks(page):
        if language == "python":
            assert "confirmed" in run(text)
        if language == "toml" and "extends" in text:
            own = tmp_path / "own.toml"
            own.write_text(text, encoding="utf-8")
            assert profiles.load(own).source == str(own)
