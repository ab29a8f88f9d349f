"""Results of the mutants as figures: docs/reports/mutation.json."""

from __future__ import annotations

import json
from typing import Any

from mutation.children import KILLED, SURVIVED, TIMEOUT, UNTESTED
from mutation.mutate import mutants
from mutation.run import ROOT, JudgedMutant, tree_of

REPORT = ROOT / "docs" / "reports" / "mutation.json"
REASONS = ROOT / "tests" / "mutation" / "reasons.json"
MUTATED_SOURCES = ("src/drivebus", "tests")


def modules_in(package: str) -> list[str]:
    """Return all modules of a package."""
    files = sorted((ROOT / "src" / "drivebus" / package).rglob("*.py"))
    names = [".".join(path.relative_to(ROOT / "src").with_suffix("").parts) for path in files]
    return [name for name in names if not name.endswith("__init__")]


def modules_of(package: str, *names: str) -> list[str]:
    """Return these modules of a package; a test checks that they exist."""
    return [f"drivebus.{package}.{name}".replace("/", ".") for name in names]


COMMAND_MODULES = [
    *modules_of("service/api", "audit_aggregator", "dispatcher"),
    *modules_of("service/auth", "actor"),
    *modules_of("service/control", "leases", "start_blockers", "tickets", "waivers"),
    *modules_of("service/process", "tuning"),
]
COMMAND_TESTS = ("api", "control", "runtime", "test_service.py")
AUTHORIZATION_MODULES = [
    *modules_of("web", "context", "route"),
    *modules_of("web/middleware", "auth", "host_check", "request_body", "session_expiry"),
    *modules_of("web/routes", "description", "session", "users"),
]
AUTHORIZATION_TESTS = (
    "auth_middleware",
    "commands_on_a_service",
    "host_check",
    "limits",
    "login",
    "origin",
    "routes",
    "session_expiry",
    "users",
)
"""Tests of authorization: users and sessions, commands to the service, requests to the web."""
OPERATION_TESTS = (
    "expired_commands",
    "failure_reasons",
    "fault_while_turning",
    "frequency_contradicts",
    "hold",
    "misbehaving_drives",
    "overspeed",
    "run_while_turning",
    "setpoint_speed",
    "standstill",
    "start",
    "start_checks",
    "start_preparation",
    "start_setpoint",
    "stop",
    "stop_port_lost",
    "unlock",
    "wait_at_speed",
    "wrong_model",
)
"""Tests of single operations; the others of tests/drives play whole drives, a few seconds for each mutant."""
REFERENCE_TESTS = [f"tests/verification/test_reference_{name}.py" for name in ("codecs", "comparison")]
MUTATED_MODULES: list[tuple[list[str], list[str]]] = [
    (["drivebus.drives.permissives"], ["tests/drives/test_permissives.py"]),
    (
        modules_of("drives/operations", "hold", "start", "stop"),
        [f"tests/drives/test_{name}.py" for name in OPERATION_TESTS],
    ),
    (
        modules_of(
            "bus",
            "compatibility",
            "core",
            "echo",
            "failure_reason",
            "prepared_request",
            "scheduler",
            "silence_timeout",
            "station",
            "station_registry",
            "transaction",
            "transaction_future",
            "unsolicited",
        ),
        ["tests/bus", "tests/drives/test_failure_reasons.py"],
    ),
    (modules_in("protocols"), ["tests/protocols", "tests/testing", *REFERENCE_TESTS]),
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
"""Modules, and the tests that must fail for their mutants."""


def reported_modules() -> set[str]:
    """Return the modules that a row may name: those with a line to change, under their current names."""
    return {name for modules, _ in MUTATED_MODULES for name in modules if mutants(tree_of(name))}


def mutation_document(found: list[JudgedMutant], version: str) -> dict[str, Any]:
    """Return the figures and survivors by module."""
    made: dict[str, Any] = {}
    for module in dict.fromkeys(mutant.module for mutant in found):
        ours = [mutant for mutant in found if mutant.module == module]
        changes = mutants(tree_of(module))
        left = [mutant for mutant in ours if mutant.verdict in (SURVIVED, UNTESTED)]
        made[module] = {
            "commit": version,
            "mutants": len(ours),
            "killed": sum(mutant.verdict in (KILLED, TIMEOUT) for mutant in ours),
            "at_load": sum(changes[mutant.number].at_load for mutant in ours),
            "comparisons": sum(changes[mutant.number].kind == "comparison" for mutant in ours),
            "survivors": [
                {
                    "line": changes[mutant.number].line,
                    "scope": changes[mutant.number].scope,
                    "kind": changes[mutant.number].kind,
                    "change": changes[mutant.number].description(),
                }
                for mutant in left
            ],
        }
    return made


def previous_survivors(module: str) -> frozenset[str]:
    """Return the keys of a module's survivors in the committed report."""
    module_report = json.loads(REPORT.read_text(encoding="utf-8")).get(module, {"survivors": ()})
    return frozenset(key(module, left["scope"], left["change"]) for left in module_report["survivors"])


def retried_document(found: list[JudgedMutant], version: str) -> dict[str, Any]:
    """Return the committed figures, with the survivors that were tried again.

    Raises ValueError where a module has changed since: all of it must be tried again.
    """
    old = json.loads(REPORT.read_text(encoding="utf-8"))
    made = mutation_document(found, version)
    for module, row in made.items():
        before = old[module]
        if before["mutants"] != len(mutants(tree_of(module))):
            raise ValueError(f"{module} has other mutants than in {REPORT.name}: try it without --again")
        killed = before["mutants"] - len(row["survivors"])
        made[module] = before | {"commit": version, "killed": killed, "survivors": row["survivors"]}
    return made


def unexplained_survivors(judged: JudgedMutant) -> bool:
    """Return whether a mutant has no entry in reasons.json."""
    mutant = mutants(tree_of(judged.module))[judged.number]
    return key(judged.module, mutant.scope, mutant.description()) not in json.loads(REASONS.read_text(encoding="utf-8"))


def key(module: str, scope: str, change: str) -> str:
    """Return the key of a mutant in reasons.json, which does not depend on its line."""
    return f"{module.removeprefix('drivebus.')} {scope}: {change}"


def write_document(made: dict[str, Any]) -> dict[str, Any]:
    """Update these modules in the report, and the reasons of all survivors; a module that was removed loses its row.

    A survivor whose code was renamed after its run keeps the reason that the report has.
    """
    old = json.loads(REPORT.read_text(encoding="utf-8")) if REPORT.exists() else {}
    reasons = json.loads(REASONS.read_text(encoding="utf-8"))
    reported = reported_modules()
    found: dict[str, Any] = {module: row for module, row in sorted((old | made).items()) if module in reported}
    for module, row in found.items():
        for left in row["survivors"]:
            left["reason"] = reasons.get(key(module, left["scope"], left["change"]), left.get("reason", ""))
    REPORT.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return found
