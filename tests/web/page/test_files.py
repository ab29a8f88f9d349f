"""The page's files: vendored files match their list, downloads are small, and texts are in the catalogue."""

from __future__ import annotations

import gzip
import hashlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from drivebus import i18n, web
from drivebus.web.routes.static_files import COMMAND_LINE_TEXTS, first_modules

HERE = Path(web.__file__).parent
VENDOR = HERE / "vendor"
SCRIPTS = sorted((HERE / "static").rglob("*.js"))
LISTED: list[dict[str, Any]] = json.loads((VENDOR / "VERSIONS.json").read_text())["files"]
LARGEST = 300 * 1024


@pytest.mark.parametrize("entry", LISTED, ids=lambda entry: str(entry["file"]))
def test_a_vendored_file_is_the_one_that_is_listed(entry: dict[str, Any]) -> None:
    content = (VENDOR / entry["file"]).read_bytes()
    assert hashlib.sha256(content).hexdigest() == entry["sha256"]
    assert (VENDOR / entry["licence_file"]).read_text().strip()


def test_nothing_is_vendored_that_is_not_listed() -> None:
    found = {path.name for path in VENDOR.iterdir() if path.is_file()} - {"VERSIONS.json"}
    assert found == {entry["file"] for entry in LISTED}


def test_every_import_is_relative_and_exists() -> None:
    """There is no build, no import map and no file from another origin."""
    for script in [*SCRIPTS, *VENDOR.glob("*.js")]:
        for found in re.findall(r"""(?:[}\w*] ?from|\bimport) ?\(?["']([^"'\n]+)["']""", script.read_text("utf-8")):
            assert found.startswith("."), (script.name, found)
            assert (script.parent / found).resolve().is_file(), (script.name, found)


EXPORT = re.compile(r"^export (?:async )?(?:const|let|class|function\*?) (\w+)", re.MULTILINE)
TOGETHER = re.compile(r"^(export|import) \{([^}]*)\}", re.MULTILINE)


def names(listed: str) -> list[str]:
    return re.findall(r"(\w+)\s*(?:,|$)", listed)


def test_every_export_of_a_script_is_imported_by_another_or_by_a_test() -> None:
    code = {path: stripped(path.read_text("utf-8")) for path in SCRIPTS}
    tests = "".join(path.read_text("utf-8") for path in Path(__file__).parent.glob("*.py"))
    unused = set()
    for path, text in code.items():
        together = [name for kind, listed in TOGETHER.findall(text) if kind == "export" for name in names(listed)]
        for name in [*EXPORT.findall(text), *together]:
            word = re.compile(rf"\b{name}\b")
            if not any(word.search(other) for file, other in code.items() if file != path) and not word.search(tests):
                unused.add((path.name, name))
    assert not unused


def test_every_import_of_a_script_is_used() -> None:
    for path in SCRIPTS:
        text = stripped(path.read_text("utf-8"))
        imported = [name for kind, listed in TOGETHER.findall(text) if kind == "import" for name in names(listed)]
        assert not {name for name in imported if len(re.findall(rf"\b{name}\b", text)) < 2}, path.name


def test_an_installation_behind_a_symbolic_link_finds_its_own_files(tmp_path: Path) -> None:
    """The paths of the files are resolved: below an unresolved folder none of them lay, and the page did not open."""
    (tmp_path / "current").symlink_to(HERE.parents[1])
    code = (
        "from drivebus.web.routes import static_files as files; print(files.WEB_DIRECTORY, len(files.first_modules()))"
    )
    env = {**os.environ, "PYTHONPATH": str(tmp_path / "current")}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [str(HERE.resolve()), str(len(first_modules()))]


def test_the_whole_page_is_small_over_the_wire() -> None:
    """All files that it can load, in the larger language, compressed as by the server; measured 2026-11."""
    files = [path for path in [*HERE.glob("static/**/*"), *VENDOR.glob("*.*")] if path.is_file()]
    sentences = max(len(_packed(i18n.catalogue_json(name, COMMAND_LINE_TEXTS))) for name in i18n.LANGUAGES)
    assert sum(len(_packed(path.read_bytes())) for path in files) + sentences <= LARGEST


def test_the_page_loads_its_own_texts_and_every_text_that_a_reading_or_a_frame_can_name() -> None:
    loaded = json.loads(i18n.catalogue_json("en", COMMAND_LINE_TEXTS)).keys()
    assert "help.serve" not in loaded and len(loaded) < 0.65 * len(i18n.catalogue("en"))
    packages = ("bus", "drives", "families", "ports", "protocols", "service/control", "service/live", "service/runtime")
    sources = [path for name in packages for path in (HERE.parent / name).rglob("*.py")]
    named = {key for path in sources for key in re.findall(r'"([a-z_]+\.[a-z0-9_]+)"', path.read_text("utf-8"))}
    assert len(named & loaded) > 200
    shown = {key for key in named & i18n.catalogue("en").keys() if not key.startswith("log.")}
    assert shown <= loaded


