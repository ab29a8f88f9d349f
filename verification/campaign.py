"""Campaigns: a name, a unit of trials and a function that runs them.

A campaign takes its seed and budget from a ``CampaignRun`` and reports trials, counts, violations and trace lines to
it. The same seed and budget give the same lines, and so the same SHA-256.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from importlib import import_module
from multiprocessing import get_context
from random import Random
from typing import Any, TypeVar

MAX_LISTED_VIOLATIONS = 50
"""Violations listed in full; the rest is counted."""
CAMPAIGN_NAMES = (
    "fuzz",
    "flips",
    "late",
    "commands",
    "stop",
    "fairness",
    "replug",
    "matrix",
    "gate",
    "soak",
    "clock",
    "failures",
    "audit",
    "unauthorized",
    "statements",
    "story",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """Named series of trials; ``full_budget`` is the budget of the committed report, in ``unit``."""

    name: str
    unit: str
    """Unit of a trial, plural: "bytes", "transactions", "instants"."""
    evidence_for: tuple[str, ...]
    """Invariants and traps that the campaign checks (docs/explanation/verification.md), e.g. "I5", "T04"."""
    full_budget: int
    ci_budget: int
    run: Callable[[CampaignRun], None]
    summary: Mapping[str, str]
    """Summary: a sentence in each language, "en" and "zh"."""

    @property
    def report_name(self) -> str:
        """File name of the committed report."""
        return f"campaign-{self.name}.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class PartResult:
    """Result of one part of a run."""

    seed: int
    trials: int
    counts: Counter[str]
    figures: dict[str, object]
    machine: dict[str, object]
    violations: list[str]
    violation_count: int
    digest: str


@dataclass(slots=True, kw_only=True)
class CampaignRun:
    """Run of a campaign: its seed, its budget and its results."""

    campaign: str
    seed: int
    budget: int
    progress: Callable[[int], None] = lambda done: None
    """Called with the number of finished trials."""
    listener: Callable[[str], None] | None = None
    """Called with every trace line."""
    only: frozenset[str] = frozenset()
    """Variants and codecs of ``late``, ``fuzz`` and ``flips`` by name; empty: all."""
    commit: str = ""
    """Commit at the start of the run; the checkout may change while a long campaign runs."""
    trials: int = 0
    counts: Counter[str] = field(default_factory=Counter)
    figures: dict[str, object] = field(default_factory=dict)
    """Measured values: virtual seconds, ratios and bytes, never times of this machine."""
    machine: dict[str, object] = field(default_factory=dict)
    """Values that depend on the machine (real-time factor, memory), separate in the report."""
    violations: list[str] = field(default_factory=list)
    violation_count: int = 0
    _trace_hash: Any = field(default_factory=sha256, repr=False)

    @property
    def remaining(self) -> int:
        """Number of trials left in the budget."""
        return max(0, self.budget - self.trials)

    def covers(self, name: str) -> bool:
        """Return whether the run includes this variant or codec."""
        return not self.only or name in self.only

    def rng(self, *names: object) -> Random:
        """Return a random generator for one part of the campaign, independent of the other parts."""
        return Random(f"{self.campaign}/{self.seed}/" + "/".join(map(str, names)))

    def add_trials(self, trials: int = 1) -> None:
        """Count finished trials and report the progress."""
        self.trials += trials
        self.progress(self.trials)

    def count(self, name: str, amount: int = 1) -> None:
        self.counts[name] += amount

    def trace(self, text: str) -> None:
        """Add one line to the trace and to its hash."""
        self._trace_hash.update(text.encode() + b"\n")
        if self.listener is not None:
            self.listener(text)

    def violation(self, text: str) -> None:
        """Record a violation; ``text`` names what happened, when, and the seed that reproduces it."""
        self.trace(f"VIOLATION {text}")
        self.violation_count += 1
        if len(self.violations) < MAX_LISTED_VIOLATIONS:
            self.violations.append(text)

    def merge(self, part: PartResult) -> None:
        """Add the result of a part of this run."""
        self.trace(f"seed {part.seed}: {part.trials} {self.campaign}, trace {part.digest}")
        self.counts.update(part.counts)
        self.figures |= part.figures
        self.machine |= part.machine
        self.violation_count += part.violation_count
        self.violations += part.violations[: MAX_LISTED_VIOLATIONS - len(self.violations)]
        self.add_trials(part.trials)

    @property
    def digest(self) -> str:
        """SHA-256 of all trace lines."""
        return str(self._trace_hash.hexdigest())

    def result(self) -> PartResult:
        """Return the result as values, for a part that ran in another process."""
        return PartResult(
            seed=self.seed,
            trials=self.trials,
            counts=self.counts,
            figures=self.figures,
            machine=self.machine,
            violations=self.violations,
            violation_count=self.violation_count,
            digest=self.digest,
        )


def load_campaign(name: str) -> Campaign:
    """Return the campaign of this name. Raises KeyError."""
    if name not in CAMPAIGN_NAMES:
        raise KeyError(name)
    found: Campaign = import_module(f"verification.campaigns.{name}").CAMPAIGN
    return found


def run_campaign(campaign: Campaign, campaign_run: CampaignRun) -> CampaignRun:
    """Run a campaign; an exception that escapes from it is recorded as a violation (I8) and raised again."""
    try:
        campaign.run(campaign_run)
    except Exception as error:
        campaign_run.violation(f"{type(error).__name__} escaped: {error}")
        raise
    return campaign_run


# --- work in several processes ----------------------------------------------------------------------------------------

Task = TypeVar("Task")
Result = TypeVar("Result")


def map_in_order(function: Callable[[Task], Result], tasks: Iterable[Task], *, in_process: bool) -> Iterator[Result]:
    """Yield the results in the order of the tasks, from two processes unless ``in_process``."""
    if in_process:
        yield from map(function, tasks)
        return
    with get_context("spawn").Pool(min(2, os.cpu_count() or 1)) as pool:
        yield from pool.imap(function, tasks)
