"""The examples and the program of the README run unchanged."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.xdist_group("commands")
ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


def run(program: str | Path) -> str:
    command = [sys.executable, "-c", program] if isinstance(program, str) else [sys.executable, str(program)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("program", EXAMPLES, ids=[path.stem for path in EXAMPLES])
def test_an_example_runs_unchanged(program: Path) -> None:
    assert "stop" in run(program)


@pytest.mark.parametrize("page", ["README.md", "README.zh.md"])
def test_the_program_of_the_readme_prints_what_its_comments_say(page: str) -> None:
    found = re.search(r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None
    comments = [line.partition("  # ")[2] for line in found[1].splitlines() if "print(" in line]
    assert run(found[1]).splitlines() == comments and len(comments) == 3
