"""Child processes in which tests run against one mutant, and measurements of the tests. Needs ``os.fork``."""

from __future__ import annotations

import json
import os
import resource
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import pytest

from mutation.load import EXECUTED, StatementHit

QUICK_TEST_S = 0.3
"""Longest processor time of a test, in seconds; slower tests are left out."""
KILLED, SURVIVED, UNTESTED, TIMEOUT = "killed", "survived", "untested", "timeout"
MUST_RELOAD = 100
"""Exit code of a child whose mutant does not fit into loaded functions: its module must be reloaded."""
Wait = Callable[[], int]


def run_isolated(work: Callable[[], int], seconds: float) -> Wait:
    """Start ``work`` in a child with limited processor time; the result waits for its exit code."""
    child = os.fork()
    if child == 0:
        code = 3
        try:
            resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 2))
            silent = os.open(os.devnull, os.O_WRONLY)
            os.dup2(silent, 1)
            os.dup2(silent, 2)
            code = work()
        finally:
            os._exit(code)
    return lambda: os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def verdict(code: int) -> str:
    """Return the verdict for an exit code; a negative one is a signal (processor time used up, or a crash)."""
    return SURVIVED if code in (0, MUST_RELOAD) else KILLED if code > 0 else TIMEOUT


class ExitAtFirstFailure:
    """Plugin that ends the process at the first failing test."""

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> None:
        if call.excinfo is not None and not call.excinfo.errisinstance(pytest.skip.Exception):
            os._exit(1)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            os._exit(2)


def run_items(items: Sequence[pytest.Item]) -> int:
    for place, item in enumerate(items):
        following = items[place + 1] if place + 1 < len(items) else None
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
    return 0


@dataclass
class TestPaths:
    """Statements and duration of each test."""

    seconds: dict[str, float] = field(default_factory=dict)
    tests: dict[StatementHit, list[str]] = field(default_factory=dict)
    """Tests by statement."""

    def of(self, hit: StatementHit) -> list[str]:
        return sorted(self.tests.get(hit, ()), key=self.seconds.__getitem__)

    def names(self, module: str) -> list[str]:
        """Return all tests, first those that run functions of a module, the quickest first."""
        own = {name for (where, _), names in self.tests.items() if where == module for name in names}
        return sorted(self.seconds, key=lambda name: (name not in own, self.seconds[name]))


class OnlyTests:
    """Plugin that restricts the collected tests to these, in this order."""

    def __init__(self, names: Sequence[str]) -> None:
        self.place = {name: place for place, name in enumerate(names)}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = sorted(
            (item for item in items if item.nodeid in self.place), key=lambda item: self.place[item.nodeid]
        )


def measure_tests(items: Sequence[pytest.Item], jobs: int) -> TestPaths:
    """Run every test once, in children, so that this process stays unchanged."""
    parts = [_measure_in_child(items[part::jobs]) for part in range(jobs)]
    paths = TestPaths()
    for reading, wait in parts:
        name = ""
        with os.fdopen(reading) as lines:
            for line in map(json.loads, lines):
                if isinstance(line, str):
                    name = line
                elif line[0] <= QUICK_TEST_S:
                    paths.seconds[name] = line[0]
                    for module, number in line[1]:
                        paths.tests.setdefault((module, number), []).append(name)
        if code := wait():
            raise SystemExit(f"{name} fails without any mutant ({code})")
    return paths


def _measure_in_child(items: Sequence[pytest.Item]) -> tuple[int, Wait]:
    """Run tests in a child that reports the name, duration and statements of each."""
    reading, writing = os.pipe()

    def work() -> int:
        with os.fdopen(writing, "w") as out:
            for item in items:
                EXECUTED.clear()
                out.write(json.dumps(item.nodeid) + "\n")
                out.flush()
                began = time.process_time()
                run_items([item])
                out.write(json.dumps([time.process_time() - began, sorted(EXECUTED)]) + "\n")
        return 0

    wait = run_isolated(work, 3600)
    os.close(writing)
    return reading, wait
