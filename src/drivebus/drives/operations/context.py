"""One conversation with one drive: what every operation is made of. Pure; time and bus come through the steps.

A ``Talk`` collects the evidence, keeps the newest two readings of everything, and asks the gate before a frame acts.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from math import inf, isfinite
from typing import Any

from drivebus.bus.messages import BusRequest, BusResult, Permit, RequestPriority, RetryPolicy
from drivebus.drives import permissives
from drivebus.drives.context import DriveContext
from drivebus.drives.dialects.base import CommandFrame, fault_from_code
from drivebus.drives.operations.steps import BusConditions, DriveOperation, get_bus_conditions, transact
from drivebus.drives.permissives import CommandKind, DriveCommand, PermitInputs
from drivebus.drives.readings import ReadingPairs, Readings
from drivebus.drives.state import (
    STATE_NOT_READ,
    DerivedState,
    DriveState,
    DriveStatus,
    FrameExchange,
    Outcome,
    OutcomeStatus,
)
from drivebus.errors import DrivebusError, Expired, NotPermitted, Superseded
from drivebus.protocols.codec import Effect
from drivebus.values import Reading

VERIFICATION_ROUNDS = 2
"""Two out of two (RELIABILITY 4), each behind a fence of its own (ruling 6)."""
EXTRA_VERIFICATION_ROUNDS = 3
"""A drive that changes its state between two reads gets these to settle."""
MIRRORED_REPLY_KEY = "bus.own_echo"
"""A loop-back's reply equals its request: believed only once this port has shown that it has no echo (F03)."""
CHECKS_TIMEOUT_S = 5.0
"""From the user's act to the gate (to the first bit, where its moment is known); longer is another wish …"""
CHECKS_TIMEOUT_TRANSACTIONS = 40
"""… but on a line so slow that the checks themselves take longer, as long as so many transactions (300 baud: 25 s)."""
MAX_COMMAND_EXCHANGES, MAX_READ_EXCHANGES = 64, 24
"""Evidence is bounded (I12)."""


