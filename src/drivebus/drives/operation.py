"""One conversation with one drive: what every operation is made of. Pure; time and bus come through the steps.

A ``Talk`` collects the evidence, keeps the newest two readings of everything, and asks the gate before a frame acts.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from math import inf, isfinite
from typing import Any

from drivebus.drives import gate
from drivebus.drives.book import Book, Facts
from drivebus.drives.dialect import Frame, fault_of
from drivebus.drives.gate import Command, Evidence, Kind
from drivebus.drives.memory import Memory
from drivebus.drives.state import UNKNOWN, DriveState, DriveStatus, Exchange, Outcome, OutcomeWord, Verdict
from drivebus.drives.talk import Conversation, Surroundings, ask, look
from drivebus.errors import DrivebusError, Expired, NotPermitted, Superseded
from drivebus.message import Answer, Ask, Effect, Lane, Permit, WriteClass
from drivebus.reading import Reading

ROUNDS = 2
"""Two out of two (RELIABILITY 4), each behind a fence of its own (ruling 6)."""
EXTRA_ROUNDS = 3
"""A drive that changes its state between two reads gets these to settle."""
MIRRORED = "bus.mirrored"
"""A loop-back's reply equals its request: believed only once this port has shown that it has no echo (F03)."""
PREPARE_S = 5.0
"""From the user's act to the gate (to the first bit, where its moment is known); longer is another wish …"""
PREPARE_TRANSACTIONS = 40
"""… but on a line so slow that the checks themselves take longer, as long as so many transactions (300 baud: 25 s)."""
KEPT_COMMANDS, KEPT_READS = 64, 24
"""Evidence is bounded (I12)."""


