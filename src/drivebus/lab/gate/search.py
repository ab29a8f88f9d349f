"""Breadth first through every state of one model and intent; each state is taken up once, each event tried in it."""

from __future__ import annotations

import marshal
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from hashlib import blake2b

from drivebus.lab.gate import question as gate_question
from drivebus.lab.gate.question import Shown
from drivebus.lab.gate.subject import Subject
from drivebus.lab.gate.world import World

TOLD = 500
"""States between two words of progress."""


@dataclass(frozen=True, slots=True)
class Domain:
    """How far it goes."""

    slots: int = 1
    """Frames submitted and not yet answered, at a time."""
    rare: bool = True
    """With spoiled replies, broadcast stops and cancelled asks."""
    small: bool = False
    """The gate's questions without those that only repeat another one."""
    without: frozenset[str] = frozenset()
    """Events that are left out."""


@dataclass(frozen=True, slots=True)
class Decision:
    """What the gate makes of every combination in one situation."""

    asked: int
    alone: frozenset[str]
    """Each thing that was the only one missing for some combination, which was refused."""
    yes: tuple[tuple[Shown, tuple[str, ...]], ...]
    """One combination of each sort that was granted, with what it lacks."""
    wronged: bool
    """It refused something of which nothing was missing."""


@dataclass(slots=True)
class Found:
    """What came of it."""

    states: int = 0
    edges: int = 0
    decisions: int = 0
    moved: int = 0
    acted: int = 0
    depth: int = 0
    closed: bool = True
    gate_alone: Counter[str] = field(default_factory=Counter)
    bus_alone: Counter[str] = field(default_factory=Counter)
    bad: list[str] = field(default_factory=list)


class Search:
    """One exploration."""

    def __init__(self, subject: Subject, domain: Domain, limit: int, world: type[World] = World) -> None:
        self.subject, self.domain, self.limit, self._world = subject, domain, limit, world
        self.found = Found()
        self._known: dict[bytes, int] = {}
        self._came: list[tuple[int, str]] = []
        self._decided: dict[object, Decision] = {}
        self._gate_alone: set[str] = set()
        self._refused: dict[object, list[str]] = {}
        self._queue: deque[tuple[int, int, World]] = deque()
        self._sum = 0

    def begin(self) -> World:
        """The state in which everything begins."""
        return self._world(self.subject)

    def run(self, progress: Callable[[int], None] = lambda states: None, *, first: bool = False) -> Found:
        """Until nothing new is found, or ``limit`` states were; ``first``: or something is wrong.

        ``progress`` is told of states taken up.
        """
        self._arrive(self.begin(), -1, "", 0)
        done = 0
        while self._queue and not (first and self.found.bad):
            self._expand(*self._queue.popleft())
            done += 1
            if done == TOLD or not self._queue:
                progress(done)
                done = 0
        return self.found

    @property
    def digest(self) -> str:
        """Of the set of states, in whatever order they were found."""
        return f"{self._sum:032x}"

    def _expand(self, number: int, depth: int, world: World) -> None:
        self.found.depth = depth
        gate_alone: set[str] = set()
        self._gate_alone = gate_alone
        alone: set[str] = set()
        self._forge(world, number, depth, alone)
        for event in world.events(self.domain.slots, self.domain.rare):
            if event in self.domain.without:
                continue
            self._edge(world.copy().happens(event), number, event, depth, alone)
        for place in world.places():
            decision = self._decide(world, place)
            gate_alone |= decision.alone
            for shown, lacks in decision.yes:
                event = f"grant {place}" + (f" without {', '.join(lacks)}" if lacks else "")
                self._edge(world.copy().grant(place, shown, lacks), number, event, depth, alone)
            if decision.wronged:
                self.found.bad.append(f"refused with everything in order: {self._path(number)}")
        self.found.gate_alone.update(gate_alone)
        self.found.bus_alone.update(alone)

    def _edge(self, after: World, number: int, event: str, depth: int, alone: set[str]) -> None:
        seen = after.seen
        self.found.edges += 1
        self.found.moved += seen.moved
        self.found.acted += seen.acted
        alone.update(lacks[0] for lacks in seen.refused if len(lacks) == 1)
        self._gate_alone.update(lacks[0] for lacks in seen.denied if len(lacks) == 1)
        self.found.bad += [f"{what}: {self._path(number)} > {event}" for what in seen.bad]
        self._arrive(after, number, event, depth + 1)

    def _forge(self, world: World, number: int, depth: int, alone: set[str]) -> None:
        """Asks that nobody granted: refused on the spot, which changes nothing and is the same in each situation."""
        situation = world.core.is_open, world.monitor.present, world.monitor.latched, world.held_name()
        found = self._refused.get(situation)
        if found is None:
            after = world.copy().happens("forge")
            if after.forged or after.seen.bad:
                return self._edge(after, number, "forge", depth, alone)
            found = self._refused[situation] = [lacks[0] for lacks in after.seen.refused if len(lacks) == 1]
        self.found.edges += 1
        alone.update(found)
        return None

    def _arrive(self, world: World, number: int, event: str, depth: int) -> None:
        key = blake2b(marshal.dumps(world.name(), 2), digest_size=16).digest()
        if key in self._known:
            return
        if len(self._known) >= self.limit:
            self.found.closed = False
            return
        self._known[key] = len(self._came)
        self._came.append((number, event))
        self._queue.append((len(self._came) - 1, depth, world))
        self.found.states += 1
        self._sum ^= int.from_bytes(key)

    def _path(self, number: int) -> str:
        """The shortest way there."""
        events: list[str] = []
        while number > 0:
            number, event = self._came[number]
            events.append(event)
        return f"{self.subject.name}: " + " > ".join(reversed(events))

    def _decide(self, world: World, place: int) -> Decision:
        """Asked once for each situation: all else that the gate looks at is in the combination."""
        situation = world.command_name(), world.monitor.latched, world.shadow, place
        found = self._decided.get(situation)
        if found is None:
            found = self._decided[situation] = decide(self.subject, world, place, self.domain.small)
            self.found.decisions += found.asked
        return found


def decide(subject: Subject, world: World, place: int, small: bool) -> Decision:
    """Ask the gate everything."""
    assert world.command is not None and world.wish is not None
    subject.shadow = world.shadow
    seen = gate_question.around(world.core, world.now)
    data = subject.dialect.codec.encode_request(subject.frames[place].request)
    act = world.monitor.act_of(data)
    of_wish = world.monitor.wish_lacks(world.wish, subject.limit_s(act), world.now)
    asked, wronged = 0, False
    alone: set[str] = set()
    yes: dict[tuple[str, ...], Shown] = {}
    for shown in gate_question.combinations(subject, small):
        asked += 1
        lacks = (*of_wish, *gate_question.lacks(subject, act, shown))
        permit = gate_question.ask(subject, world.command, place, seen, shown)
        if permit is not None:
            yes.setdefault(lacks, shown)
        elif len(lacks) == 1:
            alone.add(lacks[0])
        wronged = wronged or (permit is None and not lacks)
    return Decision(asked, frozenset(alone), tuple((shown, lacks) for lacks, shown in yes.items()), wronged)
