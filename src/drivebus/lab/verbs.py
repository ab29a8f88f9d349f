"""``drivebus lab``: one verb a campaign, ``all`` of them, and the checklist for real hardware."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

from drivebus.cli import options, voice
from drivebus.cli.command import LazyGroup, Option, Verb
from drivebus.cli.exits import Exit
from drivebus.cli.progress import Bar
from drivebus.lab import report
from drivebus.lab.campaign import NAMES, Campaign, Session, find, perform


def _options() -> list[click.Parameter]:
    return [
        Option(["--seed"], type=options.SEED, default=1, metavar="N", example="--seed 7", key="lab_verb.option.seed"),
        Option(
            ["--budget"],
            type=options.Number(1, 10**12),
            metavar="N",
            example="--budget 10000",
            key="lab_verb.option.budget",
        ),
        Option(["--slice"], is_flag=True, key="lab_verb.option.slice"),
        Option(["--trace"], type=options.FILE, metavar="FILE", key="lab_verb.option.trace"),
        Option(["--report"], type=options.FOLDER, metavar="FOLDER", key="lab_verb.option.report"),
    ]


def _verb(name: str) -> Verb:
    def run(**options: Any) -> Exit:
        return _run([name], **options)

    return Verb(name, topic=f"lab.{name}", callback=run, params=_options(), examples=(f"drivebus lab {name} --slice",))


def _run(
    names: Iterable[str], seed: int, budget: int | None, slice: bool, trace: Path | None, report: Path | None
) -> Exit:
    """One campaign after the other; exit code 1 where anything was violated."""
    violated = 0
    for name in names:
        campaign = find(name)
        trials = budget or (campaign.slice if slice else campaign.full)
        violated += _campaign(campaign, seed, trials, trace, report).violated
    return Exit.REFUSED if violated else Exit.DONE


def _campaign(campaign: Campaign, seed: int, budget: int, trace: Path | None, folder: Path | None) -> Session:
    with Bar() as bar:
        session = Session(
            campaign.name, seed, budget, lambda done: bar.count(f"lab {campaign.name}", done, budget, campaign.unit),
            commit=report.commit(),
        )  # fmt: skip
        if trace is None:
            perform(campaign, session)
        else:
            with trace.open("a", encoding="utf-8") as file:
                session.listener = lambda line: print(line, file=file)
                perform(campaign, session)
    _tell(campaign, session, folder)
    return session


def _tell(campaign: Campaign, session: Session, folder: Path | None) -> None:
    found = report.document(campaign, session)
    voice.document(found, stream=True)
    shown = {key: found[key] for key in ("campaign", "trials", "unit", "violations", "seed", "trace_sha256")}
    voice.tell("lab_verb.done" if not session.violated else "lab_verb.violated", **shown, bound=found["upper_bound_95"])
    for text in session.violations:
        voice.show(f"  {text}")
    for name, value in {**found["counts"], **found["figures"], **found["machine"]}.items():
        voice.show(f"  {name}: {value}")
    if folder is not None:
        voice.tell("lab_verb.written", path=report.write(folder, campaign, session))


for _name in NAMES:
    globals()[_name.replace("-", "_")] = _verb(_name)

everything = Verb(
    "all",
    topic="lab.all",
    callback=lambda **options: _run(NAMES, **options),
    params=_options(),
    examples=("drivebus lab all --slice",),
)

command = LazyGroup(
    "lab",
    topic="lab",
    sections={
        "lab_verb.section.campaigns": {name: f"drivebus.lab.verbs:{name}" for name in NAMES},
        "lab_verb.section.more": {"all": "drivebus.lab.verbs:everything", "hardware": "drivebus.lab.hardware:command"},
    },
    no_args_is_help=True,
    examples=("drivebus lab all --slice", "drivebus lab late --seed 7 --budget 10000 --trace late.txt"),
)
