"""State of the model check: a real bus core, a command, a permit and the permit monitor, with all events.

A state can be copied and has a key; equal keys mean equal future behaviour.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Self

from drivebus.bus.commands import CoreCommand, DeliverResult, Send
from drivebus.bus.core import BusCore
from drivebus.bus.messages import BusRequest, Permit, RequestPriority
from drivebus.drives.dialects.base import StopMode
from drivebus.drives.permissives import CommandKind, DriveCommand
from drivebus.errors import Expired, NotPermitted, PortLost, Superseded
from drivebus.protocols.codec import Effect
from verification.model_check import core_copy, permissive_inputs
from verification.model_check.model_subject import (
    FINE_STEP_S,
    GRID_START_S,
    OTHER_ADDRESS,
    OUR_ADDRESS,
    ModelSubject,
    grid_serial_settings,
    normal_reply,
)
from verification.model_check.permissive_inputs import PermissiveInputs
from verification.model_check.permit_monitor import ModelCommand, PermitMonitor, PermitRecord
from verification.reference.effects import RequestEffect

FIRST_FORGED_SLOT = 8
"""First slot of requests without a granted permit."""


@dataclass(slots=True)
class TransitionEvents:
    """Effects of one event."""

    motion_frames: int = 0
    setting_frames: int = 0
    findings: list[str] = field(default_factory=list)
    refused: list[tuple[str, ...]] = field(default_factory=list)
    """Missing conditions of each frame that the bus rejected."""
    denied: list[tuple[str, ...]] = field(default_factory=list)
    """Missing conditions of each permit that the permissives refused."""


@dataclass(slots=True)
class HeldPermit:
    """Permit that can be used now, later or twice."""

    permit: Permit
    record: PermitRecord
    place: int


class GateState:
    """State of the model; mutable, so ``copy`` it before each event."""

    __slots__ = (
        "_owns_core",
        "_sequence_started",
        "command",
        "command_word",
        "core",
        "events",
        "held_permit",
        "model_command",
        "monitor",
        "now",
        "permits",
        "subject",
    )

    def __init__(self, subject: ModelSubject) -> None:
        self.subject = subject
        self.core = BusCore(grid_serial_settings(subject.grid), echo="off")
        self.core.registry.add(subject.dialect.station_config)
        self.monitor = PermitMonitor(model=subject.model)
        self.now = GRID_START_S
        self.command: DriveCommand | None = None
        self.model_command: ModelCommand | None = None
        self.held_permit: HeldPermit | None = None
        self.permits: dict[int, PermitRecord] = {}
        self.command_word = subject.command_word
        """What the dialect, which all states share, holds in this state."""
        self.events = TransitionEvents()
        self._sequence_started = False
        """Whether the first frame of the command was sent, so that the others may follow."""
        self._owns_core = True

    def copy(self) -> Self:
        """Return a copy, which shares the core until an event changes it."""
        made = object.__new__(type(self))
        made.subject, made.core, made.now, made._owns_core = self.subject, self.core, self.now, False
        made._sequence_started = self._sequence_started
        made.command, made.model_command, made.held_permit, made.command_word = (
            self.command,
            self.model_command,
            self.held_permit,
            self.command_word,
        )
        made.permits, made.monitor, made.events = dict(self.permits), self.monitor.copy(), TransitionEvents()
        return made

    def _own_core(self) -> BusCore:
        """Return the core for a change, copied where it is shared."""
        if not self._owns_core:
            self.core, self._owns_core = core_copy.copy_core(self.core), True
        return self.core

    # --- state key ---------------------------------------------------------------------------------------------

    def state_key(self) -> tuple[Any, ...]:
        """Return the key, equal for states with the same future behaviour."""
        far_s = self.subject.limit_s(RequestEffect.SETTING) + 1.0
        return (
            core_copy.state_key(self.core, self.now, far_s),
            self.command_key(),
            self.held_permit_key(),
            [(slot, *self._permit_key(record)) for slot, record in sorted(self.permits.items())],
            self.command_word,
            self._sequence_started,
            self.monitor.command_word & 4,
            self.now % self.subject.grid.tick_s,
        )

    @property
    def stop_epoch(self) -> int:
        station = self.core.stations.get(OUR_ADDRESS)
        return (station or self.core.registry.removed[OUR_ADDRESS]).stop_epoch

    def command_key(self) -> tuple[Any, ...] | None:
        if self.command is None or self.model_command is None:
            return None
        reason = _reason(self.monitor.counts.missing_since(self.model_command.counts))
        age_s = min(self.now - self.command.created_at, self.subject.limit_s(RequestEffect.SETTING) + FINE_STEP_S)
        return self.command.stop_epoch == self.stop_epoch, reason, 0.0 if reason else age_s

    def held_permit_key(self) -> tuple[Any, ...] | None:
        held = self.held_permit
        if held is None:
            return None
        same = held.permit.stop_epoch == self.stop_epoch
        return held.place, same, *self._permit_key(held.record)

    def _permit_key(self, record: PermitRecord) -> tuple[Any, ...]:
        """Return the key of a permit; of an invalid permit the remaining time does not count."""
        if record.frames_sent and record.effect is RequestEffect.MOTION:
            return ("sent", record.data)
        reason = _reason(self.monitor.counts.missing_since(record.counts))
        left_s = max(record.expires_at - self.now, -FINE_STEP_S)
        return 0.0 if reason else left_s, reason, record.missing, record.frames_sent, record.data

    @property
    def accepted_forged(self) -> bool:
        """Whether the bus accepted a request without a granted permit."""
        return any(slot >= FIRST_FORGED_SLOT for slot in self.permits)

    # --- possible events ---------------------------------------------------------------------------------------

    def possible_events(self, slots: int, *, rare: bool) -> list[str]:
        """Return the possible events, without grants. ``slots``: submissions at a time; ``rare``: damaged replies,
        broadcast stops, cancels."""
        core, transaction, present = self.core, self.core.transaction, OUR_ADDRESS in self.core.stations
        hung_s = self.subject.limit_s(RequestEffect.SETTING) + 1.0
        alive = (
            (self.command is not None and not self._command_is_void())
            or self.held_permit is not None
            or bool(self.permits)
        )
        found: list[str] = []
        if core.wake_at is None or core.wake_at >= self.now:
            found.append("step")
        if core.wake_at is not None:
            found += ["wake"] * (self.now >= core.wake_at) + ["sleep"] * (core.wake_at > self.now + hung_s)
        if (
            transaction is not None
            and transaction.tx_end_at <= self.now <= transaction.ends_at
            and not transaction.received_count
            and not transaction.prepared.is_broadcast
        ):
            found += ["reply"] + ["garble"] * rare
        found += ["open"] if not core.is_open else ["lose"]
        found += ["release"] if self.monitor.start_inhibited else ["inhibit"]
        found += ["remove"] if present else ["add"]
        found += ["hang"] * alive
        queued = {prepared.token for queue in core.scheduler.queues for prepared in queue}
        busy: set[Any] = queued | ({transaction.prepared.token} if transaction is not None else set())
        if present and core.is_open:
            found += ["read"] * (not busy)
            if "stop" not in busy and alive:
                found += ["stop"] + ["lease"] * (self.subject.kind is CommandKind.JOG)
                found += ["everyone"] * (rare and bool(self.subject.dialect.broadcast_stop()))
        if present and (self.command is None or self._command_is_void()):
            found.append("create")
        if (
            self.held_permit is not None
            and len(self.permits) < slots
            and self.subject.needs_permit(self.held_permit.place, self.command_word)
        ):
            found += ["submit", "raw"]
        return found + [f"cancel {slot}" for slot in sorted(self.permits) if rare]

    def _command_is_void(self) -> bool:
        return bool(self._missing_for_command())

    def _missing_for_command(self) -> tuple[str, ...]:
        """Return the conditions that the command has lost for good."""
        assert self.model_command is not None
        old = self.now > self.model_command.made_at + self.subject.limit_s(RequestEffect.SETTING)
        return self.monitor.counts.missing_since(self.model_command.counts) + ("unexpired",) * old

    def frames_needing_permit(self) -> list[int]:
        """Return the frames of the command that need a permit now."""
        if self.command is None or OUR_ADDRESS not in self.core.stations:
            return []
        places = range(len(self.subject.frames) if self._sequence_started else 1)
        return [place for place in places if self.subject.needs_permit(place, self.command_word)]

    # --- transitions -------------------------------------------------------------------------------------------

    def apply(self, event: str) -> Self:
        """Apply an event and all commands of the core that follow from it."""
        self.subject.command_word = self.command_word
        word, _, rest = event.partition(" ")
        _EVENTS[word](self, rest)
        self.command_word = self.subject.command_word
        self._merge_equivalent()
        return self

    def _merge_equivalent(self) -> None:
        """Merge states with equal futures: a command that lacks two conditions, a start inhibit without any command."""
        if self.model_command is not None and len(self._missing_for_command()) > 1:
            self.command = self.model_command = self.held_permit = None
            self._sequence_started = False
        if (
            self.monitor.start_inhibited
            and self.model_command is None
            and not self.permits
            and OUR_ADDRESS in self.core.stations
        ):
            self._set_start_inhibit("", on=False)

    def grant(self, place: int, shown: PermissiveInputs, missing: tuple[str, ...]) -> Self:
        """Grant a permit for this combination of inputs."""
        self.subject.command_word = self.command_word
        assert self.command is not None and self.model_command is not None
        conditions = permissive_inputs.bus_snapshot(self.core, self.now)
        permit = permissive_inputs.request_permit(self.subject, self.command, place, conditions, shown)
        assert permit is not None
        data = self.subject.dialect.codec.encode_request(self.subject.frames[place].request)
        effect = self.monitor.effect_of(data)
        until = self.model_command.made_at + self.subject.limit_s(effect)
        self.held_permit = HeldPermit(
            permit,
            PermitRecord(data=data, effect=effect, expires_at=until, counts=self.model_command.counts, missing=missing),
            place,
        )
        return self

    def _step(self, _: str) -> None:
        self.now = self.subject.grid.after(self.now)

    def _wake(self, _: str) -> None:
        self._perform(self._own_core().on_timer(self.now))

    def _sleep(self, _: str) -> None:
        assert self.core.wake_at is not None
        self.now = self.core.wake_at

    def _suspend(self, _: str) -> None:
        """Let a time pass that is longer than any command is valid."""
        self.now += self.subject.limit_s(RequestEffect.SETTING) + 1.0

    def _reply(self, _: str, spoil: int = 0) -> None:
        transaction = self.core.transaction
        assert transaction is not None
        data = bytearray(normal_reply(transaction.prepared.request, transaction.prepared.station.codec))
        data[-2] ^= spoil  # of the check, where there is one
        self._perform(self._own_core().on_data(bytes(data), self.now, 0))

    def _open(self, _: str) -> None:
        self.monitor.is_open = True
        self._perform(self._own_core().on_port_open(self.now))

    def _lose_port(self, _: str) -> None:
        self.monitor.on_port_lost()
        self._perform(self._own_core().on_port_lost(PortLost("bus.closed"), self.now))

    def _set_start_inhibit(self, _: str, *, on: bool = True) -> None:
        self.monitor.start_inhibited = on
        self._own_core().registry.set_start_inhibit(None, inhibited=on)

    def _remove(self, _: str) -> None:
        self.monitor.on_removed()
        self._perform(self._own_core().remove_station(OUR_ADDRESS, self.now))

    def _add(self, _: str) -> None:
        self.monitor.present = True
        self._own_core().registry.add(self.subject.dialect.station_config)

    def _read(self, _: str) -> None:
        self._submit_request(BusRequest(station=OUR_ADDRESS, request=self.subject.dialect.echo_test_read()), "read")

    def _stop(self, _: str, mode: StopMode = StopMode.STOP) -> None:
        self.monitor.on_stop()
        self._submit_request(
            BusRequest(
                station=OUR_ADDRESS,
                request=self.subject.stop_request(mode),
                priority=RequestPriority.STOP,
            ),
            "stop",
        )

    def _stop_all(self, _: str) -> None:
        self.monitor.on_stop()
        request = self.subject.dialect.broadcast_stop()[0]
        address = self.subject.dialect.codec.address_of(request)
        self._submit_request(
            BusRequest(station=address, request=request, priority=RequestPriority.STOP),
            "stop",
        )

    def _make_command(self, _: str) -> None:
        self.command = self.subject.op.create_command(
            self.subject.kind, permissive_inputs.bus_snapshot(self.core, self.now)
        )
        self.model_command, self.held_permit, self._sequence_started = (
            ModelCommand(self.now, self.monitor.counts),
            None,
            False,
        )

    def _submit(self, _: str, *, raw: bool = False) -> None:
        """Submit the frame of the held permit as an operation does; ``raw``: as a direct call of the bus with
        another priority."""
        held = self.held_permit
        assert held is not None
        frame, slot = self.subject.frames[held.place], min({0, 1, 2} - set(self.permits))
        bus_request = BusRequest(
            station=OUR_ADDRESS,
            request=frame.request,
            priority=RequestPriority.PARAMETER,
            permit=held.permit,
        )
        if not raw:
            operation = self.subject.op.transact(frame.request, RequestPriority.COMMAND, held.permit)
            word = self.subject.command_word
            step: Any = next(operation)
            operation.close()  # a cancelled operation takes its word for sent; here the bus sends it later
            self.subject.command_word = word
            bus_request = step
        self.permits[slot] = held.record
        self._submit_request(bus_request, slot)

    def _submit_forged(self, _: str) -> None:
        """Submit acting frames without a permit or with a foreign one; the bus must reject each at once."""
        held = self.held_permit if self.held_permit is not None and self.held_permit.place == 0 else None
        forged = list(self._forged_requests(None if held is None else held.permit))
        self._own_core().registry.add(self.subject.other.station_config)
        for slot, (missing, bus_request) in enumerate(forged, FIRST_FORGED_SLOT):
            data = self.subject.dialect.codec.encode_request(bus_request.request)
            least = PermitRecord(
                data=data, effect=self.monitor.effect_of(data), expires_at=self.now, counts=self.monitor.counts
            )
            record = least if held is None else held.record
            self.permits[slot] = replace(record, data=data, missing=(*record.missing, missing))
            self._submit_request(bus_request, slot)
        del self._own_core().stations[OTHER_ADDRESS]

    def _forged_requests(self, permit: Permit | None) -> Iterator[tuple[str, BusRequest]]:
        """Yield each request with the condition that it lacks."""
        request, foreign = self.subject.frames[0].request, self.subject.foreign
        for priority in (RequestPriority.COMMAND, RequestPriority.POLL):
            yield "a permit", BusRequest(station=OUR_ADDRESS, request=request, priority=priority)
        if permit is None:
            return
        swapped = Effect.SETTING if permit.effect is Effect.MOTION else Effect.MOTION
        for missing, station, acting, forged_permit in (
            ("permit for this station", OUR_ADDRESS, request, replace(permit, station=OTHER_ADDRESS)),
            ("permit for this station", OTHER_ADDRESS, foreign, permit),
            ("permit for this station", OUR_ADDRESS, foreign, permit),
            ("permit for this effect", OUR_ADDRESS, request, replace(permit, effect=swapped)),
        ):
            yield (
                missing,
                BusRequest(station=station, request=acting, priority=RequestPriority.COMMAND, permit=forged_permit),
            )

    def _cancel(self, slot: str) -> None:
        out = self.core.transaction is not None and self.core.transaction.prepared.token == int(slot)
        self._perform(self._own_core().cancel(int(slot), self.now))
        if not out:
            self.permits.pop(int(slot), None)

    # --- commands of the core ----------------------------------------------------------------------------------

    def _submit_request(self, bus_request: BusRequest, token: Any) -> None:
        self._perform(self._own_core().submit(bus_request, token, self.now))

    def _perform(self, commands: list[CoreCommand]) -> None:
        for effect in commands:
            if type(effect) is Send:
                self._on_transmit(effect.data)
        for effect in commands:
            if type(effect) is DeliverResult:
                self._on_done(effect)

    def _on_transmit(self, data: bytes) -> None:
        effect, slot, missing = self.monitor.on_frame_sent(data, self.permits, self.now)
        self.events.motion_frames += effect is RequestEffect.MOTION
        self.events.setting_frames += effect is RequestEffect.SETTING
        if missing:
            self.events.findings.append(f"{data.hex(' ')} left without: {', '.join(missing)}")
        if slot is not None:
            self._sequence_started = self.model_command is not None and len(self.subject.frames) > 1
            self.permits[slot] = replace(self.permits[slot], frames_sent=min(3, self.permits[slot].frames_sent + 1))

    def _on_done(self, done: DeliverResult) -> None:
        record = self.permits.pop(done.token, None)
        if record is not None and (
            not record.frames_sent or isinstance(done.result.error, NotPermitted | Expired | Superseded)
        ):
            self.events.refused.append(self.monitor.missing_for_frame(record, self.now))
        if done.result.sent and done.token != "read":
            request, reply = done.result.bus_request.request, done.result.reply
            self.subject.dialect.on_sent(request)
            if reply is not None and self.subject.dialect.rejection(reply) is None:
                self.subject.dialect.on_accepted(request)


def _reason(missing: tuple[str, ...]) -> str:
    return missing[0] if len(missing) == 1 else "many" if missing else ""


_EVENTS: dict[str, Callable[[GateState, str], None]] = {
    "step": GateState._step,
    "wake": GateState._wake,
    "sleep": GateState._sleep,
    "hang": GateState._suspend,
    "reply": GateState._reply,
    "garble": lambda state, rest: state._reply(rest, 1),
    "open": GateState._open,
    "lose": GateState._lose_port,
    "inhibit": GateState._set_start_inhibit,
    "release": lambda state, rest: state._set_start_inhibit(rest, on=False),
    "remove": GateState._remove,
    "add": lambda state, rest: state._add(rest),
    "read": GateState._read,
    "stop": GateState._stop,
    "lease": lambda state, rest: state._stop(rest, StopMode.JOG_STOP),
    "everyone": GateState._stop_all,
    "create": GateState._make_command,
    "submit": GateState._submit,
    "raw": lambda state, rest: state._submit(rest, raw=True),
    "forge": GateState._submit_forged,
    "cancel": GateState._cancel,
}
