"""The house rules that tools can hold: formatting, lint, types, layers, and one lock without addresses."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
BIN = Path(sys.executable).parent


@pytest.mark.parametrize(
    "command",
    [["ruff", "check"], ["ruff", "format", "--check"], ["mypy"], ["lint-imports", "--no-cache"]],
    ids=["lint", "format", "types", "layers"],
)
def test_formatting_lint_types_and_import_contracts_hold(command: list[str]) -> None:
    done = subprocess.run([BIN / command[0], *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]


@pytest.mark.parametrize("name", ["base", "build", "test"])
def test_lock_files_hold_versions_and_hashes_and_no_addresses(name: str) -> None:
    text = (ROOT / "requirements" / f"{name}.txt").read_text()
    pins = re.findall(r"^[a-z0-9_.-]+==\S+", text, flags=re.MULTILINE)
    assert pins
    assert text.count("--hash=sha256:") >= len(pins)
    assert "://" not in text


def test_every_runtime_pin_is_the_same_in_the_test_lock() -> None:
    def pins(name: str) -> set[str]:
        text = (ROOT / "requirements" / f"{name}.txt").read_text()
        return set(re.findall(r"^[a-z0-9_.-]+==[^\s;]+", text, flags=re.MULTILINE))

    assert pins("base") <= pins("test")


def test_continuous_integration_installs_each_program_that_a_test_needs() -> None:
    """A test of a damaged history was skipped there: nothing installed ``sqlite3``, and the skip named no package."""
    installed = set((ROOT / ".ci" / "run").read_text().split())
    needed, own_skips = set(), []
    for file in sorted((ROOT / "tests").rglob("*.py")):
        text = file.read_text(encoding="utf-8")
        needed |= set(re.findall(r'need_program\("[^"]+", "([^"]+)"\)|apt-get install ([\w.-]+)', text))
        own_skips += [file.name for _ in re.findall(r"skip(?:if)?\([^\n]*shutil\.which", text)]
    packages = {name for pair in needed for name in pair if name}
    assert {"sqlite3", "nginx"} <= packages
    assert packages <= installed
    assert own_skips == []
