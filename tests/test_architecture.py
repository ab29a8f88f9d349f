"""The architecture page against the code: the layers and the packages."""

from __future__ import annotations

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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_page_shows_the_layers_that_the_import_contract_enforces(page: Path) -> None:
    drawn = re.findall(r"```\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)[0].splitlines()
    (contract,) = [one for one in CONTRACTS if one["type"] == "layers"]
    assert drawn == [line.replace("drivebus.", "") for line in contract["layers"]]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_page_lists_every_package_of_the_product_and_of_the_service(page: Path) -> None:
    rows = re.findall(r"^\| `([\w.]+)` \|", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    folders = [path.parent for path in (*SOURCE.glob("*/__init__.py"), *SOURCE.glob("service/*/__init__.py"))]
    assert set(rows) == {".".join(folder.relative_to(SOURCE).parts) for folder in folders}


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=lambda page: page.name)
def test_every_path_that_a_page_names_exists(page: Path) -> None:
    named = re.findall(r"`((?:[\w.-]+/)+[\w.-]*)`", page.read_text(encoding="utf-8"))
    assert len(named) > 5
    assert [path for path in named if not (ROOT / path).exists() and not (SOURCE / path).exists()] == []
