"""Breadth first through every state of one model and intent; each state is taken up once, each event tried in it."""

from __future__ import annotations

import marshal
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from hashlib import blake2b

from verification.model_check import permissive_inputs as gate_question
from verification.model_check.gate_state import GateState
from verification.model_check.model_subject import ModelSubject
from verification.model_check.permissive_inputs import PermissiveInputs

MAX_REPORTED_FINDINGS = 500
"""States between two words of progress."""


@dataclass(frozen=True, slots=True)
class SearchDomain:
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
class PermitDecision:
    """What the gate makes of every combination in one situation."""

    combinations: int
    sole_reasons: frozenset[str]
    """Each thing that was the only one missing for some combination, which was refused."""
    granted: tuple[tuple[PermissiveInputs, tuple[str, ...]], ...]
    """One combination of each sort that was granted, with what it lacks."""
    is_wrong: bool
    """It refused something of which nothing was missing."""


@dataclass(slots=True)
class SearchResult:
    """What came of it."""

    states: int = 0
    edges: int = 0
    decisions: int = 0
    moved: int = 0
    acted: int = 0
    depth: int = 0
    closed: bool = True
    refused_by_permissives_only: Counter[str] = field(default_factory=Counter)
    refused_by_bus_only: Counter[str] = field(default_factory=Counter)
    findings: list[str] = field(default_factory=list)


class StateSearch:
    """One exploration."""

    def __init__(
        self, subject: ModelSubject, domain: SearchDomain, limit: int, world: type[GateState] = GateState
    ) -> None:
        self.subject, self.domain, self.limit, self._world = subject, domain, limit, world
        self.found = SearchResult()
        self._known: dict[bytes, int] = {}
        self._predecessors: list[tuple[int, str]] = []
        self._decisions: dict[object, PermitDecision] = {}
        self._refused_by_permissives_only: set[str] = set()
        self._refused: dict[object, list[str]] = {}
        self._queue: deque[tuple[int, int, GateState]] = deque()
        self._state_digest = 0

    def initial_state(self) -> GateState:
        """The state in which everything begins."""
        return self._world(self.subject)

    def run(self, progress: Callable[[int], None] = lambda states: None, *, first: bool = False) -> SearchResult:
        """Until nothing new is found, or ``limit`` states were; ``first``: or something is wrong.

        ``progress`` is told of states taken up.
        """
        self._add_state(self.initial_state(), -1, "", 0)
        done = 0
        while self._queue and not (first and self.found.findings):
            self._expand(*self._queue.popleft())
            done += 1
            if done == MAX_REPORTED_FINDINGS or not self._queue:
                progress(done)
                done = 0
        return self.found

    @property
    def digest(self) -> str:
        """Of the set of states, in whatever order they were found."""
        return f"{self._state_digest:032x}"

    def _expand(self, number: int, depth: int, world: GateState) -> None:
        self.found.depth = depth
        gate_alone: set[str] = set()
        self._refused_by_permissives_only = gate_alone
        alone: set[str] = set()
        self._check_forged(world, number, depth, alone)
        for event in world.possible_events(self.domain.slots, self.domain.rare):
            if event in self.domain.without:
                continue
            self._check_transition(world.copy().apply(event), number, event, depth, alone)
        for place in world.frames_needing_permit():
            decision = self._decide(world, place)
            gate_alone |= decision.sole_reasons
            for shown, lacks in decision.granted:
                event = f"grant {place}" + (f" without {', '.join(lacks)}" if lacks else "")
                self._check_transition(world.copy().grant(place, shown, lacks), number, event, depth, alone)
            if decision.is_wrong:
                self.found.findings.append(f"refused with everything in order: {self._path(number)}")
        self.found.refused_by_permissives_only.update(gate_alone)
        self.found.refused_by_bus_only.update(alone)

    def _check_transition(self, after: GateState, number: int, event: str, depth: int, alone: set[str]) -> None:
        seen = after.events
        self.found.edges += 1
        self.found.moved += seen.motion_frames
        self.found.acted += seen.setting_frames
        alone.update(lacks[0] for lacks in seen.refused if len(lacks) == 1)
        self._refused_by_permissives_only.update(lacks[0] for lacks in seen.denied if len(lacks) == 1)
        self.found.findings += [f"{what}: {self._path(number)} > {event}" for what in seen.findings]
        self._add_state(after, number, event, depth + 1)

    def _check_forged(self, world: GateState, number: int, depth: int, alone: set[str]) -> None:
        """Asks that nobody granted: refused on the spot, which changes nothing and is the same in each situation."""
        situation = world.core.is_open, world.monitor.present, world.monitor.latched, world.held_permit_key()
        found = self._refused.get(situation)
        if found is None:
            after = world.copy().apply("forge")
            if after.check_forged_refused or after.events.findings:
                return self._check_transition(after, number, "forge", depth, alone)
            found = self._refused[situation] = [lacks[0] for lacks in after.events.refused if len(lacks) == 1]
        self.found.edges += 1
        alone.update(found)
        return None

    def _add_state(self, world: GateState, number: int, event: str, depth: int) -> None:
        key = blake2b(marshal.dumps(world.state_key(), 2), digest_size=16).digest()
        if key in self._known:
            return
        if len(self._known) >= self.limit:
            self.found.closed = False
            return
        self._known[key] = len(self._predecessors)
        self._predecessors.append((number, event))
        self._queue.append((len(self._predecessors) - 1, depth, world))
        self.found.states += 1
        self._state_digest ^= int.from_bytes(key)

    def _path(self, number: int) -> str:
        """The shortest way there."""
        events: list[str] = []
        while number > 0:
            number, event = self._predecessors[number]
            events.append(event)
        return f"{self.subject.name}: " + " > ".join(reversed(events))

    def _decide(self, world: GateState, place: int) -> PermitDecision:
        """Asked once for each situation: all else that the gate looks at is in the combination."""
        situation = world.command_key(), world.monitor.latched, world.shadow, place
        found = self._decisions.get(situation)
        if found is None:
            found = self._decisions[situation] = decide_permit(self.subject, world, place, self.domain.small)
            self.found.decisions += found.combinations
        return found


def decide_permit(subject: ModelSubject, world: GateState, place: int, small: bool) -> PermitDecision:
    """Ask the gate everything."""
    assert world.command is not None and world.model_command is not None
    subject.command_word = world.shadow
    seen = gate_question.bus_snapshot(world.core, world.now)
    data = subject.dialect.codec.encode_request(subject.frames[place].request)
    act = world.monitor.effect_of(data)
    of_wish = world.monitor.missing_for_permit(world.model_command, subject.limit_s(act), world.now)
    asked, wronged = 0, False
    alone: set[str] = set()
    yes: dict[tuple[str, ...], PermissiveInputs] = {}
    for shown in gate_question.input_combinations(subject, small):
        asked += 1
        lacks = (*of_wish, *gate_question.missing_permissives(subject, act, shown))
        permit = gate_question.request_permit(subject, world.command, place, seen, shown)
        if permit is not None:
            yes.setdefault(lacks, shown)
        elif len(lacks) == 1:
            alone.add(lacks[0])
        wronged = wronged or (permit is None and not lacks)
    return PermitDecision(asked, frozenset(alone), tuple((shown, lacks) for lacks, shown in yes.items()), wronged)
