"""``gate``: the motion gate's whole state space. No path leads to a moving frame without all that it needs.

Explicit states, breadth first, to closure: the real gate, conversation, permit and bus core of each family and intent,
on a grid of time, against a witness with books of its own and its own reading of the manuals' bytes. The seed changes
nothing; a budget below that of the committed report takes a smaller domain, and says so.
"""

from __future__ import annotations

from dataclasses import dataclass

from drivebus.drives.gate import Kind
from drivebus.lab.campaign import Campaign, Session
from drivebus.lab.gate.copy import unlisted
from drivebus.lab.gate.grid import Grid
from drivebus.lab.gate.search import Domain, Found, Search
from drivebus.lab.gate.subject import MODELS, subject
from drivebus.lab.gate.wire import WireWorld
from drivebus.lab.gate.world import World

COARSE, HALVES, FINE = Grid(1.0, fine=False), Grid(0.5, fine=False), Grid(1.0)
"""A start lives two seconds, a setpoint five; a frame takes a tick on the wire, and its answer's gap another."""


@dataclass(frozen=True, slots=True)
class Part:
    """One exploration."""

    model: str
    kind: Kind
    grid: Grid
    domain: Domain
    world: type[World] = World

    @property
    def name(self) -> str:
        how = "wire" if self.world is WireWorld else f"{self.grid.tick_s:g} s" + ", fine" * self.grid.fine
        how += ", spoiled" * self.domain.rare
        return f"{self.model}/{self.kind.value}, {how}"


def full() -> list[Part]:
    """Every family and intent; starts also by half seconds and at the instants just after the ticks; what may be sent
    again also with spoiled replies and cancelled asks."""
    plain, brief = Domain(rare=False), Domain(rare=False, without=frozenset({"raw", "sleep"}))
    spoiled = Domain(without=frozenset({"raw", "sleep", "hang", "everyone", "remove", "lose", "latch"}))
    parts = [Part(model, kind, COARSE, plain) for model in MODELS for kind in (Kind.START, Kind.SETPOINT)]
    parts += [Part(model, kind, COARSE, brief) for model in MODELS for kind in (Kind.JOG, Kind.RESET)]
    parts += [Part("c320", Kind.START, HALVES, plain), Part("c320", Kind.START, FINE, brief)]
    parts.append(Part("vc660", Kind.SETPOINT, COARSE, spoiled))
    return parts + [Part(model, Kind.START, COARSE, plain, WireWorld) for model in MODELS]


LATER = frozenset({"hang", "raw", "sleep", "remove"})
"""What the small domain leaves to the full one."""


def small() -> list[Part]:
    """One intent of each family, without some events; the gate's questions without their doubles."""
    parts = [Part("c320", Kind.START, COARSE, Domain(rare=False, small=True, without=LATER))]
    less = Domain(rare=False, small=True, without=LATER | {"lose", "latch"})
    others = (("dzb100", Kind.SETPOINT), ("vc660", Kind.JOG), ("df800", Kind.START))
    return parts + [Part(model, kind, COARSE, less) for model, kind in others]


NOT_EXPLORED = (
    "lengths: every frame, gap, quarantine and late answer takes one tick",
    "two commands of one drive at a time, and a permit kept while another command is made",
    "polls, and requests of others that come while a command waits",
    "how damaged answers add up to a bad link: the gate is asked with every link, and told by no wire",
    "answers that come late, and all that follows from disbelief; other campaigns do",
)
"""What the states leave out, for whoever reads the report."""


def run(session: Session) -> None:
    """Explore; ``session.budget`` is the most states, all parts together."""
    closed = True
    parts = full() if session.budget >= CAMPAIGN.full else small()
    for part in parts:
        search = Search(subject(part.model, part.kind, part.grid), part.domain, session.left, part.world)
        if names := unlisted(search.begin().core):
            raise TypeError(f"the bus has what the campaign does not know: {', '.join(names)}")
        found = search.run(session.did)
        closed = closed and found.closed
        _tell(session, part, found, search.digest)
    session.figures["closed"] = closed
    session.figures["domain"] = "full" if parts == full() else "small"
    session.figures["not explored"] = NOT_EXPLORED


def _tell(session: Session, part: Part, found: Found, digest: str) -> None:
    session.line(f"{part.name}: {found.states} states, {found.edges} edges, depth {found.depth}, {digest}")
    for text in found.bad:
        session.violation(text)
    alone = {
        **{f"gate: {name}": count for name, count in sorted(found.gate_alone.items())},
        **{f"bus: {name}": count for name, count in sorted(found.bus_alone.items())},
    }
    for name, count in alone.items():
        session.line(f"{part.name}: only {name} missing in {count} states")
        session.count(f"only missing, {name}", count)
    if found.closed and not found.moved + found.acted:
        session.violation(f"{part.name}: nothing ever left: the exploration shows nothing")
    session.figures[part.name] = {
        "states": found.states, "edges": found.edges, "combinations asked of the gate": found.decisions,
        "moving frames left": found.moved, "setting frames left": found.acted, "depth": found.depth,
        "closed": found.closed, "states where only this was missing": alone,
    }  # fmt: skip
    for name, count in (("states", found.states), ("edges", found.edges), ("moving edges", found.moved)):
        session.count(name, count)
        session.count(f"{part.model}: {name}", count)
    session.count("setting edges", found.acted)
    session.count("combinations asked of the gate", found.decisions)


CAMPAIGN = Campaign("gate", "states", ("I1", "F14", "F15", "F16"), full=2_000_000, slice=60_000, run=run)
