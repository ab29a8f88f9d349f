"""The architecture page against the code: the layers and the packages; and the shape of records."""

from __future__ import annotations

import ast
import re
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from verification.structure import import_cycles

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "drivebus"
PAGES = [ROOT / "docs" / "explanation" / f"architecture{language}.md" for language in ("", ".zh")]
CONTRACTS: list[dict[str, Any]] = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"][
    "contracts"
]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_page_shows_the_layers_that_the_import_contract_enforces(page: Path) -> None:
    drawn = re.findall(r"```\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)[0].splitlines()
    (contract,) = [contract for contract in CONTRACTS if contract["type"] == "layers"]
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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_page_names_every_module_of_the_bus_with_an_event_loop(page: Path) -> None:
    """The bus was called pure but for two modules; a third imports asyncio."""
    modules = (ROOT / "src" / "drivebus" / "bus").glob("*.py")
    found = {file.stem for file in modules if re.search(r"^import asyncio", file.read_text(encoding="utf-8"), re.M)}
    (paragraph,) = re.findall(
        r"`bus\.station`[^.。]*[.。]([^.。]*`bus\.bus`.*?)(?:, so|，因此)", page.read_text("utf-8"), re.S
    )
    assert set(re.findall(r"`bus\.(\w+)`", paragraph)) == found


def test_a_program_may_begin_with_the_import_of_any_module(tmp_path: Path) -> None:
    """Trap: a circle through the ``__init__`` of a package, which only a program that begins inside it shows."""
    for name, text in {
        "plant/__init__.py": "from plant import load",
        "plant/load.py": "from api import names",
        "plant/model.py": "",
        "api/__init__.py": "",
        "api/names.py": "from plant.model import Plant",
    }.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    assert import_cycles(tmp_path, typing=False, packages=True) == [["api.names", "plant", "plant.load"]]
    assert import_cycles(SOURCE.parent, typing=False, packages=True) == []


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
            if not isinstance(record, ast.ClassDef) or not record.decorator_list:
                continue
            decorators = [ast.unparse(decorator) for decorator in record.decorator_list]
            is_record = any("dataclass" in decorator for decorator in decorators)
            keyword_only = any("kw_only=True" in decorator for decorator in decorators)
            if is_record and not keyword_only and len(fields := positional_fields(record)) > 5:
                wide.append(f"{path.relative_to(ROOT)}: {record.name}({', '.join(fields)})")
    assert wide == []


@cache
def calls(source: str) -> list[tuple[str, set[str]]]:
    """Return the dotted name of each call in a module, and its keywords that are not False."""
    return [
        (
            ast.unparse(node.func),
            {str(keyword.arg) for keyword in node.keywords if ast.unparse(keyword.value) != "False"},
        )
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Call)
    ]


def shell_calls(source: str) -> list[str]:
    """Return the calls that hand a text to a shell."""
    ends = ("system", "popen", "getoutput", "getstatusoutput", "create_subprocess_shell", "subprocess_shell")
    return [name for name, keywords in calls(source) if name.rpartition(".")[2] in ends or "shell" in keywords]


def product_modules() -> list[str]:
    found = [file.read_text(encoding="utf-8") for file in sorted((ROOT / "src" / "drivebus").rglob("*.py"))]
    assert len(found) > 400
    return found


def test_a_class_name_is_unique_in_the_product() -> None:
    """Trap: two classes of one name, of which a reader takes one for the other. ``blocking`` mirrors the public API."""
    files: dict[str, list[str]] = {}
    for path in SOURCE.rglob("*.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and path.name != "blocking.py":
                files.setdefault(node.name, []).append(path.name)
    assert len(files) > 500
    assert {name: found for name, found in files.items() if len(found) > 1} == {}


def test_no_child_process_is_started_through_a_shell() -> None:
    """A path or an option with ``; reboot`` is then one argument of the program, and nothing else."""
    for found in ("os.system(x)", "subprocess.run(x, shell=True)", "asyncio.create_subprocess_shell(x)", "os.popen(x)"):
        assert shell_calls(found) != []
    assert shell_calls("subprocess.run([x], shell=False)") == []
    modules = product_modules()
    assert [name for source in modules for name in shell_calls(source)] == []
    starts = [name for source in modules for name, _ in calls(source) if name.endswith("create_subprocess_exec")]
    assert len(starts) >= 5, "the calls are found"


def hash_functions(source: str) -> set[str]:
    """Return the names that a module takes from ``hashlib``."""
    if "hashlib" not in source:
        return set()
    tree = ast.parse(source)
    imported = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module == "hashlib"]
    used = [node for node in ast.walk(tree) if isinstance(node, ast.Attribute)]
    names = {alias.name for node in imported for alias in node.names}
    return names | {node.attr for node in used if ast.unparse(node.value) == "hashlib"}


def test_only_a_collision_resistant_hash_function_is_used() -> None:
    assert hash_functions("import hashlib\nhashlib.md5(b'')\nfrom hashlib import sha1") == {"md5", "sha1"}
    assert {name for source in product_modules() for name in hash_functions(source)} == {"sha256"}
