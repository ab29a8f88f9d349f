"""The mutation tool makes the documented changes, and a slice of them is tried with every test run."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys

import pytest

from mutation import pages
from mutation.children import MUST_RELOAD, SURVIVED
from mutation.mutate import apply, mutants
from mutation.report import MUTATED_MODULES, REASONS, REPORT, ROOT, key, reported_modules
from mutation.run import JudgedMutant, judge_in_order, tree_of


def changes(source: str) -> list[str]:
    return [mutant.description() for mutant in mutants(ast.parse(source))]


CHANGES = [
    (
        "def f(a):\n return a <= 7",
        [
            "return a <= 7 → return None",
            "a <= 7 → a < 7",
            "a <= 7 → a > 7",
            "7 → 8",
            "7 → 6",
        ],
    ),
    ("def f(a, b):\n while a and b: break", ["a and b → a or b", "a and b → b", "a and b → a", "break → pass"]),
    ("def f(a):\n if not a: raise KeyError", ["not a → a", "raise KeyError → pass"]),
    ("def f(a, n):\n return a[:n]", ["return a[:n] → return None", ":n → :"]),
    (
        "T = {1: A, 2: B}",
        [
            "{1: A, 2: B} → {2: B}",
            "{1: A, 2: B} → {1: B, 2: B}",
            "{1: A, 2: B} → {1: A}",
            "{1: A, 2: B} → {1: A, 2: A}",
            "1 → 2",
            "1 → 0",
            "2 → 3",
            "2 → 1",
        ],
    ),
    ("T = b'ab'", ["b'ab' → b'b'", "b'ab' → b'a'"]),
    ('@dataclass(frozen=True)\nclass C:\n """Text."""\n x: int = 5', ["5 → 6", "5 → 4"]),
    (
        "@property\ndef f(self):\n return self.x == 'a'",
        [
            "return self.x == 'a' → return None",
            "self.x == 'a' → self.x != 'a'",
            "'a' → 'ax'",
        ],
    ),
    ("def f(a=3): pass", ["3 → 4", "3 → 2"]),
    (
        "__all__ = ['a']\nX = One | Two\nY = Literal['a']\ndef f():\n raise ValueError(f'text {1}')",
        [
            "raise ValueError(f'text {1}') → pass",
        ],
    ),
]


@pytest.mark.parametrize(("source", "expected"), CHANGES, ids=[row[0][:24] for row in CHANGES])
def test_exactly_these_changes_are_made(source: str, expected: list[str]) -> None:
    assert changes(source) == expected


def test_mutants_at_import_are_marked() -> None:
    source = "A = 1\nclass C:\n b = 2\n def f(self, c=3):\n  return 4"
    found = {mutant.before: mutant.at_load for mutant in mutants(ast.parse(source))}
    assert {number: found[number] for number in "1234"} == {"1": True, "2": True, "3": True, "4": False}


def test_a_mutant_that_does_not_fit_into_a_loaded_function_is_reloaded() -> None:
    """The last ``super()`` of a function, for example, changes its closure."""
    (judged,) = judge_in_order(iter([(JudgedMutant("m", 0, SURVIVED, reloaded=False), lambda: MUST_RELOAD)]), jobs=1)
    assert (judged.verdict, judged.reloaded) == (SURVIVED, True)


def test_a_change_is_one_change() -> None:
    source = "def f(a):\n return a < 1 or a > 2"
    for number in range(len(changes(source))):
        tree = ast.parse(source)
        mutant = mutants(tree)[number]
        apply(mutant)
        text = ast.unparse(tree)
        assert text != ast.unparse(ast.parse(source)) and mutant.after in text


@pytest.mark.parametrize("module", [module for modules, _ in MUTATED_MODULES for module in modules])
def test_every_mutated_module_exists_and_its_mutants_compile(module: str) -> None:
    tree = tree_of(module)
    for mutant in mutants(tree)[::20]:
        parent, name, index, new = mutant.place
        old = getattr(parent, name) if index is None else getattr(parent, name)[index]
        apply(mutant)
        compile(tree, module, "exec", dont_inherit=True)
        if index is None:
            setattr(parent, name, old)
        else:
            getattr(parent, name)[index] = old
        assert new is not old


def test_the_pages_show_the_committed_figures_and_every_survivor_has_a_reason() -> None:
    found = json.loads(REPORT.read_text(encoding="utf-8"))
    assert set(found) <= reported_modules(), "a row names a module that was moved, renamed or removed"
    for language, name in (("en", "mutation.md"), ("zh", "mutation.zh.md")):
        assert (REPORT.parent / name).read_text(encoding="utf-8") == pages.page(found, language)
    for row in found.values():
        assert row["mutants"] - row["killed"] == len(row["survivors"]) <= row["mutants"] / 10
        assert all(left["reason"] for left in row["survivors"])


def test_every_reason_belongs_to_a_mutant() -> None:
    """A reason without a mutant would hide a survivor with the same key later."""
    modules = {module for modules, _ in MUTATED_MODULES for module in modules}
    keys = {
        key(module, mutant.scope, mutant.description()) for module in modules for mutant in mutants(tree_of(module))
    }
    assert sorted(set(json.loads(REASONS.read_text(encoding="utf-8"))) - keys) == []


@pytest.mark.skipif(not hasattr(os, "fork"), reason="mutants run in forked processes")
def test_every_changed_comparison_of_the_permissives_is_detected() -> None:
    """This is the slice of continuous integration; ``make mutation`` runs all mutants."""
    command = [sys.executable, "-m", "mutation", "drives.permissives", "--kind", "comparison"]
    environment = os.environ | {"PYTHONPATH": str(ROOT / "tests")}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    comparisons = [mutant for mutant in mutants(tree_of("drivebus.drives.permissives")) if mutant.kind == "comparison"]
    assert len(comparisons) > 20 and f"{len(comparisons)} tried, 0 to be reloaded" in done.stderr
    assert done.stdout == ""
