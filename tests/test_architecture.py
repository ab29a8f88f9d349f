"""The architecture's page against the code: the layers, the rooms and files, and who is held to be pure."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "drivebus"
PAGES = [ROOT / "docs" / "explanation" / f"architecture{language}.md" for language in ("", ".zh")]
CONTRACTS: list[dict[str, Any]] = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"][
    "contracts"
]


def contract(beginning: str) -> dict[str, Any]:
    return next(one for one in CONTRACTS if one["name"].startswith(beginning))


def modules(room: str) -> set[str]:
    """Files and folders of a room."""
    found = (path.stem for path in (SOURCE / room).iterdir() if path.suffix == ".py" or (path / "__init__.py").exists())
    return {name for name in found if name != "__init__"}


def named(page: Path, heading: int) -> set[str]:
    """What the table's first column names, under the page's n-th second heading."""
    part = page.read_text(encoding="utf-8").split("\n## ")[heading]
    rows = re.findall(r"^\| (`[^|]*) \|", part, flags=re.MULTILINE)
    return {name.removeprefix("plant.") for row in rows for name in re.findall(r"`([\w.]+)`", row)}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_layers_on_the_page_are_those_that_are_held(page: Path) -> None:
    drawn = re.findall(r"```\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)[0].splitlines()
    assert drawn == [line.replace("drivebus.", "") for line in contract("the house")["layers"]]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_file_of_the_bus_and_the_plant_stands_in_its_table(page: Path) -> None:
    assert named(page, 3) == modules("bus")
    outside = {"gateways.rest", "live", "metrics", "web"}
    assert named(page, 2) - outside == modules("plant")


def test_whoever_says_that_it_is_pure_is_held_to_it() -> None:
    held = tuple(contract("pure rooms")["source_modules"])
    claimed = set()
    for path in SOURCE.rglob("*.py"):
        if re.search(r"\bPure\b", ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""):
            claimed.add(".".join(path.relative_to(ROOT / "src").with_suffix("").parts))
    assert len(claimed) > 40
    assert {name for name in claimed if not f"{name}.".startswith(tuple(f"{one}." for one in held))} == set()
