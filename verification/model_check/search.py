"""Breadth-first search of the states of one model and command kind; every event is tried once in each state."""

from __future__ import annotations

import marshal
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from hashlib import blake2b

from verification.model_check import permissive_inputs
from verification.model_check.gate_state import GateState
from verification.model_check.model_subject import ModelSubject
from verification.model_check.permissive_inputs import PermissiveInputs

PROGRESS_INTERVAL_STATES = 500
"""States between two calls of ``progress``."""


@dataclass(frozen=True, slots=True)
class SearchDomain:
    """Limits of a search: which events may occur, and how many frames at a time."""

    slots: int = 1
    """Frames submitted and not answered at a time."""
    rare: bool = True
    """Whether damaged replies, broadcast stops and cancelled requests occur."""
    small: bool = False
    """Whether equivalent combinations of inputs are left out."""
    without: frozenset[str] = frozenset()
    """Events left out."""


@dataclass(frozen=True, slots=True)
class PermitDecision:
    """Decisions of the permissives on every combination of inputs in one situation."""

    combinations: int
    sole_reasons: frozenset[str]
    """Conditions that were the only missing one of a refused combination."""
    granted: tuple[tuple[PermissiveInputs, tuple[str, ...]], ...]
    """Granted combination for each set of missing conditions."""
    is_wrong: bool
    """Whether a combination with nothing missing was refused."""


@dataclass(slots=True, kw_only=True)
class SearchResult:
    """Result of a search: its counts, and what must not have happened."""

    states: int = 0
    edges: int = 0
    """Events tried in all states."""
    decisions: int = 0
    """Combinations of inputs on which the permissives decided."""
    motion_frames: int = 0
    """Frames sent that may move the motor."""
    setting_frames: int = 0
    """Frames sent that act without moving the motor."""
    depth: int = 0
    """Events from the initial state to the last state expanded."""
    closed: bool = True
    """Whether every state that can be reached was found within the limit."""
    refused_by_permissives_only: Counter[str] = field(default_factory=Counter)
    """Condition → states in which it was the only missing one of a refused permit."""
    refused_by_bus_only: Counter[str] = field(default_factory=Counter)
    """Condition → states in which it was the only missing one of a rejected frame."""
    findings: list[str] = field(default_factory=list)
    """Violations, each with the shortest path to it."""


