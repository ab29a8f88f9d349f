"""``gate``: the motion gate's whole state space. No path leads to a moving frame without all that it needs.

Explicit states, breadth first, to closure: the real gate, conversation, permit and bus core of each family and intent,
on a grid of time, against a witness with books of its own and its own reading of the manuals' bytes. The seed changes
nothing; a budget below that of the committed report takes a smaller domain, and says so.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivebus.drives.permissives import CommandKind
from verification.campaign import Campaign, CampaignRun
from verification.model_check.core_copy import unlisted_attributes
from verification.model_check.gate_state import GateState
from verification.model_check.model_subject import MODEL_NAMES, model_subject
from verification.model_check.search import SearchDomain, SearchResult, StateSearch
from verification.model_check.time_grid import TimeGrid
from verification.model_check.wire_state import WireState

COARSE_GRID, HALF_SECOND_GRID, FINE_GRID = TimeGrid(1.0, fine=False), TimeGrid(0.5, fine=False), TimeGrid(1.0)
"""A start lives two seconds, a setpoint five; a frame takes a tick on the wire, and its answer's gap another."""


@dataclass(frozen=True, slots=True)
class Exploration:
    """One exploration."""

    model: str
    kind: CommandKind
    grid: TimeGrid
    domain: SearchDomain
    world: type[GateState] = GateState

    @property
    def name(self) -> str:
        how = "wire" if self.world is WireState else f"{self.grid.tick_s:g} s" + ", fine" * self.grid.fine
        how += ", spoiled" * self.domain.rare
        return f"{self.model}/{self.kind.value}, {how}"


def full_explorations() -> list[Exploration]:
    """Every family and intent; starts also by half seconds and at the instants just after the ticks; what may be sent
    again also with spoiled replies and cancelled asks."""
    plain, brief = SearchDomain(rare=False), SearchDomain(rare=False, without=frozenset({"raw", "sleep"}))
    spoiled = SearchDomain(without=frozenset({"raw", "sleep", "hang", "everyone", "remove", "lose", "latch"}))
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
    parts += [
        Exploration("c320", CommandKind.START, HALF_SECOND_GRID, plain),
        Exploration("c320", CommandKind.START, FINE_GRID, brief),
    ]
    parts.append(Exploration("vc660", CommandKind.SETPOINT, COARSE_GRID, spoiled))
    return parts + [Exploration(model, CommandKind.START, COARSE_GRID, plain, WireState) for model in MODEL_NAMES]


EVENTS_NOT_IN_CI = frozenset({"hang", "raw", "sleep", "remove"})
"""What the small domain leaves to the full one."""


def ci_explorations() -> list[Exploration]:
    """One intent of each family, without some events; the gate's questions without their doubles."""
    parts = [
        Exploration(
            "c320", CommandKind.START, COARSE_GRID, SearchDomain(rare=False, small=True, without=EVENTS_NOT_IN_CI)
        )
    ]
    less = SearchDomain(rare=False, small=True, without=EVENTS_NOT_IN_CI | {"lose", "latch"})
    others = (("dzb100", CommandKind.SETPOINT), ("vc660", CommandKind.JOG), ("df800", CommandKind.START))
    return parts + [Exploration(model, kind, COARSE_GRID, less) for model, kind in others]


NOT_EXPLORED = (
    "lengths: every frame, gap, quarantine and late answer takes one tick",
    "two commands of one drive at a time, and a permit kept while another command is made",
    "polls, and requests of others that come while a command waits",
    "how damaged answers add up to a bad link: the gate is asked with every link, and told by no wire",
    "answers that come late, and all that follows from disbelief; other campaigns do",
)
"""What the states leave out, for whoever reads the report."""


def run(session: CampaignRun) -> None:
    """Explore; ``session.budget`` is the most states, all parts together."""
    closed = True
    parts = full_explorations() if session.budget >= CAMPAIGN.full_budget else ci_explorations()
    for part in parts:
        search = StateSearch(
            model_subject(part.model, part.kind, part.grid), part.domain, session.remaining, part.world
        )
        if names := unlisted_attributes(search.initial_state().core):
            raise TypeError(f"the bus has what the campaign does not know: {', '.join(names)}")
        found = search.run(session.add_trials)
        closed = closed and found.closed
        _report_exploration(session, part, found, search.digest)
    session.figures["closed"] = closed
    session.figures["domain"] = "full" if parts == full_explorations() else "small"
    session.figures["not explored"] = NOT_EXPLORED


def _report_exploration(session: CampaignRun, part: Exploration, found: SearchResult, digest: str) -> None:
    session.trace(f"{part.name}: {found.states} states, {found.edges} edges, depth {found.depth}, {digest}")
    for text in found.findings:
        session.violation(text)
    alone = {
        **{f"gate: {name}": count for name, count in sorted(found.refused_by_permissives_only.items())},
        **{f"bus: {name}": count for name, count in sorted(found.refused_by_bus_only.items())},
    }
    for name, count in alone.items():
        session.trace(f"{part.name}: only {name} missing in {count} states")
        session.count(f"only missing, {name}", count)
    if found.closed and not found.moved + found.acted:
        session.violation(f"{part.name}: nothing ever left: the exploration shows nothing")
    session.figures[part.name] = {
        "states": found.states,
        "edges": found.edges,
        "combinations asked of the gate": found.decisions,
        "moving frames left": found.moved,
        "setting frames left": found.acted,
        "depth": found.depth,
        "closed": found.closed,
        "states where only this was missing": alone,
    }
    for name, count in (("states", found.states), ("edges", found.edges), ("moving edges", found.moved)):
        session.count(name, count)
        session.count(f"{part.model}: {name}", count)
    session.count("setting edges", found.acted)
    session.count("combinations asked of the gate", found.decisions)


CAMPAIGN = Campaign(
    name="gate",
    summary={"en": "Every path to a frame that moves a motor.", "zh": "通往电机动作帧的每条路径。"},
    unit="states",
    evidence_for=("I1",),
    full_budget=2_000_000,
    ci_budget=60_000,
    run=run,
)
