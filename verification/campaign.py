"""What every campaign is: a name, a unit that it counts trials in, and a function that runs them.

A campaign learns its seed and budget from a ``Session`` and tells it everything: trials, counts, violations, and one
line of text for each thing that happened. The same seed and budget give the same lines, and so the same SHA-256.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from importlib import import_module
from random import Random
from typing import Any

MAX_LISTED_VIOLATIONS = 50
"""So many violations are told in full; the rest is counted."""
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
    "doors",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Campaign:
    """A named series of trials. ``full_budget`` is that of the committed report, both budgets are in ``unit``."""

    name: str
    unit: str
    """What a trial is, plural: "bytes", "transactions", "instants"."""
    evidence_for: tuple[str, ...]
    """Invariants and traps that it checks (docs/explanation/verification.md), e.g. "I5", "T04"."""
    full_budget: int
    ci_budget: int
    run: Callable[[CampaignRun], None]
    summary: Mapping[str, str]
    """One sentence in each language ("en", "zh")."""
    report: str = ""
    """Name of the report's file without its ending; ``lab-<name>`` where empty."""

    @property
    def stem(self) -> str:
        return self.report or f"lab-{self.name}"


@dataclass(frozen=True, slots=True)
class PartResult:
    """What one part of a run found."""

    seed: int
    trials: int
    counts: Counter[str]
    figures: dict[str, object]
    machine: dict[str, object]
    violations: list[str]
    violation_count: int
    digest: str


@dataclass(slots=True)
class CampaignRun:
    """One run of a campaign: its seed and budget, and what came of it."""

    campaign: str
    seed: int
    budget: int
    progress: Callable[[int], None] = lambda done: None
    """Called with the trials done so far."""
    listener: Callable[[str], None] | None = None
    """Gets every trace line, for people who read them."""
    commit: str = ""
    """What was tried, looked up when the run began: a checkout may go on while a long campaign runs."""
    trials: int = 0
    counts: Counter[str] = field(default_factory=Counter)
    figures: dict[str, object] = field(default_factory=dict)
    """What was measured; virtual seconds, ratios and bytes only, never this machine's time."""
    machine: dict[str, object] = field(default_factory=dict)
    """What depends on the machine (a real-time factor, memory); told apart in the report."""
    violations: list[str] = field(default_factory=list)
    violation_count: int = 0
    _trace_hash: Any = field(default_factory=sha256, repr=False)

    @property
    def remaining(self) -> int:
        """Trials still to do."""
        return max(0, self.budget - self.trials)

    def rng(self, *names: object) -> Random:
        """Chance of its own for each part of a campaign: one part more does not change the others."""
        return Random(f"{self.campaign}/{self.seed}/" + "/".join(map(str, names)))

    def add_trials(self, trials: int = 1) -> None:
        """So many more trials are done."""
        self.trials += trials
        self.progress(self.trials)

    def count(self, name: str, amount: int = 1) -> None:
        self.counts[name] += amount

    def trace(self, text: str) -> None:
        """One thing that happened, readable by itself; part of the digest."""
        self._trace_hash.update(text.encode() + b"\n")
        if self.listener is not None:
            self.listener(text)

    def violation(self, text: str) -> None:
        """Something that must never be. ``text`` names what, when and with which seed it is seen again."""
        self.trace(f"VIOLATION {text}")
        self.violation_count += 1
        if len(self.violations) < MAX_LISTED_VIOLATIONS:
            self.violations.append(text)

    def merge(self, part: PartResult) -> None:
        """Take over what a part of this run found."""
        self.trace(f"seed {part.seed}: {part.trials} {self.campaign}, trace {part.digest}")
        self.counts.update(part.counts)
        self.figures |= part.figures
        self.machine |= part.machine
        self.violation_count += part.violation_count
        self.violations += part.violations[: MAX_LISTED_VIOLATIONS - len(self.violations)]
        self.add_trials(part.trials)

    @property
    def digest(self) -> str:
        """SHA-256 of all lines."""
        return str(self._trace_hash.hexdigest())

    def result(self) -> PartResult:
        """What was found, as values: for a part of a campaign that ran in a process of its own."""
        return PartResult(
            self.seed,
            self.trials,
            self.counts,
            self.figures,
            self.machine,
            self.violations,
            self.violation_count,
            self.digest,
        )


def load_campaign(name: str) -> Campaign:
    """The campaign of this name. Raises KeyError."""
    if name not in CAMPAIGN_NAMES:
        raise KeyError(name)
    found: Campaign = import_module(f"verification.campaigns.{name}").CAMPAIGN
    return found


def run_campaign(campaign: Campaign, session: CampaignRun) -> CampaignRun:
    """Run it; whatever escapes from it is a violation too (I8), never a traceback that hides the rest."""
    try:
        campaign.run(session)
    except Exception as error:
        session.violation(f"{type(error).__name__} escaped: {error}")
        raise
    return session
