"""The architecture page against the code: the layers and the packages; and the shape of records."""

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


def positional_fields(record: ast.ClassDef) -> list[str]:
    """Fields that the constructor takes by position."""
    fields: list[str] = []
    for statement in record.body:
        if not isinstance(statement, ast.AnnAssign) or not isinstance(statement.target, ast.Name):
            continue
        if "KW_ONLY" in ast.unparse(statement.annotation):
            break
        value = ast.unparse(statement.value) if statement.value else ""
        if "ClassVar" not in ast.unparse(statement.annotation) and not re.search(r"init=False|kw_only=True", value):
            fields.append(statement.target.id)
    return fields


@pytest.mark.parametrize("tree", ["src", "verification", "tests", "benchmarks"])
def test_a_record_of_more_than_five_fields_is_keyword_only(tree: str) -> None:
    wide = []
    for path in sorted((ROOT / tree).rglob("*.py")):
        for record in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(record, ast.ClassDef):
                continue
            decorators = [ast.unparse(decorator) for decorator in record.decorator_list]
            is_record = any("dataclass" in decorator for decorator in decorators)
            keyword_only = any("kw_only=True" in decorator for decorator in decorators)
            if is_record and not keyword_only and len(fields := positional_fields(record)) > 5:
                wide.append(f"{path.relative_to(ROOT)}: {record.name}({', '.join(fields)})")
    assert wide == []
