"""State of one operation and the parts that operations are made of: transactions, verified reads, permits, outcomes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from drivebus.bus.messages import BusRequest, BusResult, Permit, RequestPriority
from drivebus.drives import permissives
from drivebus.drives.context import DriveContext
from drivebus.drives.dialects.base import CommandFrame, Rejection, reported_fault
from drivebus.drives.operations.command_age import CommandAge
from drivebus.drives.operations.exchange_log import ExchangeLog
from drivebus.drives.operations.state_reports import StateReports
from drivebus.drives.operations.steps import BusConditions, DriveOperation, get_bus_conditions, transact
from drivebus.drives.outcome import FrameExchange, Outcome, OutcomeStatus
from drivebus.drives.permissives import CommandKind, DriveCommand, DriveEvidence, PermitInputs
from drivebus.drives.readings import ReadingPairs, Readings
from drivebus.drives.state import STATE_NOT_READ, DerivedState, DriveState, DriveStatus
from drivebus.errors import DrivebusError, NotPermitted, PortLost, ProtocolError, StartInhibited, Superseded
from drivebus.protocols.codec import Effect
from drivebus.values import Text, bilingual_text

VERIFICATION_ROUNDS = 2  # a state is read this often, each time behind a sync probe of its own, and must agree
EXTRA_VERIFICATION_ROUNDS = 3  # further rounds for a drive that changes its state between two reads


@dataclass(frozen=True, slots=True)
class UnconfirmedModel:
    """Station that has not answered as its model: why, and whether it answered at all."""

    why: Text
    answered: bool


class OperationContext:
    """State of one operation: readings so far, derived state, command age and motion of the drive."""

    def __init__(
        self,
        drive: DriveContext,
        *,
        stop_epoch: int | None = None,
        checks_started_at: float | None = None,
        requested_at: float | None = None,
        sync_request: Callable[[Any], Any] | None = None,
    ) -> None:
        """``sync_request``: source of sync probes that the operation shares with others; None: those of the dialect."""
        self.drive, self.dialect = drive, drive.dialect
        self._sync_request = sync_request or drive.dialect.sync_request
        self.age = CommandAge(requested_at, checks_started_at)
        self._earlier_withdrawal = drive.withdrawal
        self.stop_epoch = stop_epoch  # stops up to the request, and those sent here; None: up to ``create_command``
        self.reading_pairs = ReadingPairs()
        self.derived: DerivedState = STATE_NOT_READ
        self.state_reports = StateReports()
        self.stop_rejection: Rejection | None = None  # how the drive rejected the last stop that was sent
        self.withheld_stop: UnconfirmedModel | None = None  # why the last stop was not sent
        self.stop_awaits_model = False  # the read of the model, which goes before the first stop, has not ended yet
        self.has_sent_preparation = False  # the unlock and the words before every start were sent
        self.read_priority = RequestPriority.PARAMETER  # of requests without a given one; STOP_READ during a stop
        self.waits_in_quarantine = True  # False: a read that a quarantine of 5 s would delay fails
        self.sent_count = 0  # transactions whose frame was sent, with or without a reply
        self.lost_replies = 0  # frames without a valid reply; a retry by the bus counts as a frame of its own
        self.stops_sent = 0  # stops that were given to the port
        self.first_frame: Any = None  # of a stop, the same for each that it serves; None: it serves this one alone
        self.port_error: PortLost | None = None  # why the last transaction failed, where the port was lost
        self.port_loss: PortLost | None = None  # latest loss of the port: it supersedes a command as a stop does
        self.confirmed_setpoint: tuple[int, float] | None = None  # word and Hz of the last setpoint that was read back
        self.limits_checked = False  # frequency and direction are within the limits of drive and user
        self.overspeed_hz: float | None = None  # after a start from standstill: above it the drive is stopped
        self.motion_seen = False  # at least one reading showed that the drive turns, and no stop was confirmed since
        self.run_seen = False  # at least one reading showed that the motor follows its set frequency
        self.changes_run = False  # every frame with a permit counts as a motion of this command: the drive may turn
        self.may_be_running = False  # a frame that moves may have been executed, and no stop was confirmed since
        self.last_motion_result: BusResult | None = None  # result of the last frame that may move the motor
        self.last_deceleration_at: float | None = None  # time of the last reading that shows the motor slowing down
        self._lowest_hz: float | None = None
        self._frequency_read_at = 0.0
        self._exchanges = ExchangeLog()

    @property
    def exchanges(self) -> tuple[FrameExchange, ...]:
        """Frames that were sent so far, in their order."""
        return self._exchanges.in_order()

    def check_frequency(self, frequency_hz: float) -> tuple[int, float]:
        """Return the raw word of a frequency and the frequency that it means. Raises LimitError."""
        word_and_hz = self.drive.check_frequency(frequency_hz)
        self.limits_checked = True
        return word_and_hz

    def transact(
        self,
        request: Any,
        priority: RequestPriority | None = None,
        permit: Permit | None = None,
        tag: Any = None,
    ) -> DriveOperation[BusResult]:
        """Perform one transaction, log it and update the dialect. ``tag``: see ``BusRequest``.

        Without ``priority`` the request has that of a read, which no stop removes from the queue.
        """
        expires_at = permit.expires_at if permit is not None else None
        effect = self.effect(request)
        if self.stop_epoch is not None and effect is Effect.STOP:
            self.stop_epoch += 1
        moves = permit is not None and (permit.effect is Effect.MOTION or self.changes_run)
        was_running = self.may_be_running
        self.may_be_running = was_running or moves  # holds also where the operation is cancelled during the transaction
        bus_request = BusRequest(
            station=self.dialect.address,
            request=request,
            priority=self.read_priority if priority is None else priority,
            permit=permit,
            expires_at=expires_at,
            waits_in_quarantine=self.waits_in_quarantine,
            tag=tag,
        )
        try:
            result = yield from transact(bus_request)
        except GeneratorExit:  # the operation is cancelled, and its command may be on the wire
            if permit is not None:
                self.dialect.on_sent(request)
            raise
        self.port_error = result.error if isinstance(result.error, PortLost) else None
        self.port_loss = self.port_error or self.port_loss
        if moves:
            rejection = self._rejection(result)
            is_refused = result.attempts == 1 and rejection is not None and not rejection.may_be_executed
            executed = bool(result.sent) and not is_refused
            self.last_motion_result, self.may_be_running = result, was_running or executed
        if result.sent:
            self.sent_count += 1
            self.dialect.on_sent(request)
            if result.reply is not None and self._rejection(result) is None:
                self.dialect.on_accepted(request)
            self.lost_replies += result.attempts - (result.error is None)
            self._exchanges.add(result, effect)
            self.age.add(result)
        return result

    def _rejection(self, result: BusResult) -> Rejection | None:
        return None if result.reply is None else self.dialect.rejection(result.reply)

    def effect(self, request: Any) -> Effect:
        """Return the effect of a request on the motor, by its bytes."""
        return self.dialect.station_config.effect_of(self.dialect.codec.encode_request(request))

    def check_model(self) -> DriveOperation[UnconfirmedModel | None]:
        """Read whether the station is of this model, unless that is known; None where it is.

        The word that stops one model starts another one at the same register. A rejection shows no model: see
        docs/explanation/bus-stop.md.
        """
        yield from self.void_checks_after_contact_loss()
        while (request := self.dialect.model_check()) is not None:
            result = yield from self.read(request)
            if self.dialect.model_check() == request:
                break
        else:
            return None
        if isinstance(result.error, DrivebusError):
            return UnconfirmedModel(bilingual_text(result.error.key, **result.error.params), answered=False)
        rejection = None if result.reply is None else self.dialect.rejection(result.reply)
        return UnconfirmedModel(rejection.text if rejection else bilingual_text("drives.foreign_status"), answered=True)

    def void_checks_after_contact_loss(self) -> DriveOperation[None]:
        """Void the pre-flight and the model check of a station that was lost and answers again.

        Without power a drive is exchanged, or set on its keypad when it comes back. Nothing is voided while it is
        silent: a stop to a motor that may still run does not wait for a reply.
        """
        conditions = yield from get_bus_conditions()
        if conditions.answers:
            self.dialect.follow_contact_losses(conditions.contact_losses)
            if conditions.contact_losses != self.drive.contact_losses:
                self.drive.contact_losses = conditions.contact_losses
                self.drive.preflight = None

    def start_clock(self) -> DriveOperation[None]:
        """Start the time limit of the checks, unless the request or an enclosing operation has started it."""
        if self.age.checks_started_at is None:
            self.age.checks_started_at = (yield from get_bus_conditions()).now

    def check_deadline(self) -> DriveOperation[BusConditions]:
        """Return the bus conditions after the checks. Raises Expired where the checks took too long."""
        conditions = yield from get_bus_conditions()
        self.age.check(conditions.now)
        return conditions

    def create_command(self, kind: CommandKind, conditions: BusConditions) -> DriveCommand:
        """Create the command of this operation; every stop since its request supersedes it."""
        stop_epoch = conditions.stop_epoch if self.stop_epoch is None else self.stop_epoch
        created_at = self.age.created_at(kind, conditions.now)
        return self.drive.create_command(kind, replace(conditions, now=created_at, stop_epoch=stop_epoch))

    def read(self, request: Any) -> DriveOperation[BusResult]:
        """Perform one read and keep its readings."""
        result = yield from self.transact(request)
        if result.error is None and result.reply is not None:
            readings = self.dialect.decode_readings(request, result.reply, result.received_at)
            self.reading_pairs.add(readings)
            self._record_deceleration(readings)
            self.drive.on_read(result)
        return result

    def _record_deceleration(self, readings: Readings) -> None:
        """Record the time of a frequency below all before. A single reading counts: a verified state can take a second.

        One of 0 Hz shows deceleration up to the reading before it only: the motor may have stopped right after that.
        """
        reading = readings.get("output_frequency")
        if reading is None or reading.source_time is None or not isinstance(reading.value, int | float):
            return
        hz, at, before = float(reading.value), reading.source_time, self._frequency_read_at
        if self._lowest_hz is not None and hz < self._lowest_hz:
            self.last_deceleration_at = at if hz > 0 else before
        self._lowest_hz = hz if self._lowest_hz is None else min(self._lowest_hz, hz)
        self._frequency_read_at = at

    def sync(self, avoid: Any = None) -> DriveOperation[DrivebusError | None]:
        """Send a sync probe, whose reply proves that replies are current, and return what went wrong."""
        result = yield from self.transact(self._sync_request(avoid))
        if _is_mirrored_reply(result):
            test = yield from self.transact(self.dialect.echo_test_read())
            if isinstance(test.error, ProtocolError):  # what it names is why the echo is not known
                return test.error
            result = yield from self.transact(self._sync_request(avoid))
        if result.error is not None:
            return _as_drivebus_error(result.error)
        return None if self.dialect.is_valid_sync_reply(result.reply) else NotPermitted("drives.sync_probe_rejected")

    def verified_reads(self, requests: tuple[Any, ...]) -> DriveOperation[DrivebusError | None]:
        """Perform reads behind a sync probe and return what went wrong first."""
        error = yield from self.sync()
        for request in requests:
            if error is not None:
                return error
            result = yield from self.read(request)
            error = None if result.error is None else _as_drivebus_error(result.error)
        return error

    def read_verified_state(self, allowed_failures: int = 1) -> DriveOperation[DrivebusError | None]:
        """Read the state now and set ``derived``: two verified reads that agree, both taken after this call.

        ``allowed_failures`` rounds may fail on the bus; then its error is returned and the state is unknown.
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
                self.state_reports.add_failure(error)
                self.reading_pairs.clear()
                if failed <= allowed_failures:
                    continue
                self.derived = DerivedState(DriveState.UNKNOWN, reason="drives.no_answer")
                return error
            self._record_report()
            derived = self.dialect.derive_state(self.reading_pairs) if turn - failed >= VERIFICATION_ROUNDS else None
            if derived is not None:
                self.derived = yield from self._with_fault_code(derived)
                return None
        why = self.reading_pairs.bad_reason(*self.dialect.state_names) or "drives.disagree"
        self.state_reports.unusable = bilingual_text(why)
        self.derived = DerivedState(DriveState.UNKNOWN, reason=why)
        return None

    def require_state(self) -> DriveOperation[None]:
        """Read the verified state. Raises the error of the bus."""
        error = yield from self.read_verified_state()
        if error is not None:
            raise error

    def output_hz(self) -> float | None:
        """Return the newer of two output frequencies, None unless both were read."""
        pair = self.reading_pairs.pair("output_frequency")
        value = None if pair is None else pair[1].value
        return float(value) if isinstance(value, int | float) else None

    def _record_report(self) -> None:
        """Record what one read shows: motion in it proves that the drive did not simply stand."""
        single = ReadingPairs()
        single.latest = single.previous = dict(self.reading_pairs.latest)
        derived = self.dialect.derive_state(single)
        self.motion_seen = self.motion_seen or (derived is not None and derived.state.turning)
        self.run_seen = self.run_seen or (derived is not None and derived.state in permissives.RUN_STATES)
        self.state_reports.add(derived, single.latest)

    def _with_fault_code(self, derived: DerivedState) -> DriveOperation[DerivedState]:
        """Read the fault code where the state itself does not carry it."""
        requests = self.dialect.fault_reads() if derived.fault_code is not None else ()
        if not requests:
            return derived
        rounds = 0
        for _ in range(VERIFICATION_ROUNDS + EXTRA_VERIFICATION_ROUNDS):
            answered = True
            for request in requests:
                answered = (yield from self.read(request)).error is None and answered
            rounds += answered
            if rounds == VERIFICATION_ROUNDS:
                break
        return self.dialect.derive_state(self.reading_pairs) or derived

    def request_permit(self, command: DriveCommand, frame: CommandFrame) -> DriveOperation[Permit | None]:
        """Return a permit for a frame that is neither a read nor a stop; None for a stop, which needs none.

        Raises StartInhibited, Expired, Superseded or NotPermitted; nothing is sent then.
        """
        data = self.dialect.codec.encode_request(frame.request)
        effect = self.dialect.station_config.effect_of(data)
        if effect is Effect.STOP:
            return None
        if not self.dialect.is_allowed(data):
            raise NotPermitted("drives.not_listed", frame=data.hex(" ").upper())
        if command.kind is not CommandKind.RAMP_HOLD:  # the end of a hold is one of its commands
            self._check_not_withdrawn()
        conditions = yield from get_bus_conditions()
        return permissives.grant_permit(
            PermitInputs(
                command=command,
                station=self.dialect.address,
                family=self.dialect.profile.family,
                effect=effect,
                retry_policy=frame.retry_policy,
                conditions=conditions,
                evidence=self.evidence(),
            )
        )

    def _check_not_withdrawn(self) -> None:
        """Raise Superseded, with the frames that were sent, where the command was withdrawn since it began."""
        why = self.drive.withdrawal
        if why is not None and why is not self._earlier_withdrawal:
            error = Superseded(why.key, **why.params)
            error.outcome = self.outcome(OutcomeStatus.FAILED, why.key, **why.params)
            raise error

    def send_command(self, command: DriveCommand, frame: CommandFrame) -> DriveOperation[BusResult]:
        """Send one frame that is neither a read nor a stop. Raises the errors of ``request_permit``.

        Raises StartInhibited where the station has not answered as its model.
        """
        unconfirmed = yield from self.check_model()
        if unconfirmed is not None:
            model = self.dialect.profile.model
            raise StartInhibited(
                "drives.model_unconfirmed", station=self.dialect.address, model=model, why=unconfirmed.why
            )
        permit = yield from self.request_permit(command, frame)
        return (yield from self.transact(frame.request, RequestPriority.COMMAND, permit))

    def evidence(self) -> DriveEvidence:
        """Return what this operation has established so far."""
        preflight = self.drive.preflight
        return DriveEvidence(
            derived=self.derived,
            state_at=self.reading_pairs.oldest_time(*self.dialect.state_names),
            reports_run_state=self.dialect.reports_run_state,
            preflight_passed=preflight is not None and preflight.passed,
            limits_checked=self.limits_checked,
            is_prepared=self.is_prepared(),
            motion_seen=self.motion_seen,
            run_seen=self.run_seen,
        )

    def is_prepared(self) -> bool:
        """Return whether all that goes before a start was sent, and the status that was read last asks for no more."""
        commands = self.dialect.profile.commands
        if commands is None or not (commands.unlock or commands.preparation):
            return True
        if not self.has_sent_preparation:
            return False
        if commands.ready is None:
            return True
        word = self.reading_pairs.agreed_raw("state")
        return word is not None and commands.ready.matches(word)

    def check_not_superseded(self, command: DriveCommand) -> DriveOperation[float]:
        """Return the time. Raises Superseded where a newer stop took the command's place."""
        conditions = yield from get_bus_conditions()
        if conditions.stop_epoch != command.stop_epoch:
            raise self.superseded_error()
        return conditions.now

    def superseded_error(self) -> Superseded:
        """Return the error of a command that a stop, or the loss of the port, took the place of: nothing is resent."""
        key, params = "drives.superseded", {}
        if self.port_loss is not None:
            key, params = "drives.command_port_lost", {"why": Text.per_language(self.port_loss.text)}
        error = Superseded(key, **params)
        error.outcome = self.outcome(OutcomeStatus.UNKNOWN, key, **params)
        return error

    def drive_status(self) -> DriveStatus:
        """Return the status from what this operation has read."""
        derived = self.derived
        fault = reported_fault(self.dialect.profile, derived)
        at = self.reading_pairs.oldest_time(*self.dialect.state_names)
        signals = self.dialect.profile.signals
        readings = {name: reading for name, reading in self.reading_pairs.latest.items() if name in signals}
        return DriveStatus(
            state=derived.state,
            direction=derived.direction,
            fault=fault,
            readings=readings,
            reason=derived.reason,
            at=at,
        )

    def outcome(self, status: OutcomeStatus, key: str, /, **params: Any) -> Outcome:
        """Return an outcome with the frames so far and the drive status; a note names the fault that it reports."""
        drive_status = self.drive_status()
        outcome = Outcome(
            status=status,
            key=key,
            params=params,
            exchanges=self.exchanges,
            drive_status=drive_status,
        )
        fault = drive_status.fault
        return outcome if fault is None else with_note(outcome, "drives.fault_named", fault=fault.name)

    def rejected_outcome(self, result: BusResult, **params: Any) -> Outcome | None:
        """Return the drive's rejection as an outcome, None where it did not reject.

        Raises the error of a frame that was never sent.
        """
        if not result.sent and result.error is not None:
            raise result.error
        rejection = self._rejection(result)
        return None if rejection is None else self.refused_outcome(rejection, **params)

    def refused_outcome(self, rejection: Rejection, **params: Any) -> Outcome:
        """Return the outcome of a command that the drive rejected; a note names the next step where one is known."""
        outcome = self.outcome(OutcomeStatus.REFUSED, rejection.key, code=rejection.code, **params)
        return outcome if rejection.remedy_key is None else with_note(outcome, rejection.remedy_key)

    def unverifiable_outcome(
        self, acknowledged_key: str, unknown_key: str, *, answered: bool, **params: Any
    ) -> Outcome:
        """Return the outcome of an effect that no read can show: acknowledged if the drive answered, else unknown."""
        if answered:
            return self.outcome(OutcomeStatus.ACKNOWLEDGED, acknowledged_key, **params)
        return self.outcome(OutcomeStatus.UNKNOWN, unknown_key, **params)


def with_note(outcome: Outcome, key: str, /, **params: Any) -> Outcome:
    """Return the outcome with one more note."""
    return replace(outcome, notes=(*outcome.notes, (key, params)))


def _is_mirrored_reply(result: BusResult) -> bool:
    """Return whether a reply that equals its request was rejected, once or twice received: it may be our echo."""
    key = getattr(result.error, "key", "")
    return key == "bus.own_echo" or (key == "bus.second_reply" and result.received.startswith(result.sent))


def _as_drivebus_error(error: Exception) -> DrivebusError:
    """Return an error of the bus; raise any other exception, which is a bug."""
    if isinstance(error, DrivebusError):
        return error
    raise error
