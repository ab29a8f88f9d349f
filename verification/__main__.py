"""``make verify ARGS="stop --seed 1"`` or ``python -m verification stop --seed 1``: run verification campaigns."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path

from verification import report
from verification.campaign import CAMPAIGN_NAMES, Campaign, CampaignRun, load_campaign, run_campaign


class _Options(argparse.ArgumentParser):
    """Options whose help alone loads every campaign: ``unauthorized`` needs packages that PyPy may lack."""

    def format_help(self) -> str:
        """Return the help with a line for each campaign."""
        campaigns = "\n".join(f"  {name:12} {load_campaign(name).summary['en']}" for name in CAMPAIGN_NAMES)
        self.epilog = f"campaigns:\n{campaigns}\n  all          all of them"
        return super().format_help()


def main(arguments: list[str] | None = None) -> int:
    """Run the named campaigns one after the other; return 1 where a violation was found."""
    options = _Options(
        prog="python -m verification",
        description="Campaigns against simulated drives in virtual time. The same seed gives the same trace.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    options.add_argument("campaigns", nargs="+", choices=[*CAMPAIGN_NAMES, "all"], metavar="CAMPAIGN")
    options.add_argument("--seed", type=int, default=1, help="seed of everything random")
    options.add_argument("--budget", type=int, help="trials, in the campaign's unit; default: those of the full run")
    options.add_argument("--only", nargs="+", default=(), help="variants (late) and codecs (fuzz, flips) to run alone")
    options.add_argument("--slice", action="store_true", help="the short run of continuous integration")
    options.add_argument("--trace", type=Path, help="append every event to this file, one a line")
    options.add_argument("--report", type=Path, metavar="FOLDER", help="write the reports into this folder")
    options.add_argument("--json", action="store_true", help="print the report instead of a summary")
    chosen = options.parse_args(arguments)
    violations = 0
    for name in CAMPAIGN_NAMES if "all" in chosen.campaigns else chosen.campaigns:
        campaign = load_campaign(name)
        budget = chosen.budget or (campaign.ci_budget if chosen.slice else campaign.full_budget)
        run = CampaignRun(
            campaign=name,
            seed=chosen.seed,
            budget=budget,
            only=frozenset(chosen.only),
            progress=_progress(campaign, budget),
            commit=report.current_commit(),
        )
        if chosen.trace is None:
            run_campaign(campaign, run)
        else:
            with chosen.trace.open("a", encoding="utf-8") as file:
                run.listener = lambda line, file=file: print(line, file=file)
                run_campaign(campaign, run)
        if chosen.report is not None:  # before anything is printed: a closed pipe loses no report
            print(f"Report: {report.write_report(chosen.report, campaign, run)}", file=sys.stderr)
        _print(campaign, run, as_json=chosen.json)
        violations += run.violation_count
    return int(violations > 0)


def _progress(campaign: Campaign, budget: int) -> Callable[[int], None]:
    """Return a function that shows the progress in a terminal at each further percent."""
    if not sys.stderr.isatty():
        return lambda done: None
    shown = -1

    def show(done: int) -> None:
        nonlocal shown
        percent = min(100, 100 * done // max(budget, 1))
        if percent > shown:
            shown = percent
            end = "\n" if percent == 100 else ""
            print(f"\r{campaign.name}: {done:,} of {budget:,} {campaign.unit}", end=end, file=sys.stderr, flush=True)

    return show


def _print(campaign: Campaign, run: CampaignRun, *, as_json: bool) -> None:
    found = report.report_document(campaign, run)
    if as_json:
        print(json.dumps(found, ensure_ascii=False, default=str))
        return
    result = (
        f"{run.violation_count} VIOLATIONS"
        if run.violation_count
        else f"no violation; fewer than {found['upper_bound_95']} of them at 95 % confidence"
    )
    print(f"{campaign.name}: {run.trials} {campaign.unit}, seed {run.seed}: {result}. Trace {run.digest}.")
    for text in run.violations:
        print(f"  {text}")
    for name, value in {**found["counts"], **found["figures"], **found["machine"]}.items():
        print(f"  {name}: {value}")


if __name__ == "__main__":
    sys.exit(main())
