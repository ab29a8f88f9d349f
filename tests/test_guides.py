"""Tutorials, how-to and explanation pages: in both languages, links lead to files, commands parse, programs run."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import click
import pytest

from drivebus import profiles
from drivebus.cli.click_ext import LazyGroup
from drivebus.cli.main import cli
from test_examples import run_block

README = Path(__file__).resolve().parents[1] / "README.md"
DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGES = sorted(page for folder in ("tutorials", "how-to", "explanation") for page in (DOCS / folder).glob("*.md"))
pytestmark = pytest.mark.xdist_group("commands")
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
AGE = re.compile(r"\b\d\.\d\d s\b")
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


MENTIONED = re.compile(r"`drivebus ([a-z]+(?:-[a-z]+)*)(?: ([a-z]+))?[^`]*`")
EVERY_PAGE = [*DOCS.rglob("*.md"), *(DOCS.parent / name for name in ("README.md", "README.zh.md", "CONTRIBUTING.md"))]


def is_command(name: str, further: str) -> bool:
    """Return whether a command exists; ``further`` is its subcommand where it is a group."""
    command = cli.get_command(click.Context(cli), name)
    if isinstance(command, LazyGroup) and further:
        return command.get_command(click.Context(command), further) is not None
    return command is not None


def test_every_command_that_a_page_mentions_exists() -> None:
    """Regression: the page on security named ``drivebus user code``."""
    found = {
        (page.name, *words) for page in EVERY_PAGE for words in MENTIONED.findall(page.read_text(encoding="utf-8"))
    }
    assert len(found) > 100
    assert sorted(mention for mention in found if not is_command(*mention[1:])) == []


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_a_page_adds_the_user_whose_token_it_makes(page: Path) -> None:
    """Regression: the token of a user ``prometheus`` who did not exist."""
    text = page.read_text(encoding="utf-8")
    assert set(re.findall(r"drivebus user token \S+ (\w+)", text)) <= set(
        re.findall(r"drivebus user add \S+ (\w+)", text)
    )


def run_in_fresh_shell(script: str, home: Path) -> str:
    """Run commands one after another as a newcomer does, in an empty folder; return what they print."""
    path = f"{Path(sys.executable).parent}:/usr/bin:/bin"
    environment = {"PATH": path, "HOME": str(home), "LANG": "C.UTF-8"}
    done = subprocess.run(
        ["sh", "-e", "-c", script], cwd=home, env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


RUNNING = [page for page in PAGES if ".zh" not in page.name and command_lines(page, "sh")]


@pytest.mark.parametrize("page", RUNNING, ids=[page.name for page in RUNNING])
def test_the_commands_of_a_page_that_need_no_hardware_run_in_their_order(page: Path, tmp_path: Path) -> None:
    printed = run_in_fresh_shell("\n".join(text for language, text in blocks(page) if language == "sh"), tmp_path)
    if page.name == "first-bus.md":
        assert "HAZARD" in printed, "the manual's read example starts the motor"


@pytest.mark.parametrize("name", ["first-bus.md", "first-bus.zh.md"])
def test_the_status_that_the_first_tutorial_shows_is_what_its_command_prints(name: str, tmp_path: Path) -> None:
    printed = blocks(DOCS / "tutorials" / name)
    (_, command), (_, status) = next(pair for pair in pairwise(printed) if pair[0][1].startswith("drivebus status"))
    language = "zh" if ".zh" in name else "en"
    assert AGE.sub("AGE", status) == AGE.sub(
        "AGE", run_in_fresh_shell(f"{command.strip()} --lang {language}", tmp_path)
    )


@pytest.mark.parametrize("page", [README, README.with_name("README.zh.md")], ids=["en", "zh"])
def test_the_commands_of_the_readme_parse_and_those_that_only_look_run(page: Path, tmp_path: Path) -> None:
    lines = command_lines(page)
    for words in lines:
        check(words)
    looking = [words for words in lines if words[1] in ("ports", "status", "decode")]
    script = "\n".join(shlex.join(words) for words in looking).replace("/dev/ttyUSB0", "sim://c320@3")
    printed = run_in_fresh_shell(script, tmp_path)
    assert len(looking) == 3 and "537 V" in printed and "HAZARD" in printed


def test_the_readme_tells_where_the_demo_puts_the_command() -> None:
    assert ".venv/bin/drivebus" in README.read_text(encoding="utf-8")
    assert "BIN := $(VENV)/bin" in (README.parent / "Makefile").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_the_commands_that_run_are_the_same_in_both_languages(page: Path) -> None:
    other = page.with_name(page.name.replace(".zh.md", ".md"))
    assert command_lines(page, "sh") == command_lines(other, "sh")


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_programs_and_profiles_of_a_page_work(page: Path, tmp_path: Path) -> None:
    for language, text in blocks(page):
        if language == "python" and "/api/v1" not in text:  # those run against a service: test_api_guide.py
            assert "confirmed" in run_block(text)
        if language == "toml" and "extends" in text:
            own = tmp_path / "own.toml"
            own.write_text(text, encoding="utf-8")
            assert profiles.load(own).source == str(own)
