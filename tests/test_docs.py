"""Generated parts of the docs are up to date and complete, and the examples of the pages work."""

from __future__ import annotations

import hashlib
import inspect
import json
import re
import shutil
import subprocess
import sys
import tomllib
from importlib import import_module
from itertools import islice, pairwise
from pathlib import Path
from types import FunctionType

import click
import generate
import pytest
from generator import error_reference, pages

import drivebus
from drivebus import errors, profiles
from drivebus.cli.main import cli

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted((ROOT / "docs" / "protocols").glob("*.md"))


def toml_examples() -> list[tuple[str, str]]:
    pages = [*PAGES, *sorted((ROOT / "docs" / "reference").glob("profiles*.md"))]
    fence = re.compile(r"^ *```toml\n(.*?)```", re.DOTALL | re.MULTILINE)
    found = ((page.name, fence.findall(page.read_text(encoding="utf-8"))) for page in pages)
    return [(name, example) for name, examples in found for example in examples]


def test_the_generated_parts_are_up_to_date() -> None:
    done = subprocess.run(
        [sys.executable, ROOT / "docs" / "generate.py", "--check"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_page_out_of_date_is_reported_with_an_exit_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(ROOT / "docs", tmp_path / "docs")
    page = tmp_path / "README.md"
    _, up_to_date = next(pages.generated_pages(ROOT))
    page.write_text(up_to_date.replace("<!-- drives:end -->", "one more line\n<!-- drives:end -->"), encoding="utf-8")
    every_page = pages.generated_pages
    monkeypatch.setattr(generate, "ROOT", tmp_path)
    monkeypatch.setattr(pages, "generated_pages", lambda root: islice(every_page(root), 1))
    assert generate.main(["--check"]) == 1
    assert capsys.readouterr().out.startswith("README.md: out of date")
    assert generate.main([]) == 0
    assert page.read_text(encoding="utf-8") == up_to_date


def test_the_list_of_components_has_every_pinned_package_and_every_file_of_the_page() -> None:
    listed = json.loads((ROOT / "docs" / "security" / "sbom.cdx.json").read_text(encoding="utf-8"))["components"]
    requirements = (ROOT / "requirements" / "base.txt").read_text(encoding="utf-8").splitlines()
    pinned = {line.split()[0] for line in requirements if line[:1].isalnum()}
    assert len(pinned) > 30
    python = {f"{each['name']}=={each['version']}" for each in listed if each.get("purl", "").startswith("pkg:pypi/")}
    assert python == pinned
    vendored = ROOT / "src" / "drivebus" / "web" / "vendor"
    hashes = {each["hashes"][0]["content"] for each in listed if each.get("purl", "").startswith("pkg:npm/")}
    files = [*vendored.glob("*.js"), *vendored.glob("*.css")]
    assert len(files) == 7
    assert hashes == {hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def test_the_list_of_components_has_a_licence_of_each_and_the_marker_of_packages_for_some_platforms() -> None:
    """It named ``pywin32`` as a part of each installation, and no licence of a Python package."""
    listed = json.loads((ROOT / "docs" / "security" / "sbom.cdx.json").read_text(encoding="utf-8"))["components"]
    assert [each["name"] for each in listed if not each.get("licenses")] == []
    markers = {each["name"]: each["properties"][0]["value"] for each in listed if each.get("scope") == "optional"}
    assert markers == {"pycparser": "implementation_name != 'PyPy'", "pywin32": "sys_platform == 'win32'"}


def test_the_licence_of_the_project_covers_each_file_of_another_project() -> None:
    """The letters that look alike, the frequent passwords and the libraries of the page have licences of their own."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    document = json.loads((ROOT / "docs" / "security" / "sbom.cdx.json").read_text(encoding="utf-8"))
    assert document["metadata"]["component"]["licenses"] == [{"expression": project["license"]}]
    foreign = [each for each in document["components"] if not each.get("purl", "").startswith("pkg:pypi/")]
    assert set(project["license"].split(" AND ")) == {
        "Apache-2.0",
        *(each["licenses"][0]["license"]["id"] for each in foreign),
    }
    package = ROOT / "src" / "drivebus"
    with_notice = {
        str(file.relative_to(package))
        for file in package.rglob("*.txt")
        if "vendor" not in file.parts and "permission notice" in file.read_text(encoding="utf-8")
    }
    data = {each["bom-ref"]: each for each in foreign if each["type"] == "data"}
    assert with_notice == set(data)
    for name, each in data.items():
        assert each["hashes"][0]["content"] == hashlib.sha256((package / name).read_bytes()).hexdigest()


def test_every_model_has_its_page_in_both_languages_and_no_page_is_left_over() -> None:
    folder = ROOT / "docs" / "reference" / "models"
    names = {"README", *profiles.models()}
    expected = {f"{name}{suffix}.md" for name in names for suffix in ("", ".zh")}
    assert {page.name for page in folder.iterdir()} == expected, "run `make docs`; delete the page of a removed model"
    for suffix in ("", ".zh"):
        readme = (ROOT / f"README{suffix}.md").read_text(encoding="utf-8")
        assert [name for name in profiles.models() if f"(docs/reference/models/{name}{suffix}.md)" not in readme] == []


def test_every_family_has_its_page_in_both_languages() -> None:
    names = {f"{model}{suffix}.md" for model in ("c320", "dzb100", "vc660", "df800") for suffix in ("", ".zh")}
    assert {page.name for page in PAGES} == names


@pytest.mark.parametrize("model", ["c320", "dzb100", "vc660", "df800"])
def test_every_worked_frame_is_on_both_pages_of_its_family(model: str) -> None:
    names = re.findall(r'"id": "([^"]+)"', (ROOT / "vectors" / f"{model}.jsonl").read_text())
    assert names
    for suffix in ("", ".zh"):
        page = (ROOT / "docs" / "protocols" / f"{model}{suffix}.md").read_text()
        assert [name for name in names if f"#### `{name}`" not in page] == []


@pytest.mark.parametrize(("page", "example"), toml_examples(), ids=lambda value: value if value.endswith(".md") else "")
def test_a_profile_example_of_a_page_loads(page: str, example: str, tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text(example, encoding="utf-8")
    assert profiles.load(own).source == str(own)


@pytest.mark.parametrize("suffix", ["", ".zh"])
def test_every_command_and_every_error_has_its_paragraph(suffix: str) -> None:
    reference = ROOT / "docs" / "reference"
    commands = (reference / f"command-line{suffix}.md").read_text(encoding="utf-8")
    context = click.Context(cli)
    without = [name for name in cli.list_commands(context) if f"### `drivebus {name}`" not in commands]
    assert without == [], "run `make docs`"
    error_page = (reference / f"errors{suffix}.md").read_text(encoding="utf-8")
    classes = [name for name, found in vars(errors).items() if isinstance(found, type) and issubclass(found, Exception)]
    assert len(classes) > 30
    assert [name for name in classes if f"## {name}\n" not in error_page] == []


def test_the_file_that_lacks_the_chinese_of_an_error_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """`make docs` ended with the name of the new class alone."""
    monkeypatch.setattr(error_reference, "CHINESE", {})
    with pytest.raises(KeyError, match=r"docs/generator/errors\.zh\.json .* DrivebusError"):
        error_reference.page("zh")


MODULES = ["drivebus", "drivebus.blocking", "drivebus.bus", "drivebus.drives", "drivebus.ports", "drivebus.profiles"]


def sections(page: Path) -> dict[str, str]:
    """Return the section of each described name."""
    parts = re.split(r"^### `(.+)`$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def own_members(class_: type) -> set[str]:
    """Return public methods and properties of a class and of its bases in the package."""
    kinds = (FunctionType, property)
    found = {name: inspect.getattr_static(class_, name) for name in dir(class_) if not name.startswith("_")}
    plain = {name: getattr(value, "__func__", value) for name, value in found.items()}
    members = {name: getattr(value, "fget", None) or value for name, value in plain.items() if isinstance(value, kinds)}
    return {
        name
        for name in members
        if (getattr(plain[name], "fget", None) or plain[name]).__module__.startswith("drivebus")
    }


@pytest.mark.parametrize("suffix", ["", ".zh"])
def test_every_public_python_name_has_its_paragraph(suffix: str) -> None:
    """A name is described once, in the first of its modules; its methods and properties are in the same section."""
    described = sections(ROOT / "docs" / "reference" / f"python{suffix}.md")
    done: list[object] = []
    missing = []
    for module in MODULES:
        for name in import_module(module).__all__:
            item = getattr(import_module(module), name)
            if any(item is other for other in done):
                continue
            done.append(item)
            section = described.get(f"{module}.{name}", "")
            paragraph = re.search(r"```\n\n(\S.*)", section)
            missing += [f"{module}.{name}"] if paragraph is None else []
            members = own_members(item) if isinstance(item, type) else set()
            missing += [
                f"{module}.{name}.{m}"
                for m in members
                if not re.search(rf"^- `(await )?{m}[(:].*`(: |：)\S", section, re.M)
            ]
    assert missing == []
    assert len(done) == len(described) > 40
    assert (suffix == "") == all(ord(letter) < 0x2E80 for section in described.values() for letter in section)


def test_every_name_that_an_example_uses_is_public() -> None:
    used = {
        tuple(found)
        for program in (ROOT / "examples").glob("*.py")
        for found in re.findall(r"\b(drivebus|blocking)\.([A-Za-z_]+)", program.read_text(encoding="utf-8"))
    }
    modules = {"drivebus": drivebus, "blocking": import_module("drivebus.blocking")}
    assert len(used) > 4
    assert [(module, name) for module, name in used if name not in modules[module].__all__] == []


def test_the_table_of_renames_names_the_same_things_in_both_languages() -> None:
    pages = ((ROOT / name).read_text(encoding="utf-8").splitlines() for name in ("CHANGELOG.md", "CHANGELOG.zh.md"))
    english, chinese = ([set(re.findall("`[^`]+`", line)) for line in page if line.startswith("| ")] for page in pages)
    assert len(english) > 40
    assert english == chinese


def changelog_entries(page: str) -> list[list[str]]:
    """Return the first lines of the entries under each heading of a changelog, from its first heading on."""
    sections: list[list[str]] = []
    for line in (ROOT / page).read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            sections.append([line.split()[0]])
        elif line.startswith("- "):
            sections[-1].append(line)
    return sections


def test_both_changelogs_have_the_same_headings_with_as_many_entries_under_each() -> None:
    english, chinese = (changelog_entries(name) for name in ("CHANGELOG.md", "CHANGELOG.zh.md"))
    assert [(level, len(entries)) for level, *entries in english] == [
        (level, len(entries)) for level, *entries in chinese
    ]


def test_the_entries_of_both_changelogs_are_in_the_same_order() -> None:
    """Entries at the same place have code in common, where both have some."""
    pages = (
        re.sub(r"\n +", " ", (ROOT / name).read_text(encoding="utf-8")) for name in ("CHANGELOG.md", "CHANGELOG.zh.md")
    )
    english, chinese = (
        [set(re.findall("`[^`]+`", line)) for line in page.splitlines() if line.startswith("- ")] for page in pages
    )
    pairs = [(one, other) for one, other in zip(english, chinese, strict=True) if one and other]
    assert len(pairs) > 100
    assert [pair for pair in pairs if set.isdisjoint(*pair)] == []


@pytest.mark.parametrize("page", ["CHANGELOG.md", "CHANGELOG.zh.md"])
def test_an_entry_of_the_changelog_stands_once_and_under_the_heading_of_its_subject(page: str) -> None:
    sections = changelog_entries(page)
    divided = [section for section, (level, *_) in pairwise(sections) if level == "####"]
    above = [entries for level, *entries in divided if level == "###" and entries]
    below_table = re.findall(r"^\|.*\n(- .*)", (ROOT / page).read_text(encoding="utf-8"), re.MULTILINE)
    assert above + below_table == [], "move the entry under the #### heading of its subject, in both languages"
    entries = [entry for _, *section in sections for entry in section]
    assert len(entries) > 150
    assert len(entries) == len(set(entries))
