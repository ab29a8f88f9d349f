"""What became of the mutants, as figures: docs/reports/mutation.json."""

from __future__ import annotations

import json
from typing import Any

from mutation.children import KILLED, SURVIVED, TIMEOUT, UNTESTED
from mutation.mutate import mutants
from mutation.run import ROOT, JudgedMutant, tree_of

REPORT = ROOT / "docs" / "reports" / "mutation.json"
REASONS = ROOT / "tests" / "mutation" / "reasons.json"
TRIED = ("src/drivebus", "tests")


def modules_in(room: str) -> list[str]:
    found = sorted((ROOT / "src" / "drivebus" / room).rglob("*.py"))
    names = [".".join(path.relative_to(ROOT / "src").with_suffix("").parts) for path in found]
    return [name for name in names if not name.endswith("__init__")]


def existing(package: str, *names: str) -> list[str]:
    """Return those of a package's modules that exist: what was merged into another module is tried there."""
    folder = ROOT / "src" / "drivebus" / package
    return [f"drivebus.{package}.{name}".replace("/", ".") for name in names if (folder / f"{name}.py").exists()]


COMMAND_MODULES = [
    *existing("service/api", "dispatcher"),
    *existing("service/auth", "actor"),
    *existing("service/control", "leases", "permissives", "tickets", "waivers"),
    *existing("service/process", "tuning"),
]
COMMAND_TESTS = ("api", "control", "runtime", "test_service.py")
AUTHORIZATION_MODULES = [
    *existing("web", "context", "dependencies", "route"),
    *existing("web/middleware", "auth", "denial_log", "host_check", "request_body", "session_expiry"),
    *existing("web/routes", "schemas", "session", "users"),
]
AUTHORIZATION_TESTS = (
    "auth_middleware",
    "commands_on_a_service",
    "denial_log",
    "host_check",
    "limits",
    "login",
    "origin",
    "routes",
    "session_expiry",
    "users",
)
"""Who may do what: users and sessions, commands to the plant, requests of the web."""
MUTATED_MODULES: list[tuple[list[str], list[str]]] = [
    (["drivebus.drives.permissives"], ["tests/drives/test_permissives.py"]),
    (
        existing("bus", "prepared_request", "scheduler", "transaction", "validation"),
        ["tests/bus"],
    ),
    (modules_in("protocols"), ["tests/protocols", "tests/testing", "tests/oracle"]),
    (modules_in("service/auth"), ["tests/service/auth", "tests/cli/test_user.py"]),
    (
        COMMAND_MODULES,
        [f"tests/service/{name}" for name in COMMAND_TESTS],
    ),
    (
        AUTHORIZATION_MODULES,
        [f"tests/web/security/test_{name}.py" for name in AUTHORIZATION_TESTS],
    ),
]
"""Modules, and the tests that have to notice."""


def mutation_document(found: list[JudgedMutant], version: str) -> dict[str, Any]:
    """Module → figures and survivors."""
    made: dict[str, Any] = {}
    for module in dict.fromkeys(one.module for one in found):
        ours = [one for one in found if one.module == module]
        changes = mutants(tree_of(module))
        left = [one for one in ours if one.verdict in (SURVIVED, UNTESTED)]
        made[module] = {
            "commit": version,
            "mutants": len(ours),
            "killed": sum(one.verdict in (KILLED, TIMEOUT) for one in ours),
            "at_load": sum(changes[one.number].at_load for one in ours),
            "comparisons": sum(changes[one.number].kind == "comparison" for one in ours),
            "survivors": [
                {
                    "line": changes[one.number].line,
                    "scope": changes[one.number].scope,
                    "kind": changes[one.number].kind,
                    "change": changes[one.number].description(),
                }
                for one in left
            ],
        }
    return made


def previous_survivors(module: str) -> frozenset[str]:
    """The changes that nobody noticed last time, by scope and change."""
    kept = json.loads(REPORT.read_text(encoding="utf-8")).get(module, {"survivors": ()})
    return frozenset(key(module, left["scope"], left["change"]) for left in kept["survivors"])


def retried_document(found: list[JudgedMutant], version: str) -> dict[str, Any]:
    """The kept figures, where only the survivors were tried again.

    Raises ValueError where a module has changed since: then all of it is to be tried.
    """
    old = json.loads(REPORT.read_text(encoding="utf-8"))
    made = mutation_document(found, version)
    for module, one in made.items():
        before = old[module]
        if before["mutants"] != len(mutants(tree_of(module))):
            raise ValueError(f"{module} has other mutants than in {REPORT.name}: try it without --again")
        killed = before["mutants"] - len(one["survivors"])
        made[module] = before | {"commit": version, "killed": killed, "survivors": one["survivors"]}
    return made


def unexplained_survivors(one: JudgedMutant) -> bool:
    """It survived, and nobody has said why it may."""
    mutant = mutants(tree_of(one.module))[one.number]
    return key(one.module, mutant.scope, mutant.description()) not in json.loads(REASONS.read_text(encoding="utf-8"))


def key(module: str, scope: str, change: str) -> str:
    """A survivor's name in reasons.json; a line would not outlive an edit above it."""
    return f"{module.removeprefix('drivebus.')} {scope}: {change}"


def write_document(made: dict[str, Any]) -> dict[str, Any]:
    """Put these modules' figures into the report, and the reasons as they are now to all survivors."""
    old = json.loads(REPORT.read_text(encoding="utf-8")) if REPORT.exists() else {}
    reasons = json.loads(REASONS.read_text(encoding="utf-8"))
    found: dict[str, Any] = dict(sorted((old | made).items()))
    for module, one in found.items():
        for left in one["survivors"]:
            left["reason"] = reasons.get(key(module, left["scope"], left["change"]), "")
    REPORT.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return found