class OperationContext:
    """The state of one conversation."""

    def __init__(
        self,
        drive: DriveContext,
        stop_epoch: int | None = None,
        checks_started_at: float | None = None,
        requested_at: float | None = None,
    ) -> None:
        self.drive = drive
        self.requested_at = requested_at
        """When the user wished for this, where that is known: its commands are as old, checks included (ruling 12).
        None: a command is made after its checks, which have limits of their own."""
        self.stop_epoch = stop_epoch
        """Stop generation when the user wished for this; None: when the command is made. Our own stops count on."""
        self.dialect = drive.dialect
        self.reading_pairs = ReadingPairs()
        self.derived: DerivedState = STATE_NOT_READ
        self.motion_seen = False
        """Running was seen at least once, be it in a single read (ruling 6)."""
        self.checks_started_at = checks_started_at
        """When this was wished for, or its checks began."""
        self.fastest_transaction_s = inf
        """The shortest transaction so far: how fast this line is."""
        self.may_be_running = False
        """A frame that moves may have left, and no stop was done since."""
        self.last_motion_result: BusResult | None = None
        """What came of the last frame that moves."""
        self.limits_checked = False
        """Frequency and direction of this command were checked against drive and user."""
        self.last_deceleration_at: float | None = None
        """When a reading last showed a lower output frequency than any before it in this conversation."""
        self._lowest_hz: float | None = None
        self._command_exchanges: deque[FrameExchange] = deque(maxlen=MAX_COMMAND_EXCHANGES)
        self._read_exchanges: deque[FrameExchange] = deque(maxlen=MAX_READ_EXCHANGES)

    def check_frequency(self, frequency_hz: float) -> tuple[int, float]:
        """The raw word and what the drive makes of it. Raises LimitError, before anything is sent."""
        found = self.drive.check_frequency(frequency_hz)
        self.limits_checked = True
        return found

    def transact(
        self,
        request: Any,
        lane: RequestPriority = RequestPriority.PARAMETER,
        write_class: RetryPolicy = RetryPolicy.READ,
        permit: Permit | None = None,
    ) -> DriveOperation[BusResult]:
        """One transaction; what left is kept as evidence and tells the dialect's shadows.

        Reads go in the parameter lane: a stop takes queued commands away, and must not take away what confirms it.
        """
        expires_at = permit.expires_at if permit is not None else None
        if self.stop_epoch is not None and self._effect(request) is Effect.STOP:
            self.stop_epoch += 1
        turned, moves = self.may_be_running, permit is not None and permit.effect is Effect.MOTION
        self.may_be_running = turned or moves  # also where this conversation is cancelled while the frame is out
        answer = yield from transact(BusRequest(self.dialect.address, request, lane, write_class, permit, expires_at))
        if moves:
            self.last_motion_result, self.may_be_running = answer, turned or bool(answer.sent)
        if answer.sent:
            self.dialect.on_sent(request)
            kept = self._read_exchanges if write_class is RetryPolicy.READ else self._command_exchanges
            kept.append(frame_exchange(answer))
            if answer.sent_at is not None and answer.received_at is not None:
                self.fastest_transaction_s = min(self.fastest_transaction_s, answer.received_at - answer.sent_at)
        return answer

    def _effect(self, request: Any) -> Effect:
        return self.dialect.station_config.effect_of(self.dialect.codec.encode_request(request))

    def start_clock(self) -> DriveOperation[None]:
        """The checks begin now, unless the wish or an operation around this one is older."""
        if self.checks_started_at is None:
            self.checks_started_at = (yield from get_bus_conditions()).now

    def check_deadline(self) -> DriveOperation[BusConditions]:
        """The surroundings after the checks. Raises Expired where they took so long that this is another wish (I1)."""
        around = yield from get_bus_conditions()
        limit_s = max(
            CHECKS_TIMEOUT_S,
            CHECKS_TIMEOUT_TRANSACTIONS * self.fastest_transaction_s if isfinite(self.fastest_transaction_s) else 0.0,
        )
        age_s = 0.0 if self.checks_started_at is None else around.now - self.checks_started_at
        if age_s > limit_s:
            raise Expired("drives.prepare_too_long", age_s=round(age_s, 2), limit_s=round(limit_s, 1))
        return around

    def create_command(self, kind: CommandKind, around: BusConditions) -> DriveCommand:
        """The user's wish: made now, but where the moment of the wish is known it expires ``PREPARE_S`` after that, the
        checks included; a stop since then takes it away (6.5)."""
        generation = around.stop_epoch if self.stop_epoch is None else self.stop_epoch
        latest = (
            inf
            if self.requested_at is None
            else self.requested_at + max(0.0, CHECKS_TIMEOUT_S - permissives.COMMAND_TTL_S[kind])
        )
        made_at = min(around.now, latest)
        return self.drive.create_command(kind, replace(around, now=made_at, stop_epoch=generation))

    def read(self, request: Any) -> DriveOperation[BusResult]:
        """One read, taken into the book."""
        answer = yield from self.transact(request)
        if answer.error is None and answer.reply is not None:
            facts = self.dialect.decode_readings(request, answer.reply, answer.received_at)
            self.reading_pairs.add(facts)
            self._record_deceleration(facts)
            self.drive.on_read(answer)
        return answer

    def _record_deceleration(self, facts: Readings) -> None:
        """Each reading counts: on a slow line with many drives a look of several reads takes a second."""
        reading = facts.get("output_frequency")
        if reading is None or not isinstance(reading.value, int | float):
            return
        if self._lowest_hz is not None and reading.value < self._lowest_hz:
            self.last_deceleration_at = reading.source_time
        self._lowest_hz = float(reading.value if self._lowest_hz is None else min(self._lowest_hz, reading.value))

    def sync(self, avoid: Any = None) -> DriveOperation[DrivebusError | None]:
        """Prove that this station's replies are current (ruling 2). Returns what went wrong."""
        answer = yield from self.transact(self.dialect.sync_request(avoid))
        if answer.error is not None and getattr(answer.error, "key", "") == MIRRORED_REPLY_KEY:
            yield from self.transact(self.dialect.echo_test_read())
            answer = yield from self.transact(self.dialect.sync_request(avoid))
        if answer.error is not None:
            return _as_drivebus_error(answer.error)
        return None if self.dialect.is_valid_sync_reply(answer.reply) else NotPermitted("drives.fence_refused")

    def verified_reads(self, requests: tuple[Any, ...]) -> DriveOperation[DrivebusError | None]:
        """A fence, then these reads. Returns what went wrong first."""
        error = yield from self.sync()
        for request in requests:
            if error is not None:
                return error
            answer = yield from self.read(request)
            error = None if answer.error is None else _as_drivebus_error(answer.error)
        return error

    def read_verified_state(self, allowed_failures: int = 1) -> DriveOperation[DrivebusError | None]:
        """State of the drive now: two fenced reads that agree, taken after this call. Sets ``verdict``.

        So many rounds may fail on the bus; then its error is returned and the state is unknown.
        """
        self.reading_pairs.clear()
        self.derived = STATE_NOT_READ
        requests = self.dialect.state_reads()
        if not requests:
            return None
        failed = 0
        for turn in range(1, VERIFICATION_ROUNDS + EXTRA_VERIFICATION_ROUNDS + 1):
            error = yield from self.verified_reads(requests)
            if error is not None:
                failed += 1
                self.reading_pairs.clear()
                if failed <= allowed_failures:
                    continue
                self.derived = DerivedState(DriveState.UNKNOWN, reason="drives.no_answer")
                return error
            self._record_motion()
            verdict = self.dialect.derive_state(self.reading_pairs) if turn - failed >= VERIFICATION_ROUNDS else None
            if verdict is not None:
                self.derived = yield from self._with_fault_code(verdict)
                return None
        self.derived = DerivedState(DriveState.UNKNOWN, reason="drives.disagree")
        return None

    def _record_motion(self) -> None:
        """One reading that shows motion is enough to know that the drive was not simply standing."""
        single = ReadingPairs()
        single.latest = single.previous = dict(self.reading_pairs.latest)
        verdict = self.dialect.derive_state(single)
        self.motion_seen = self.motion_seen or (verdict is not None and verdict.state.turning)

    def _with_fault_code(self, verdict: DerivedState) -> DriveOperation[DerivedState]:
        """Where the state only says "fault", further reads name it."""
        requests = self.dialect.fault_reads() if verdict.fault_code is not None else ()
        for _ in range(VERIFICATION_ROUNDS if requests else 0):
            for request in requests:
                yield from self.read(request)
        return (self.dialect.derive_state(self.reading_pairs) or verdict) if requests else verdict

    def request_permit(self, command: DriveCommand, frame: CommandFrame) -> DriveOperation[Permit | None]:
        """The gate's leave for a frame that is neither a read nor a stop; None for a stop, which needs none.

        Raises StartInhibited, Expired, Superseded, NotPermitted: nothing is sent then.
        """
        data = self.dialect.codec.encode_request(frame.request)
        effect = self.dialect.station_config.effect_of(data)
        if effect is Effect.STOP:
            return None
        if not self.dialect.is_allowed(data):
            raise NotPermitted("drives.not_listed", frame=data.hex(" ").upper())
        around = yield from get_bus_conditions()
        return permissives.grant_permit(
            command,
            self.dialect.address,
            effect,
            frame.retry_policy,
            around,
            self.permit_inputs(),
            self.dialect.profile.family,
        )

    def send_command(self, command: DriveCommand, frame: CommandFrame) -> DriveOperation[BusResult]:
        """Send one frame that is neither a read nor a stop: with a permit, or not at all."""
        permit = yield from self.request_permit(command, frame)
        return (yield from self.transact(frame.request, RequestPriority.COMMAND, frame.retry_policy, permit))

    def permit_inputs(self) -> PermitInputs:
        """What this conversation has established so far."""
        preflight = self.drive.preflight
        at = self.reading_pairs.oldest_time(*self.dialect.state_names)
        done = preflight is not None and preflight.passed
        return PermitInputs(self.derived, at, self.dialect.reports_run_state, done, self.limits_checked)

    def check_not_superseded(self, command: DriveCommand) -> DriveOperation[float]:
        """The time, unless a newer stop took this command away. Raises Superseded."""
        around = yield from get_bus_conditions()
        if around.stop_epoch != command.stop_epoch:
            raise self.superseded_error()
        return around.now

    def superseded_error(self) -> Superseded:
        """A stop came: whatever was sent, the stop is what counts, and nothing is resent (6.5)."""
        error = Superseded("drives.superseded")
        error.outcome = self.outcome(OutcomeStatus.UNKNOWN, "drives.superseded")
        return error

    def drive_status(self) -> DriveStatus:
        """What this conversation has read."""
        verdict = self.derived
        fault = None if verdict.fault_code is None else fault_from_code(self.dialect.profile, verdict.fault_code)
        at = self.reading_pairs.oldest_time(*self.dialect.state_names)
        return DriveStatus(verdict.state, verdict.direction, fault, self.profile_readings(), verdict.reason, at)

    def profile_readings(self) -> dict[str, Reading]:
        """The readings that the profile names."""
        return {name: r for name, r in self.reading_pairs.latest.items() if name in self.dialect.profile.signals}

    def outcome(self, word: OutcomeStatus, key: str, /, **params: Any) -> Outcome:
        """How it ended, with the frames so far and the status behind it."""
        return Outcome(word, key, params, self.exchanges(), self.drive_status())

    def rejected_outcome(self, answer: BusResult, **params: Any) -> Outcome | None:
        """The drive's own no as an outcome, None where it gave none. Raises the error of a frame that never left."""
        if not answer.sent and answer.error is not None:
            raise answer.error
        no = None if answer.reply is None else self.dialect.rejection(answer.reply)
        return None if no is None else self.outcome(OutcomeStatus.REFUSED, no.key, code=no.code, **params)

    def unverifiable_outcome(self, answered: bool, acknowledged: str, unknown: str, **params: Any) -> Outcome:
        """Nothing that can be read shows the effect (ruling 1): there is the drive's yes, or not even that."""
        if answered:
            return self.outcome(OutcomeStatus.ACKNOWLEDGED, acknowledged, **params)
        return self.outcome(OutcomeStatus.UNKNOWN, unknown, **params)

    def exchanges(self) -> tuple[FrameExchange, ...]:
        """Frames in the order in which they left."""
        both = [*self._command_exchanges, *self._read_exchanges]
        return tuple(sorted(both, key=lambda e: e.sent_at if e.sent_at is not None else 0.0))


def with_note(outcome: Outcome, key: str, /, **params: Any) -> Outcome:
    """The outcome with one more sentence."""
    return replace(outcome, notes=(*outcome.notes, (key, params)))


def frame_exchange(answer: BusResult) -> FrameExchange:
    """An answer as evidence."""
    found = FrameExchange(answer.sent, answer.received, answer.sent_at, answer.received_at)
    error = answer.error
    return replace(found, error=error.key, params=error.params) if isinstance(error, DrivebusError) else found


def _as_drivebus_error(error: Exception) -> DrivebusError:
    """Errors of an answer are ours by contract; anything else is a bug and is raised as such."""
    if isinstance(error, DrivebusError):
        return error
    raise error
