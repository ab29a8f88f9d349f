"""Mutation testing of codecs, the bus's rules, gate and rights: ``PYTHONPATH=tests python -m mutation [MODULE ...]``.

Writes docs/reports/mutation.json (with --write); the pages beside it quote ``rows``.
"""

from __future__ import annotations

import argparse
import sys
import time
from functools import cache

from drivebus.lab.report import commit
from mutation import pages
from mutation.children import SURVIVED, UNTESTED
from mutation.mutate import Mutant
from mutation.report import ROOMS, TRIED, again, document, keep, key, survivors, unexplained
from mutation.run import ROOT, Judged, Wanted, afresh, in_functions, settle, told


def main() -> int:
    options = argparse.ArgumentParser(prog="python -m mutation", description=__doc__)
    options.add_argument("modules", nargs="*", help="such as drives.gate or protocols.dzb; all without any")
    options.add_argument("--kind", help="only changes of this kind, such as comparison")
    options.add_argument("--again", action="store_true", help="only what survived last time, after tests were added")
    options.add_argument("--jobs", type=int, default=2)
    options.add_argument("--deselect", action="append", default=[], help="a test that fails without any mutant")
    options.add_argument("--write", action="store_true", help="keep the figures in docs/reports/mutation.json")
    options.add_argument(
        "--pages", action="store_true", help="try nothing: write the kept figures with the reasons again"
    )
    chosen = options.parse_args()
    if chosen.pages:
        pages.write(keep({}))
        return 0
    settle()
    left: list[Judged] = []
    for modules, tests in ROOMS:
        wanted = [name for name in modules if not chosen.modules or any(one in name for one in chosen.modules)]
        if wanted:
            began = time.monotonic()
            without = [f"--deselect={test}" for test in chosen.deselect]
            found = judged(wanted, [*tests, *without], _choice(chosen.kind, chosen.again), chosen.jobs)
            print(f"{len(found)} mutants, {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
            if chosen.write:
                told_of = again if chosen.again else document
                pages.write(keep(told_of(found, commit(ROOT, *TRIED))))
            left += [one for one in found if one.verdict in (SURVIVED, UNTESTED)]
    return int(any(unexplained(one) for one in left))


def _choice(kind: str | None, left: bool) -> Wanted:
    """Which mutants are tried: of one kind, or those that survived last time."""
    kept = cache(survivors)

    def wanted(module: str, mutant: Mutant) -> bool:
        return (kind is None or mutant.kind == kind) and (
            not left or key(module, mutant.scope, mutant.told()) in kept(module)
        )

    return wanted


def judged(modules: list[str], tests: list[str], wanted: Wanted, jobs: int) -> list[Judged]:
    found, names = in_functions(modules, tests, wanted, jobs)
    again = [one for one in found if one.afresh and one.verdict == SURVIVED]
    print(f"{len(found)} tried, {len(again)} to be loaded", file=sys.stderr, flush=True)
    for one in afresh(again, names, jobs):
        if one.verdict == SURVIVED:
            print(told(one), flush=True)
    return found


if __name__ == "__main__":
    sys.exit(main())
