"""Run of the tests against one mutant after another, each in its own process.

A mutant within a function replaces the code of loaded functions, and the tests that run its statement follow, quickest
first. A mutant of what is computed at import, or a survivor whose statement also runs at import, is loaded in a new
process; the tests that run the module come first.
"""

from __future__ import annotations

import ast
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import hypothesis
import pytest

from mutation.children import (
    MUST_RELOAD,
    SURVIVED,
    UNTESTED,
    ExitAtFirstFailure,
    OnlyTests,
    TestPaths,
    Wait,
    measure_tests,
    run_isolated,
    run_items,
    verdict,
)
from mutation.load import EXECUTED, MutatedModuleFinder, StatementHit, insert_probes, loaded_functions, swap
from mutation.mutate import Mutant, apply, mutants

ROOT = Path(__file__).resolve().parents[2]
RELOAD_TIMEOUT_S = 240
"""Processor time for all tests of a module that was loaded with a mutant, in seconds."""
ALWAYS_LOADED = (
    "pytest_asyncio.plugin",
    "hypothesis.strategies",
    "pydantic",
    "pymodbus.client",
    "fastcrc",
    "fastapi",
    "httpx",
    "argon2",
    "click.testing",
    "prometheus_client",
)
"""Third-party modules that are loaded once, not by each child."""
OPTIONS = ["-p", "no:cacheprovider", "-p", "no:xdist", "-p", "no:terminal", "-s"]
MutantFilter = Callable[[str, Mutant], bool]


@dataclass(slots=True)
class JudgedMutant:
    """Mutant by its number in the module, with its verdict."""

    module: str
    number: int
    verdict: str
    reloaded: bool
    """Whether it must be or was loaded in a new process."""
    tests: int = 0


def path_of(module: str) -> Path:
    return ROOT / "src" / Path(*module.split(".")).with_suffix(".py")


def tree_of(module: str) -> ast.Module:
    return ast.parse(path_of(module).read_bytes())


class MutationPlugin:
    """Plugin that tries the mutants with the collected tests instead of running them."""

    def __init__(self, modules: Sequence[str], wanted: MutantFilter, jobs: int, out: TextIO) -> None:
        self.modules, self.wanted, self.jobs, self.out = modules, wanted, jobs, out

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        at_load = frozenset(EXECUTED)
        items = {item.nodeid: item for item in session.items}
        paths = measure_tests(session.items, self.jobs)
        for module in self.modules:
            self._write({"module": module, "names": paths.names(module)})
            for judged in judge_in_order(self._start_children(module, items, paths, at_load), self.jobs):
                self._write([judged.module, judged.number, judged.verdict, judged.reloaded, judged.tests])
        return True

    def _write(self, what: object) -> None:
        self.out.write(json.dumps(what) + "\n")
        self.out.flush()

    def _start_children(
        self, module: str, items: dict[str, pytest.Item], paths: TestPaths, at_load: frozenset[StatementHit]
    ) -> Iterator[tuple[JudgedMutant, Wait]]:
        path, tree = str(path_of(module)), tree_of(module)
        originals = loaded_functions(path)
        for number, mutant in enumerate(mutants(tree)):
            if not self.wanted(module, mutant):
                continue
            hit = (module, mutant.statement)
            names = paths.of(hit)
            judged = JudgedMutant(module, number, SURVIVED, mutant.at_load or hit in at_load, len(names))
            if mutant.at_load or not names:
                judged.verdict = SURVIVED if judged.reloaded else UNTESTED
                yield judged, lambda: 0
                continue

            def work(mutant: Mutant = mutant, names: list[str] = names) -> int:
                apply(mutant)
                try:
                    swap(originals, compile(tree, path, "exec", dont_inherit=True))
                except ValueError:  # the closure is another
                    return MUST_RELOAD
                return run_items([items[name] for name in names])

            yield judged, run_isolated(work, 10 + 5 * sum(map(paths.seconds.__getitem__, names)))


