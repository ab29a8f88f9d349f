"""What can happen in a state of the gate campaign, and what does: the shell around the core, and everybody else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Self

from drivebus.bus.commands import CoreCommand as Deed
from drivebus.bus.commands import DeliverResult, Send, SetTimer
from drivebus.bus.messages import BusRequest, RequestPriority, RetryPolicy
from drivebus.drives.dialects.base import StopMode
from drivebus.drives.permissives import CommandKind
from drivebus.errors import Expired, NotPermitted, PortLost, Superseded
from drivebus.protocols.codec import Effect
from verification.model_check import permissive_inputs as gate_question
from verification.model_check.model_state import FIRST_FORGED_SLOT, HeldPermit, ModelState
from verification.model_check.model_subject import OTHER_ADDRESS, OUR_ADDRESS, normal_reply
from verification.model_check.permissive_inputs import PermissiveInputs
from verification.model_check.permit_monitor import ModelCommand, PermitRecord
from verification.reference.request_effects import RequestEffect


class GateState(ModelState):
    """Mutable; ``copy`` before each event."""

    __slots__ = ()

    # --- what can happen ---------------------------------------------------------------------------------------

    def possible_events(self, slots: int, rare: bool) -> list[str]:
        """All but the gate's. ``slots``: submissions at a time; ``rare``: spoiled replies, broadcast stops, cancels."""
        core, flight, present = self.core, self.core.transaction, OUR_ADDRESS in self.core.stations
        hung_s = self.subject.limit_s(RequestEffect.SETTING) + 1.0
        alive = (
            (self.command is not None and not self._command_is_void())
            or self.held_permit is not None
            or bool(self.permits)
        )
        found: list[str] = []
        if self.alarm is None or self.alarm >= self.now:
            found.append("step")
        if self.alarm is not None:
            found += ["wake"] * (self.now >= self.alarm) + ["sleep"] * (self.alarm > self.now + hung_s)
        if (
            flight is not None
            and flight.tx_end_at <= self.now <= flight.ends_at
            and not flight.received_count
            and not flight.prepared.is_broadcast
        ):
            found += ["reply"] + ["garble"] * rare
        found += ["open"] if not core.is_open else ["lose"]
        found += ["release"] if self.monitor.latched else ["latch"]
        found += ["remove"] if present else ["add"]
        found += ["hang"] * alive
        queued = {job.token for lane in core.scheduler.queues for job in lane}
        busy: set[Any] = queued | ({flight.prepared.token} if flight is not None else set())
        if present and core.is_open:
            found += ["read"] * (not busy)
            if "stop" not in busy and alive:
                found += ["stop"] + ["lease"] * (self.subject.kind is CommandKind.JOG)
                found += ["everyone"] * (rare and bool(self.subject.dialect.broadcast_stop()))
        if present and (self.command is None or self._command_is_void()):
            found.append("wish")
        if (
            self.held_permit is not None
            and len(self.permits) < slots
            and self.subject.needs_permit(self.held_permit.place, self.shadow)
        ):
            found += ["submit", "raw"]
        return found + [f"cancel {slot}" for slot in sorted(self.permits) if rare]

    def _command_is_void(self) -> bool:
        return bool(self._missing_for_command())

    def _missing_for_command(self) -> tuple[str, ...]:
        """What the wish has lost for good."""
        assert self.model_command is not None
        old = self.now > self.model_command.made_at + self.subject.limit_s(RequestEffect.SETTING)
        return self.monitor.counts.missing_since(self.model_command.counts) + ("unexpired",) * old

    def frames_needing_permit(self) -> list[int]:
        """Frames of the command that a permit can be asked for now; a stop needs none, and what follows follows."""
        if self.command is None or OUR_ADDRESS not in self.core.stations:
            return []
        places = range(len(self.subject.frames) if self._sequence_started else 1)
        return [place for place in places if self.subject.needs_permit(place, self.shadow)]

    # --- what happens ------------------------------------------------------------------------------------------

    def apply(self, event: str) -> Self:
        """The event, and all that the core does about it."""
        self.subject.command_word = self.shadow
        word, _, rest = event.partition(" ")
        _EVENTS[word](self, rest)
        self.shadow = self.subject.command_word
        self._merge_equivalent()
        return self

    def _merge_equivalent(self) -> None:
        """What lacks two things can never come back, and a latch over nothing at all is as good as one set later."""
        if self.model_command is not None and len(self._missing_for_command()) > 1:
            self.command = self.model_command = self.held_permit = None
            self._sequence_started = False
        if (
            self.monitor.latched
            and self.model_command is None
            and not self.permits
            and OUR_ADDRESS in self.core.stations
        ):
            self._latch("", False)

    def grant(self, place: int, shown: PermissiveInputs, lacks: tuple[str, ...]) -> Self:
        """The gate says yes to this combination."""
        self.subject.command_word = self.shadow
        assert self.command is not None and self.model_command is not None
        seen = gate_question.bus_snapshot(self.core, self.now)
        permit = gate_question.request_permit(self.subject, self.command, place, seen, shown)
        assert permit is not None
        data = self.subject.dialect.codec.encode_request(self.subject.frames[place].request)
        act = self.monitor.effect_of(data)
        until = self.model_command.made_at + self.subject.limit_s(act)
        self.held_permit = HeldPermit(permit, PermitRecord(data, act, until, self.model_command.counts, lacks), place)
        return self

    def _step(self, _: str) -> None:
        self.now = self.subject.grid.after(self.now)

    def _wake(self, _: str) -> None:
        self.alarm = None
        self._perform(self._own_core().on_timer(self.now))

    def _sleep(self, _: str) -> None:
        assert self.alarm is not None
        self.now = self.alarm

    def _suspend(self, _: str) -> None:
        """The host stands still for longer than any command lives."""
        self.now += self.subject.limit_s(RequestEffect.SETTING) + 1.0

    def _reply(self, _: str, spoil: int = 0) -> None:
        flight = self.core.transaction
        assert flight is not None
        data = bytearray(normal_reply(flight.prepared.request, flight.prepared.codec))
        data[-2] ^= spoil  # of the check, where there is one
        self._perform(self._own_core().on_data(bytes(data), self.now))

    def _open(self, _: str) -> None:
        self.monitor.is_open = True
        self._perform(self._own_core().on_port_open(self.now))

    def _lose_port(self, _: str) -> None:
        self.monitor.on_port_lost()
        self._perform(self._own_core().on_port_lost(PortLost("bus.closed"), self.now))

    def _latch(self, _: str, on: bool = True) -> None:
        self.monitor.latched = on
        self._own_core().set_start_inhibit(None, on)

    def _remove(self, _: str) -> None:
        self.monitor.on_removed()
        self._perform(self._own_core().remove_station(OUR_ADDRESS, self.now))

    def _add(self, _: str) -> None:
        self.monitor.present = True
        self._own_core().add_station(self.subject.dialect.station_config)

    def _read(self, _: str) -> None:
        self._submit_request(BusRequest(OUR_ADDRESS, self.subject.dialect.echo_test_read()), "read")

    def _stop(self, _: str, how: StopMode = StopMode.STOP) -> None:
        self.monitor.on_stop()
        self._submit_request(
            BusRequest(OUR_ADDRESS, self.subject.stop_request(how), RequestPriority.STOP, RetryPolicy.IDEMPOTENT),
            "stop",
        )

    def _stop_all(self, _: str) -> None:
        self.monitor.on_stop()
        request = self.subject.dialect.broadcast_stop()[0]
        address = self.subject.dialect.codec.address_of(request)
        self._submit_request(BusRequest(address, request, RequestPriority.STOP, RetryPolicy.BROADCAST), "stop")

    def _make_command(self, _: str) -> None:
        self.command = self.subject.talk.create_command(
            self.subject.kind, gate_question.bus_snapshot(self.core, self.now)
        )
        self.model_command, self.held_permit, self._sequence_started = (
            ModelCommand(self.now, self.monitor.counts),
            None,
            False,
        )

    def _submit(self, _: str, raw: bool = False) -> None:
        """As a conversation does it; ``raw``: as a program may that calls the bus itself and labels it at will."""
        held = self.held_permit
        assert held is not None
        frame, slot = self.subject.frames[held.place], min({0, 1, 2} - set(self.permits))
        ask = BusRequest(OUR_ADDRESS, frame.request, RequestPriority.PARAMETER, RetryPolicy.IDEMPOTENT, held.permit)
        if not raw:
            talking = self.subject.talk.transact(
                frame.request, RequestPriority.COMMAND, frame.retry_policy, held.permit
            )
            step: Any = next(talking)
            talking.close()
            ask = step
        self.permits[slot] = held.record
        self._submit_request(ask, slot)

    def _submit_forged(self, _: str) -> None:
        """Frames that act, under no permit or another's: each must be refused on the spot."""
        request = self.subject.frames[0].request
        permit = self.held_permit.permit if self.held_permit is not None and self.held_permit.place == 0 else None
        asks = [
            ("a permit", BusRequest(OUR_ADDRESS, request, RequestPriority.COMMAND)),
            ("a permit", BusRequest(OUR_ADDRESS, request, RequestPriority.POLL)),
        ]
        if permit is not None:
            swapped = Effect.SETTING if permit.effect is Effect.MOTION else Effect.MOTION
            asks += [
                (
                    "permit for this station",
                    BusRequest(
                        OUR_ADDRESS, request, RequestPriority.COMMAND, permit=replace(permit, station=OTHER_ADDRESS)
                    ),
                ),
                (
                    "permit for this station",
                    BusRequest(OTHER_ADDRESS, self.subject.foreign, RequestPriority.COMMAND, permit=permit),
                ),
                (
                    "permit for this station",
                    BusRequest(OUR_ADDRESS, self.subject.foreign, RequestPriority.COMMAND, permit=permit),
                ),
                (
                    "permit for this effect",
                    BusRequest(OUR_ADDRESS, request, RequestPriority.COMMAND, permit=replace(permit, effect=swapped)),
                ),
            ]
        self._own_core().add_station(self.subject.other.station_config)
        for slot, (what, ask) in enumerate(asks, FIRST_FORGED_SLOT):
            data = self.subject.dialect.codec.encode_request(ask.request)
            least = PermitRecord(data, self.monitor.effect_of(data), self.now, self.monitor.counts)
            leave = least if permit is None or self.held_permit is None else self.held_permit.record
            self.permits[slot] = replace(leave, data=data, missing=(*leave.missing, what))
            self._submit_request(ask, slot)
        del self._own_core().stations[OTHER_ADDRESS]

    def _cancel(self, slot: str) -> None:
        out = self.core.transaction is not None and self.core.transaction.prepared.token == int(slot)
        self._perform(self._own_core().cancel(int(slot), self.now))
        if not out:
            self.permits.pop(int(slot), None)

    # --- the shell ---------------------------------------------------------------------------------------------

    def _submit_request(self, ask: BusRequest, token: Any) -> None:
        self._perform(self._own_core().submit(ask, token, self.now))

    def _perform(self, acts: list[Deed]) -> None:
        for act in acts:
            if type(act) is Send:
                self._on_transmit(act.data)
        for act in acts:
            if type(act) is SetTimer:
                self.alarm = act.when
            elif type(act) is DeliverResult:
                self._on_done(act)

    def _on_transmit(self, data: bytes) -> None:
        act, slot, lacks = self.monitor.on_frame_sent(data, self.permits, self.now)
        self.events.motion_frames += act is RequestEffect.MOTION
        self.events.setting_frames += act is RequestEffect.SETTING
        if lacks:
            self.events.findings.append(f"{data.hex(' ')} left without: {', '.join(lacks)}")
        if slot is not None:
            self._sequence_started = self.model_command is not None and len(self.subject.frames) > 1
            self.permits[slot] = replace(self.permits[slot], frames_sent=min(3, self.permits[slot].frames_sent + 1))

    def _on_done(self, done: DeliverResult) -> None:
        leave = self.permits.pop(done.token, None)
        if leave is not None and (
            not leave.frames_sent or isinstance(done.result.error, NotPermitted | Expired | Superseded)
        ):
            self.events.refused.append(self.monitor.missing_for_frame(leave, self.now))
        if done.result.sent and done.token != "read":
            self.subject.dialect.on_sent(done.result.bus_request.request)


_EVENTS: dict[str, Callable[[GateState, str], None]] = {
    "step": GateState._step,
    "wake": GateState._wake,
    "sleep": GateState._sleep,
    "hang": GateState._suspend,
    "reply": GateState._reply,
    "garble": lambda world, rest: world._reply(rest, 1),
    "open": GateState._open,
    "lose": GateState._lose_port,
    "latch": GateState._latch,
    "release": lambda world, rest: world._latch(rest, False),
    "remove": GateState._remove,
    "add": lambda world, rest: world._add(rest),
    "read": GateState._read,
    "stop": GateState._stop,
    "lease": lambda world, rest: world._stop(rest, StopMode.JOG_STOP),
    "everyone": GateState._stop_all,
    "wish": GateState._make_command,
    "submit": GateState._submit,
    "raw": lambda world, rest: world._submit(rest, True),
    "forge": GateState._submit_forged,
    "cancel": GateState._cancel,
}