class StateSearch:
    """Search of one subject in one domain."""

    def __init__(
        self, subject: ModelSubject, domain: SearchDomain, limit: int, state: type[GateState] = GateState
    ) -> None:
        self.subject, self.domain, self.limit, self._state_class = subject, domain, limit, state
        self.result = SearchResult()
        self._known: dict[bytes, int] = {}
        self._predecessors: list[tuple[int, str]] = []
        self._decisions: dict[object, PermitDecision] = {}
        self._refused_by_permissives_only: set[str] = set()
        self._refused: dict[object, list[str]] = {}
        self._queue: deque[tuple[int, int, GateState]] = deque()
        self._state_digest = 0

    def initial_state(self) -> GateState:
        """Return the state before any event: the port is not open, and there is no command."""
        return self._state_class(self.subject)

    def run(self, progress: Callable[[int], None] = lambda states: None, *, first: bool = False) -> SearchResult:
        """Search until no new state is found or ``limit`` is reached; ``first``: until the first finding.

        ``progress`` is called with the number of states expanded.
        """
        self._add_state(self.initial_state(), -1, "", 0)
        done = 0
        while self._queue and not (first and self.result.findings):
            self._expand(*self._queue.popleft())
            done += 1
            if done == PROGRESS_INTERVAL_STATES or not self._queue:
                progress(done)
                done = 0
        return self.result

    @property
    def digest(self) -> str:
        """Digest of the set of states, independent of their order."""
        return f"{self._state_digest:032x}"

    def _expand(self, number: int, depth: int, state: GateState) -> None:
        self.result.depth = depth
        sole_permissives: set[str] = set()
        self._refused_by_permissives_only = sole_permissives
        sole_reasons: set[str] = set()
        self._check_forged(state, number, depth, sole_reasons)
        for event in state.possible_events(self.domain.slots, rare=self.domain.rare):
            if event in self.domain.without:
                continue
            self._check_transition(state.copy().apply(event), number, event, depth, sole_reasons)
        for place in state.frames_needing_permit():
            decision = self._decide(state, place)
            sole_permissives |= decision.sole_reasons
            for shown, missing in decision.granted:
                event = f"grant {place}" + (f" without {', '.join(missing)}" if missing else "")
                self._check_transition(state.copy().grant(place, shown, missing), number, event, depth, sole_reasons)
            if decision.is_wrong:
                self.result.findings.append(f"refused with everything in order: {self._path(number)}")
        self.result.refused_by_permissives_only.update(sole_permissives)
        self.result.refused_by_bus_only.update(sole_reasons)

    def _check_transition(self, after: GateState, number: int, event: str, depth: int, sole_reasons: set[str]) -> None:
        events = after.events
        self.result.edges += 1
        self.result.motion_frames += events.motion_frames
        self.result.setting_frames += events.setting_frames
        sole_reasons.update(missing[0] for missing in events.refused if len(missing) == 1)
        self._refused_by_permissives_only.update(missing[0] for missing in events.denied if len(missing) == 1)
        self.result.findings += [f"{what}: {self._path(number)} > {event}" for what in events.findings]
        self._add_state(after, number, event, depth + 1)

    def _check_forged(self, state: GateState, number: int, depth: int, sole_reasons: set[str]) -> None:
        """Check that requests without a granted permit are rejected at once, alike in each situation."""
        situation = state.core.is_open, state.monitor.present, state.monitor.start_inhibited, state.held_permit_key()
        found = self._refused.get(situation)
        if found is None:
            after = state.copy().apply("forge")
            if after.accepted_forged or after.events.findings:
                return self._check_transition(after, number, "forge", depth, sole_reasons)
            found = self._refused[situation] = [missing[0] for missing in after.events.refused if len(missing) == 1]
        self.result.edges += 1
        sole_reasons.update(found)
        return None

    def _add_state(self, state: GateState, number: int, event: str, depth: int) -> None:
        key = blake2b(marshal.dumps(state.state_key(), 2), digest_size=16).digest()
        if key in self._known:
            return
        if len(self._known) >= self.limit:
            self.result.closed = False
            return
        self._known[key] = len(self._predecessors)
        self._predecessors.append((number, event))
        self._queue.append((len(self._predecessors) - 1, depth, state))
        self.result.states += 1
        self._state_digest ^= int.from_bytes(key)

    def _path(self, number: int) -> str:
        """Return the shortest path to a state."""
        events: list[str] = []
        while number > 0:
            number, event = self._predecessors[number]
            events.append(event)
        return f"{self.subject.name}: " + " > ".join(reversed(events))

    def _decide(self, state: GateState, place: int) -> PermitDecision:
        """Return the decisions of the permissives, computed once for each situation."""
        situation = state.command_key(), state.monitor.start_inhibited, state.command_word, place
        found = self._decisions.get(situation)
        if found is None:
            found = self._decisions[situation] = decide_permit(self.subject, state, place, small=self.domain.small)
            self.result.decisions += found.combinations
        return found


def decide_permit(subject: ModelSubject, state: GateState, place: int, *, small: bool) -> PermitDecision:
    """Let the permissives decide on every combination of inputs."""
    assert state.command is not None and state.model_command is not None
    subject.command_word = state.command_word
    events = permissive_inputs.bus_snapshot(state.core, state.now)
    data = subject.dialect.codec.encode_request(subject.frames[place].request)
    effect = state.monitor.effect_of(data)
    missing_command = state.monitor.missing_for_permit(state.model_command, subject.limit_s(effect), state.now)
    combinations, is_wrong = 0, False
    sole_reasons: set[str] = set()
    granted: dict[tuple[str, ...], PermissiveInputs] = {}
    for shown in permissive_inputs.input_combinations(subject, small=small):
        combinations += 1
        missing = (*missing_command, *permissive_inputs.missing_permissives(subject, effect, shown))
        permit = permissive_inputs.request_permit(subject, state.command, place, events, shown)
        if permit is not None:
            granted.setdefault(missing, shown)
        elif len(missing) == 1:
            sole_reasons.add(missing[0])
        is_wrong = is_wrong or (permit is None and not missing)
    return PermitDecision(
        combinations, frozenset(sole_reasons), tuple((shown, missing) for missing, shown in granted.items()), is_wrong
    )
