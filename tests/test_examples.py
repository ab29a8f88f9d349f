"""The examples and the program of the README run unchanged."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

pytestmark = pytest.mark.xdist_group("api")  # the commands of the pages take about as long as the API and the examples
ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


def run(*words: str | Path) -> str:
    """Return what a program prints."""
    done = subprocess.run([sys.executable, *words], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@cache
def run_statements(statements: str) -> str:
    return run("-c", statements)


def run_block(text: str) -> str:
    """Return what the program of a page prints; pages in two languages have one program with other comments."""
    return run_statements(ast.unparse(ast.parse(text)))


@pytest.mark.parametrize("program", EXAMPLES, ids=[path.stem for path in EXAMPLES])
def test_an_example_runs_unchanged(program: Path) -> None:
    assert "stop" in run(program)


@pytest.mark.parametrize("page", ["README.md", "README.zh.md"])
def test_the_program_of_the_readme_prints_what_its_comments_say(page: str) -> None:
    found = re.search(r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None
    comments = [line.partition("  # ")[2] for line in found[1].splitlines() if "print(" in line]
    assert run_block(found[1]).splitlines() == comments and len(comments) == 3