def test_the_page_loads_no_text_that_only_the_command_line_names() -> None:
    """Those of the terminal view and of single commands were loaded too."""
    package = HERE.parent
    sources = [path for path in package.rglob("*.[pj][ys]") if package / "cli" not in path.parents]
    named = {
        name for path in sources for name in re.findall(r"""["'`]([a-z_]+)\.[a-z0-9_$]""", path.read_text("utf-8"))
    }
    loaded = json.loads(i18n.catalogue_json("en", COMMAND_LINE_TEXTS)).keys()
    assert not {key for key in loaded if key.partition(".")[0] not in named}


def test_the_page_loads_no_text_that_comes_with_its_alarm_or_its_rejected_file() -> None:
    """The keys of these texts are composed, so that no source names them; they were a sixth of the page's texts."""
    groups = {key.rpartition(".")[0] for key in json.loads(i18n.catalogue_json("en", COMMAND_LINE_TEXTS))}
    own = {"alarms", "alarms.subject", "profiles"}
    assert {name for name in groups if name.startswith(("alarms", "profiles"))} == own


def _packed(content: bytes) -> bytes:
    return gzip.compress(content, 6, mtime=0)


def stripped(text: str) -> str:
    """Return a script without comments; ``<//>`` ends a component and begins no comment."""
    return re.sub(r"/\*.*?\*/|(?<![:\"'`<])//[^\n]*", "", text, flags=re.DOTALL)


KEYS = re.compile(r"""["'`](page\.[a-z0-9_]+)["'`]""")
BEGINNINGS = re.compile(r"`(page\.[a-z0-9_]*)\$\{")


def test_every_text_that_a_script_names_is_in_the_catalogue() -> None:
    known = i18n.catalogue("en").keys()
    named = {(path.name, key) for path in SCRIPTS for key in KEYS.findall(path.read_text("utf-8"))}
    assert len(named) > 100
    assert not {(file, key) for file, key in named if key not in known}


def test_every_text_of_the_page_is_used() -> None:
    text = "\n".join(stripped(path.read_text("utf-8")) for path in SCRIPTS)
    starts = {
        "page.sort_",
        "page.by_",
        "page.size_",
        "page.counter_",
        "page.error_",
    }  # keys composed of a name
    used, beginnings = set(KEYS.findall(text)), tuple(starts | set(BEGINNINGS.findall(text)) - {"page."})
    mine = {key for key in i18n.catalogue("en") if key.startswith("page.")}
    fields = {f"page.{name}" for name in ("minimum_hz", "maximum_hz")}
    assert not {key for key in mine - used - fields if not key.startswith(beginnings)}


TEXT = re.compile(r">([^<>{}`$]*[A-Za-z一-鿿]{2,}[^<>{}`$]*)<")
ATTRIBUTE = re.compile(r"""\s(?:aria-label|title|placeholder|alt)="([^"]*[A-Za-z一-鿿]{2,}[^"]*)\"""")
SYMBOLS = {"Hz", "drivebus", "A|B"}


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_no_script_contains_a_text_for_users(script: Path) -> None:
    """All texts for users are in the catalogue in both languages, except units and the name of the program."""
    code = stripped(script.read_text("utf-8"))
    for template in re.findall(r"html`(.*)", code, flags=re.DOTALL):
        texts = {text.strip() for text in [*TEXT.findall(_markup(template)), *ATTRIBUTE.findall(template)]}
        assert not {text for text in texts if text not in SYMBOLS}


def _markup(template: str) -> str:
    """Return a template without arrows and comparisons, which are not tags."""
    return re.sub(r"=>|>=|<=| > | < ", " ", template)


CHINESE = re.compile("[一-鿿]")


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_no_script_contains_chinese_but_the_name_of_the_language(script: Path) -> None:
    code = stripped(script.read_text("utf-8")).replace('zh: "中文"', "")
    assert not CHINESE.search(code)


@pytest.mark.parametrize("path", [*SCRIPTS, *(HERE / "static").rglob("*.css")], ids=lambda path: path.name)
def test_a_script_follows_the_content_security_policy(path: Path) -> None:
    """The policy forbids inline code: no event handler in HTML, no HTML from text."""
    text = path.read_text("utf-8")
    if path.suffix == ".js":
        assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|dangerouslySet|document\.write|\beval\(", text)
    assert "http://" not in text and "https://" not in text


def test_a_bus_stop_is_never_drawn_or_named_as_an_emergency_stop() -> None:
    """The page has no red mushroom and not the words: a stop over a bus is not a safety function."""
    for language in i18n.LANGUAGES:
        for key, sentence in i18n.catalogue(language).items():
            if (
                key.startswith("page.") and key != "page.about_safety"
            ):  # states that a bus stop is not an emergency stop
                assert not re.search(r"emergency[ -]stop|e-stop|紧急停|急停", sentence, re.IGNORECASE), key
    styles = (HERE / "static/css/shell.css").read_text()
    looks = re.findall(r"^\.stop \{([^}]*)\}", styles, re.MULTILINE)
    assert looks and not any(word in looks[0] for word in ("urgent", "50%", "red"))
