"""``drivebus lab``: one verb a campaign, ``all`` of them, and the checklist for real hardware."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

from drivebus.cli import options, output
from drivebus.cli.click_ext import CliCommand, LazyGroup, Option
from drivebus.cli.errors import ExitCode
from drivebus.cli.output import ProgressBar
from verification import report
from verification.campaign import CAMPAIGN_NAMES, Campaign, CampaignRun, load_campaign, run_campaign


def _options() -> list[click.Parameter]:
    return [
        Option(["--seed"], type=options.SEED, default=1, metavar="N", example="--seed 7", key="lab_verb.option.seed"),
        Option(
            ["--budget"],
            type=options.NumberType(1, 10**12),
            metavar="N",
            example="--budget 10000",
            key="lab_verb.option.budget",
        ),
        Option(["--slice"], is_flag=True, key="lab_verb.option.slice"),
        Option(["--trace"], type=options.FILE, metavar="FILE", key="lab_verb.option.trace"),
        Option(["--report"], type=options.FOLDER, metavar="FOLDER", key="lab_verb.option.report"),
    ]


def _verb(name: str) -> CliCommand:
    def run(**options: Any) -> ExitCode:
        return _run([name], **options)

    return CliCommand(
        name, help_key=f"lab.{name}", callback=run, params=_options(), examples=(f"drivebus lab {name} --slice",)
    )


def _run(
    names: Iterable[str], seed: int, budget: int | None, slice: bool, trace: Path | None, report: Path | None
) -> ExitCode:
    """One campaign after the other; exit code 1 where anything was violated."""
    violated = 0
    for name in names:
        campaign = load_campaign(name)
        trials = budget or (campaign.ci_budget if slice else campaign.full_budget)
        violated += _campaign(campaign, seed, trials, trace, report).violation_count
    return ExitCode.FAILED if violated else ExitCode.DONE


def _campaign(campaign: Campaign, seed: int, budget: int, trace: Path | None, folder: Path | None) -> CampaignRun:
    with ProgressBar() as bar:
        session = CampaignRun(
            campaign.name,
            seed,
            budget,
            lambda done: bar.update_count(f"lab {campaign.name}", done, budget, campaign.unit),
            commit=report.current_commit(),
        )
        if trace is None:
            run_campaign(campaign, session)
        else:
            with trace.open("a", encoding="utf-8") as file:
                session.listener = lambda line: print(line, file=file)
                run_campaign(campaign, session)
    _tell(campaign, session, folder)
    return session


def _tell(campaign: Campaign, session: CampaignRun, folder: Path | None) -> None:
    found = report.report_document(campaign, session)
    output.print_json(found, stream=True)
    shown = {key: found[key] for key in ("campaign", "trials", "unit", "violations", "seed", "trace_sha256")}
    output.print_message(
        "lab_verb.done" if not session.violation_count else "lab_verb.violated", **shown, bound=found["upper_bound_95"]
    )
    for text in session.violations:
        output.print_text(f"  {text}")
    for name, value in {**found["counts"], **found["figures"], **found["machine"]}.items():
        output.print_text(f"  {name}: {value}")
    if folder is not None:
        output.print_message("lab_verb.written", path=report.write_report(folder, campaign, session))


for _name in CAMPAIGN_NAMES:
    globals()[_name.replace("-", "_")] = _verb(_name)

everything = CliCommand(
    "all",
    help_key="lab.all",
    callback=lambda **options: _run(CAMPAIGN_NAMES, **options),
    params=_options(),
    examples=("drivebus lab all --slice",),
)

command = LazyGroup(
    "lab",
    help_key="lab",
    sections={
        "lab_verb.section.campaigns": {name: f"verification.cli:{name}" for name in CAMPAIGN_NAMES},
        "lab_verb.section.more": {"all": "verification.cli:everything", "hardware": "drivebus.cli.acceptance:command"},
    },
    no_args_is_help=True,
    examples=("drivebus lab all --slice", "drivebus lab late --seed 7 --budget 10000 --trace late.txt"),
)