class Talk:
    """The state of one conversation."""

    def __init__(
        self,
        memory: Memory,
        generation: int | None = None,
        begun: float | None = None,
        wished_at: float | None = None,
    ) -> None:
        self.memory = memory
        self.wished_at = wished_at
        """When the user wished for this, where that is known: its commands are as old, checks included (ruling 12).
        None: a command is made after its checks, which have limits of their own."""
        self.generation = generation
        """Stop generation when the user wished for this; None: when the command is made. Our own stops count on."""
        self.dialect = memory.dialect
        self.book = Book()
        self.verdict: Verdict = UNKNOWN
        self.seen_turning = False
        """Running was seen at least once, be it in a single read (ruling 6)."""
        self.begun = begun
        """When this was wished for, or its checks began."""
        self.pace_s = inf
        """The shortest transaction so far: how fast this line is."""
        self.may_turn = False
        """A frame that moves may have left, and no stop was done since."""
        self.moved: Answer | None = None
        """What came of the last frame that moves."""
        self.within_limits = False
        """Frequency and direction of this command were checked against drive and user."""
        self.slowed_at: float | None = None
        """When a reading last showed a lower output frequency than any before it in this conversation."""
        self._lowest_hz: float | None = None
        self._commands: deque[Exchange] = deque(maxlen=KEPT_COMMANDS)
        self._reads: deque[Exchange] = deque(maxlen=KEPT_READS)

    def check_frequency(self, frequency_hz: float) -> tuple[int, float]:
        """The raw word and what the drive makes of it. Raises LimitError, before anything is sent."""
        found = self.memory.check_frequency(frequency_hz)
        self.within_limits = True
        return found

    def ask(
        self,
        request: Any,
        lane: Lane = Lane.PARAMETER,
        write_class: WriteClass = WriteClass.READ,
        permit: Permit | None = None,
    ) -> Conversation[Answer]:
        """One transaction; what left is kept as evidence and tells the dialect's shadows.

        Reads go in the parameter lane: a stop takes queued commands away, and must not take away what confirms it.
        """
        expires_at = permit.expires_at if permit is not None else None
        if self.generation is not None and self._effect(request) is Effect.STOP:
            self.generation += 1
        turned, moves = self.may_turn, permit is not None and permit.effect is Effect.MOTION
        self.may_turn = turned or moves  # also where this conversation is cancelled while the frame is out
        answer = yield from ask(Ask(self.dialect.address, request, lane, write_class, permit, expires_at))
        if moves:
            self.moved, self.may_turn = answer, turned or bool(answer.sent)
        if answer.sent:
            self.dialect.noted(request)
            kept = self._reads if write_class is WriteClass.READ else self._commands
            kept.append(exchange_of(answer))
            if answer.sent_at is not None and answer.received_at is not None:
                self.pace_s = min(self.pace_s, answer.received_at - answer.sent_at)
        return answer

    def _effect(self, request: Any) -> Effect:
        return self.dialect.link.effect(self.dialect.codec.encode_request(request))

    def begin(self) -> Conversation[None]:
        """The checks begin now, unless the wish or an operation around this one is older."""
        if self.begun is None:
            self.begun = (yield from look()).now

    def in_time(self) -> Conversation[Surroundings]:
        """The surroundings after the checks. Raises Expired where they took so long that this is another wish (I1)."""
        around = yield from look()
        limit_s = max(PREPARE_S, PREPARE_TRANSACTIONS * self.pace_s if isfinite(self.pace_s) else 0.0)
        age_s = 0.0 if self.begun is None else around.now - self.begun
        if age_s > limit_s:
            raise Expired("drives.prepare_too_long", age_s=round(age_s, 2), limit_s=round(limit_s, 1))
        return around

    def command(self, kind: Kind, around: Surroundings) -> Command:
        """The user's wish: made now, but where the moment of the wish is known it expires ``PREPARE_S`` after that, the
        checks included; a stop since then takes it away (6.5)."""
        generation = around.generation if self.generation is None else self.generation
        latest = inf if self.wished_at is None else self.wished_at + max(0.0, PREPARE_S - gate.EXPIRY_S[kind])
        made_at = min(around.now, latest)
        return self.memory.command(kind, replace(around, now=made_at, generation=generation))

    def read(self, request: Any) -> Conversation[Answer]:
        """One read, taken into the book."""
        answer = yield from self.ask(request)
        if answer.error is None and answer.reply is not None:
            facts = self.dialect.facts(request, answer.reply, answer.received_at)
            self.book.note(facts)
            self._watch_for_slowing(facts)
            self.memory.on_read(answer)
        return answer

    def _watch_for_slowing(self, facts: Facts) -> None:
        """Each reading counts: on a slow line with many drives a look of several reads takes a second."""
        reading = facts.get("output_frequency")
        if reading is None or not isinstance(reading.value, int | float):
            return
        if self._lowest_hz is not None and reading.value < self._lowest_hz:
            self.slowed_at = reading.source_time
        self._lowest_hz = float(reading.value if self._lowest_hz is None else min(self._lowest_hz, reading.value))

    def fence(self, avoid: Any = None) -> Conversation[DrivebusError | None]:
        """Prove that this station's replies are current (ruling 2). Returns what went wrong."""
        answer = yield from self.ask(self.dialect.fence(avoid))
        if answer.error is not None and getattr(answer.error, "key", "") == MIRRORED:
            yield from self.ask(self.dialect.plain_read())
            answer = yield from self.ask(self.dialect.fence(avoid))
        if answer.error is not None:
            return _known(answer.error)
        return None if self.dialect.proves(answer.reply) else NotPermitted("drives.fence_refused")

    def fenced_reads(self, requests: tuple[Any, ...]) -> Conversation[DrivebusError | None]:
        """A fence, then these reads. Returns what went wrong first."""
        error = yield from self.fence()
        for request in requests:
            if error is not None:
                return error
            answer = yield from self.read(request)
            error = None if answer.error is None else _known(answer.error)
        return error

    def judged(self, patience: int = 1) -> Conversation[DrivebusError | None]:
        """State of the drive now: two fenced reads that agree, taken after this call. Sets ``verdict``.

        So many rounds may fail on the bus; then its error is returned and the state is unknown.
        """
        self.book.forget()
        self.verdict = UNKNOWN
        requests = self.dialect.state_reads()
        if not requests:
            return None
        failed = 0
        for turn in range(1, ROUNDS + EXTRA_ROUNDS + 1):
            error = yield from self.fenced_reads(requests)
            if error is not None:
                failed += 1
                self.book.forget()
                if failed <= patience:
                    continue
                self.verdict = Verdict(DriveState.UNKNOWN, reason="drives.no_answer")
                return error
            self._watch_for_motion()
            verdict = self.dialect.judge(self.book) if turn - failed >= ROUNDS else None
            if verdict is not None:
                self.verdict = yield from self._with_fault(verdict)
                return None
        self.verdict = Verdict(DriveState.UNKNOWN, reason="drives.disagree")
        return None

    def _watch_for_motion(self) -> None:
        """One reading that shows motion is enough to know that the drive was not simply standing."""
        single = Book()
        single.latest = single.before = dict(self.book.latest)
        verdict = self.dialect.judge(single)
        self.seen_turning = self.seen_turning or (verdict is not None and verdict.state.turning)

    def _with_fault(self, verdict: Verdict) -> Conversation[Verdict]:
        """Where the state only says "fault", further reads name it."""
        requests = self.dialect.fault_reads() if verdict.fault_code is not None else ()
        for _ in range(ROUNDS if requests else 0):
            for request in requests:
                yield from self.read(request)
        return (self.dialect.judge(self.book) or verdict) if requests else verdict

    def permit(self, command: Command, frame: Frame) -> Conversation[Permit | None]:
        """The gate's leave for a frame that is neither a read nor a stop; None for a stop, which needs none.

        Raises GateError, Expired, Superseded, NotPermitted: nothing is sent then.
        """
        data = self.dialect.codec.encode_request(frame.request)
        effect = self.dialect.link.effect(data)
        if effect is Effect.STOP:
            return None
        if not self.dialect.lawful(data):
            raise NotPermitted("drives.not_listed", frame=data.hex(" ").upper())
        around = yield from look()
        return gate.grant(
            command, self.dialect.address, effect, frame.write_class, around, self.evidence_for_gate(),
            self.dialect.profile.family,
        )  # fmt: skip

    def act(self, command: Command, frame: Frame) -> Conversation[Answer]:
        """Send one frame that is neither a read nor a stop: with a permit, or not at all."""
        permit = yield from self.permit(command, frame)
        return (yield from self.ask(frame.request, Lane.COMMAND, frame.write_class, permit))

    def evidence_for_gate(self) -> Evidence:
        """What this conversation has established so far."""
        preflight = self.memory.preflight
        at = self.book.time_of(*self.dialect.state_names)
        done = preflight is not None and preflight.passed
        return Evidence(self.verdict, at, self.dialect.can_tell, done, self.within_limits)

    def still_wanted(self, command: Command) -> Conversation[float]:
        """The time, unless a newer stop took this command away. Raises Superseded."""
        around = yield from look()
        if around.generation != command.generation:
            raise self.superseded()
        return around.now

    def superseded(self) -> Superseded:
        """A stop came: whatever was sent, the stop is what counts, and nothing is resent (6.5)."""
        error = Superseded("drives.superseded")
        error.outcome = self.outcome(OutcomeWord.UNKNOWN, "drives.superseded")
        return error

    def status(self) -> DriveStatus:
        """What this conversation has read."""
        verdict = self.verdict
        fault = None if verdict.fault_code is None else fault_of(self.dialect.profile, verdict.fault_code)
        at = self.book.time_of(*self.dialect.state_names)
        return DriveStatus(verdict.state, verdict.direction, fault, self.readings(), verdict.reason, at)

    def readings(self) -> dict[str, Reading]:
        """The readings that the profile names."""
        return {name: r for name, r in self.book.latest.items() if name in self.dialect.profile.signals}

    def outcome(self, word: OutcomeWord, key: str, /, **params: Any) -> Outcome:
        """How it ended, with the frames so far and the status behind it."""
        return Outcome(word, key, params, self.evidence(), self.status())

    def refused(self, answer: Answer, **params: Any) -> Outcome | None:
        """The drive's own no as an outcome, None where it gave none. Raises the error of a frame that never left."""
        if not answer.sent and answer.error is not None:
            raise answer.error
        no = None if answer.reply is None else self.dialect.refusal(answer.reply)
        return None if no is None else self.outcome(OutcomeWord.REFUSED, no.key, code=no.code, **params)

    def unseen(self, answered: bool, acknowledged: str, unknown: str, **params: Any) -> Outcome:
        """Nothing that can be read shows the effect (ruling 1): there is the drive's yes, or not even that."""
        if answered:
            return self.outcome(OutcomeWord.ACKNOWLEDGED, acknowledged, **params)
        return self.outcome(OutcomeWord.UNKNOWN, unknown, **params)

    def evidence(self) -> tuple[Exchange, ...]:
        """Frames in the order in which they left."""
        both = [*self._commands, *self._reads]
        return tuple(sorted(both, key=lambda e: e.sent_at if e.sent_at is not None else 0.0))


def noted(outcome: Outcome, key: str, /, **params: Any) -> Outcome:
    """The outcome with one more sentence."""
    return replace(outcome, notes=(*outcome.notes, (key, params)))


def exchange_of(answer: Answer) -> Exchange:
    """An answer as evidence."""
    found = Exchange(answer.sent, answer.received, answer.sent_at, answer.received_at)
    error = answer.error
    return replace(found, error=error.key, params=error.params) if isinstance(error, DrivebusError) else found


def _known(error: Exception) -> DrivebusError:
    """Errors of an answer are ours by contract; anything else is a bug and is raised as such."""
    if isinstance(error, DrivebusError):
        return error
    raise error
