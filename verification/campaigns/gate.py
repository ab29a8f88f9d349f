"""``gate``: model check of the permissives; no path leads to a frame that moves a motor without all permissives.

Explicit states are searched breadth first until no new one is found: the real permissives, operation, permit and bus
core of each model and command kind, on a grid of time, against a permit monitor with its own records and its own
reading of the manuals. The seed has no effect; a budget below that of the committed report searches a smaller domain.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivebus.drives.permissives import CommandKind
from verification.campaign import Campaign, CampaignRun
from verification.model_check.core_copy import unlisted_attributes
from verification.model_check.gate_state import GateState
from verification.model_check.model_subject import MODEL_NAMES, TimeGrid, model_subject
from verification.model_check.search import SearchDomain, SearchResult, StateSearch
from verification.model_check.wire_state import WireState

COARSE_GRID, HALF_SECOND_GRID, FINE_GRID = TimeGrid(1.0, fine=False), TimeGrid(0.5, fine=False), TimeGrid(1.0)
"""Grids: a start expires after two seconds, a setpoint after five; a frame takes one tick, and so does the gap after
it."""


@dataclass(frozen=True, slots=True)
class Exploration:
    """Search of the campaign: model, command kind, grid and domain."""

    model: str
    kind: CommandKind
    grid: TimeGrid
    domain: SearchDomain
    state_class: type[GateState] = GateState

    @property
    def name(self) -> str:
        grid = "wire" if self.state_class is WireState else f"{self.grid.tick_s:g} s" + ", fine" * self.grid.fine
        grid += ", damaged" * self.domain.rare
        return f"{self.model}/{self.kind.value}, {grid}"


def full_explorations() -> list[Exploration]:
    """Return all searches: every model and command kind, starts also on finer grids, retried commands also with damaged
    replies and cancelled requests."""
    plain, brief = SearchDomain(rare=False), SearchDomain(rare=False, without=frozenset({"raw", "sleep"}))
    damaged = SearchDomain(without=frozenset({"raw", "sleep", "hang", "everyone", "remove", "lose", "inhibit"}))
    parts = [
        Exploration(model, kind, COARSE_GRID, plain)
        for model in MODEL_NAMES
        for kind in (CommandKind.START, CommandKind.SETPOINT)
    ]
    parts += [
        Exploration(model, kind, COARSE_GRID, brief)
        for model in MODEL_NAMES
        for kind in (CommandKind.JOG, CommandKind.RESET)
    ]
    parts += [Exploration("vc660", kind, COARSE_GRID, brief) for kind in (CommandKind.PAUSE, CommandKind.RAMP_HOLD)]
    parts += [
        Exploration("c320", CommandKind.START, HALF_SECOND_GRID, plain),
        Exploration("c320", CommandKind.START, FINE_GRID, brief),
    ]
    parts.append(Exploration("vc660", CommandKind.SETPOINT, COARSE_GRID, damaged))
    return parts + [Exploration(model, CommandKind.START, COARSE_GRID, plain, WireState) for model in MODEL_NAMES]


EVENTS_NOT_IN_CI = frozenset({"hang", "raw", "sleep", "remove", "lose", "inhibit"})
"""Events that only the full domain contains."""


def ci_explorations() -> list[Exploration]:
    """Return the searches of continuous integration: one command kind of each model, with fewer events and inputs."""
    less = SearchDomain(rare=False, small=True, without=EVENTS_NOT_IN_CI)
    kinds = dict.fromkeys(("c320", "vc660", "df800"), CommandKind.START) | {"dzb100": CommandKind.SETPOINT}
    return [Exploration(model, kind, COARSE_GRID, less) for model, kind in kinds.items()]


NOT_EXPLORED = (
    "lengths: every frame, gap, quarantine and late answer takes one tick",
    "two commands of one drive at a time, and a permit kept while another command is made",
    "polls, and other requests while a command waits",
    "the error rate of a bad link: it is an input of the gate, not a result of damaged replies",
    "late replies and the recovery from them, which other campaigns cover",
)
"""Limits of the model, for the report."""


def run(campaign_run: CampaignRun) -> None:
    """Run all searches; the budget is the largest number of states of all searches together."""
    closed = True
    parts = full_explorations() if campaign_run.budget >= CAMPAIGN.full_budget else ci_explorations()
    for part in parts:
        search = StateSearch(
            model_subject(part.model, part.kind, part.grid), part.domain, campaign_run.remaining, part.state_class
        )
        if names := unlisted_attributes(search.initial_state().core):
            raise TypeError(f"the bus has what the campaign does not know: {', '.join(names)}")
        found = search.run(campaign_run.add_trials)
        closed = closed and found.closed
        _report_exploration(campaign_run, part, found, search.digest)
    campaign_run.figures["closed"] = closed
    campaign_run.figures["domain"] = "full" if parts == full_explorations() else "small"
    campaign_run.figures["not explored"] = NOT_EXPLORED


def _report_exploration(campaign_run: CampaignRun, part: Exploration, found: SearchResult, digest: str) -> None:
    campaign_run.trace(f"{part.name}: {found.states} states, {found.edges} edges, depth {found.depth}, {digest}")
    for text in found.findings:
        campaign_run.violation(text)
    only_missing = {
        **{f"gate: {name}": count for name, count in sorted(found.refused_by_permissives_only.items())},
        **{f"bus: {name}": count for name, count in sorted(found.refused_by_bus_only.items())},
    }
    for name, count in only_missing.items():
        campaign_run.trace(f"{part.name}: only {name} missing in {count} states")
        campaign_run.count(f"only missing, {name}", count)
    if found.closed and not found.motion_frames + found.setting_frames:
        campaign_run.violation(f"{part.name}: nothing ever left: the exploration shows nothing")
    campaign_run.figures[part.name] = {
        "states": found.states,
        "edges": found.edges,
        "combinations of inputs decided": found.decisions,
        "moving frames left": found.motion_frames,
        "setting frames left": found.setting_frames,
        "depth": found.depth,
        "closed": found.closed,
        "states where only this was missing": only_missing,
    }
    for name, count in (("states", found.states), ("edges", found.edges), ("moving edges", found.motion_frames)):
        campaign_run.count(name, count)
        campaign_run.count(f"{part.model}: {name}", count)
    campaign_run.count("setting edges", found.setting_frames)
    campaign_run.count("combinations of inputs decided", found.decisions)


CAMPAIGN = Campaign(
    name="gate",
    summary={"en": "Every path to a frame that moves a motor.", "zh": "通往电机动作帧的每条路径。"},
    unit="states",
    evidence_for=("I1",),
    full_budget=2_000_000,
    ci_budget=20_000,
    run=run,
)
