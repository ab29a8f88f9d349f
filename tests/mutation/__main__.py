"""Mutation testing of codecs, bus, permissives and authorization: ``PYTHONPATH=tests python -m mutation [MODULE ...]``.

Writes docs/reports/mutation.json (with --write); the pages beside it quote ``rows``.
"""

from __future__ import annotations

import argparse
import sys
import time
from functools import cache

from mutation import pages
from mutation.children import SURVIVED, UNTESTED
from mutation.mutate import Mutant
from mutation.report import (
    MUTATED_MODULES,
    MUTATED_SOURCES,
    key,
    mutation_document,
    previous_survivors,
    retried_document,
    unexplained_survivors,
    write_document,
)
from mutation.run import (
    ROOT,
    JudgedMutant,
    MutantFilter,
    retry_reloaded,
    settle_hypothesis,
    try_in_functions,
    verdict_line,
)
from verification.report import current_commit


def main() -> int:
    options = argparse.ArgumentParser(prog="python -m mutation", description=__doc__)
    options.add_argument(
        "modules", nargs="*", help="modules such as drives.permissives or protocols.dzb100; default: all"
    )
    options.add_argument("--kind", help="only changes of this kind, such as comparison")
    options.add_argument("--again", action="store_true", help="only the survivors of the committed report")
    options.add_argument("--jobs", type=int, default=2)
    options.add_argument("--deselect", action="append", default=[], help="a test that fails without any mutant")
    options.add_argument("--write", action="store_true", help="write the figures to docs/reports/mutation.json")
    options.add_argument(
        "--pages", action="store_true", help="run no mutant: write the committed figures with the current reasons"
    )
    chosen = options.parse_args()
    if chosen.pages:
        pages.write(write_document({}))
        return 0
    settle_hypothesis()
    remaining: list[JudgedMutant] = []
    for modules, tests in MUTATED_MODULES:
        wanted = [name for name in modules if not chosen.modules or any(part in name for part in chosen.modules)]
        if wanted:
            began = time.monotonic()
            without = [f"--deselect={test}" for test in chosen.deselect]
            found = try_mutants(
                wanted, [*tests, *without], _mutant_filter(chosen.kind, survivors_only=chosen.again), chosen.jobs
            )
            print(f"{len(found)} mutants, {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
            if chosen.write:
                make_document = retried_document if chosen.again else mutation_document
                pages.write(write_document(make_document(found, current_commit(ROOT, *MUTATED_SOURCES))))
            remaining += [mutant for mutant in found if mutant.verdict in (SURVIVED, UNTESTED)]
    return int(any(unexplained_survivors(mutant) for mutant in remaining))


def _mutant_filter(kind: str | None, *, survivors_only: bool) -> MutantFilter:
    """Return the filter of mutants: of one kind, or the survivors of the committed report."""
    survivors = cache(previous_survivors)

    def wanted(module: str, mutant: Mutant) -> bool:
        return (kind is None or mutant.kind == kind) and (
            not survivors_only or key(module, mutant.scope, mutant.description()) in survivors(module)
        )

    return wanted


def try_mutants(modules: list[str], tests: list[str], wanted: MutantFilter, jobs: int) -> list[JudgedMutant]:
    found, names = try_in_functions(modules, tests, wanted, jobs)
    again = [mutant for mutant in found if mutant.reloaded and mutant.verdict == SURVIVED]
    print(f"{len(found)} tried, {len(again)} to be reloaded", file=sys.stderr, flush=True)
    for mutant in retry_reloaded(again, names, jobs):
        if mutant.verdict == SURVIVED:
            print(verdict_line(mutant), flush=True)
    return found


if __name__ == "__main__":
    sys.exit(main())