def judge_in_order(started: Iterable[tuple[JudgedMutant, Wait]], jobs: int) -> Iterator[JudgedMutant]:
    """Yield the verdicts in order, with at most ``jobs`` children at a time."""
    running: list[tuple[JudgedMutant, Wait]] = []

    def finish_oldest() -> JudgedMutant:
        judged, wait = running.pop(0)
        code = wait()
        judged.verdict = judged.verdict if judged.verdict == UNTESTED else verdict(code)
        judged.reloaded = judged.reloaded or code == MUST_RELOAD
        return judged

    for mutant in started:
        running.append(mutant)
        if len(running) >= jobs:
            yield finish_oldest()
    while running:
        yield finish_oldest()


def try_in_functions(
    modules: Sequence[str], tests: Sequence[str], wanted: MutantFilter, jobs: int
) -> tuple[list[JudgedMutant], dict[str, list[str]]]:
    """Return the mutants within functions, and the tests of each module in the best order for reloaded mutants."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        code = 3
        try:
            os.close(reading)
            sys.meta_path.insert(0, MutatedModuleFinder(frozenset(modules), insert_probes))
            plugin = MutationPlugin(modules, wanted, jobs, os.fdopen(writing, "w"))
            code = int(pytest.main([*OPTIONS, *tests], plugins=[plugin, ExitAtFirstFailure()]))
        finally:
            os._exit(code)
    os.close(writing)
    found: list[JudgedMutant] = []
    names: dict[str, list[str]] = {}
    with os.fdopen(reading) as lines:
        for line in map(json.loads, lines):
            if isinstance(line, dict):
                names[line["module"]] = line["names"]
                print(line["module"], file=sys.stderr, flush=True)
            else:
                found.append(JudgedMutant(*line))
                if found[-1].verdict in (SURVIVED, UNTESTED) and not found[-1].reloaded:
                    print(verdict_line(found[-1]), flush=True)
    if code := os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]):
        raise SystemExit(f"pytest ended with {code}")
    return found, names


def verdict_line(judged: JudgedMutant) -> str:
    """Return one line about a mutant."""
    mutant = mutants(tree_of(judged.module))[judged.number]
    where = f"{judged.module}:{mutant.line} {mutant.scope}"
    return f"{where} [{mutant.kind}] {mutant.description()}: {judged.verdict}, {judged.tests} tests"


def retry_reloaded(found: Sequence[JudgedMutant], names: dict[str, list[str]], jobs: int) -> Iterator[JudgedMutant]:
    """Try mutants that must be loaded, each in a process that has not loaded the package."""

    def start_children() -> Iterator[tuple[JudgedMutant, Wait]]:
        for judged in found:
            tree = tree_of(judged.module)
            mutant = mutants(tree)[judged.number]

            def work(judged: JudgedMutant = judged, mutant: Mutant = mutant, tree: ast.Module = tree) -> int:
                apply(mutant)
                sys.meta_path.insert(
                    0,
                    MutatedModuleFinder(
                        frozenset({judged.module}), lambda _, fresh: fresh.__setattr__("body", tree.body)
                    ),
                )
                ours = names[judged.module]
                files = dict.fromkeys(name.split("::")[0] for name in ours)
                return int(pytest.main([*OPTIONS, *files], plugins=[ExitAtFirstFailure(), OnlyTests(ours)]))

            yield judged, run_isolated(work, RELOAD_TIMEOUT_S)

    yield from judge_in_order(start_children(), jobs)


def settle_hypothesis() -> None:
    """Make property tests deterministic without shrinking, and load what all children need."""
    phases = (hypothesis.Phase.explicit, hypothesis.Phase.generate)
    health: Any = list(hypothesis.HealthCheck)
    hypothesis.settings.register_profile(
        "mutation", phases=phases, database=None, derandomize=True, deadline=None, suppress_health_check=health
    )
    hypothesis.settings.load_profile("mutation")
    for name in ALWAYS_LOADED:
        __import__(name)
