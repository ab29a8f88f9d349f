"""What can happen in a state of the gate campaign, and what does: the shell around the core, and everybody else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Self

from drivebus.bus.effects import Act as Deed
from drivebus.bus.effects import Done, Transmit, WakeAt
from drivebus.drives.dialect import Stop
from drivebus.drives.gate import Kind
from drivebus.errors import Expired, NotPermitted, PortLost, Superseded
from drivebus.lab.gate import question as gate_question
from drivebus.lab.gate.bytes import Act
from drivebus.lab.gate.monitor import Leave, Wish
from drivebus.lab.gate.question import Shown
from drivebus.lab.gate.state import FORGED, Held, State
from drivebus.lab.gate.subject import OTHER, OURS, reply_to
from drivebus.message import Ask, Effect, Lane, WriteClass


class World(State):
    """Mutable; ``copy`` before each event."""

    __slots__ = ()

    # --- what can happen ---------------------------------------------------------------------------------------

    def events(self, slots: int, rare: bool) -> list[str]:
        """All but the gate's. ``slots``: submissions at a time; ``rare``: spoiled replies, broadcast stops, cancels."""
        core, flight, present = self.core, self.core.flight, OURS in self.core.stations
        hung_s = self.subject.limit_s(Act.SETS) + 1.0
        alive = (self.command is not None and not self._void()) or self.held is not None or bool(self.leaves)
        found: list[str] = []
        if self.alarm is None or self.alarm >= self.now:
            found.append("step")
        if self.alarm is not None:
            found += ["wake"] * (self.now >= self.alarm) + ["sleep"] * (self.alarm > self.now + hung_s)
        if (
            flight is not None
            and flight.sent_end <= self.now <= flight.final_at
            and not flight.heard
            and not flight.job.broadcast
        ):
            found += ["reply"] + ["garble"] * rare
        found += ["open"] if not core.is_open else ["lose"]
        found += ["release"] if self.monitor.latched else ["latch"]
        found += ["remove"] if present else ["add"]
        found += ["hang"] * alive
        queued = {job.token for lane in core.scheduler.lanes for job in lane}
        busy: set[Any] = queued | ({flight.job.token} if flight is not None else set())
        if present and core.is_open:
            found += ["read"] * (not busy)
            if "stop" not in busy and alive:
                found += ["stop"] + ["lease"] * (self.subject.kind is Kind.JOG)
                found += ["everyone"] * (rare and bool(self.subject.dialect.stop_everyone()))
        if present and (self.command is None or self._void()):
            found.append("wish")
        if self.held is not None and len(self.leaves) < slots and self.subject.acts(self.held.place, self.shadow):
            found += ["submit", "raw"]
        return found + [f"cancel {slot}" for slot in sorted(self.leaves) if rare]

    def _void(self) -> bool:
        return bool(self._wish_lacks())

    def _wish_lacks(self) -> tuple[str, ...]:
        """What the wish has lost for good."""
        assert self.wish is not None
        old = self.now > self.wish.made_at + self.subject.limit_s(Act.SETS)
        return self.monitor.epoch.since(self.wish.epoch) + ("unexpired",) * old

    def places(self) -> list[int]:
        """Frames of the command that a permit can be asked for now; a stop needs none, and what follows follows."""
        if self.command is None or OURS not in self.core.stations:
            return []
        places = range(len(self.subject.frames) if self._begun else 1)
        return [place for place in places if self.subject.acts(place, self.shadow)]

    # --- what happens ------------------------------------------------------------------------------------------

    def happens(self, event: str) -> Self:
        """The event, and all that the core does about it."""
        self.subject.shadow = self.shadow
        word, _, rest = event.partition(" ")
        _EVENTS[word](self, rest)
        self.shadow = self.subject.shadow
        self._forget()
        return self

    def _forget(self) -> None:
        """What lacks two things can never come back, and a latch over nothing at all is as good as one set later."""
        if self.wish is not None and len(self._wish_lacks()) > 1:
            self.command = self.wish = self.held = None
            self._begun = False
        if self.monitor.latched and self.wish is None and not self.leaves and OURS in self.core.stations:
            self._latch("", False)

    def grant(self, place: int, shown: Shown, lacks: tuple[str, ...]) -> Self:
        """The gate says yes to this combination."""
        self.subject.shadow = self.shadow
        assert self.command is not None and self.wish is not None
        seen = gate_question.around(self.core, self.now)
        permit = gate_question.ask(self.subject, self.command, place, seen, shown)
        assert permit is not None
        data = self.subject.dialect.codec.encode_request(self.subject.frames[place].request)
        act = self.monitor.act_of(data)
        until = self.wish.made_at + self.subject.limit_s(act)
        self.held = Held(permit, Leave(data, act, until, self.wish.epoch, lacks), place)
        return self

    def _step(self, _: str) -> None:
        self.now = self.subject.grid.after(self.now)

    def _wake(self, _: str) -> None:
        self.alarm = None
        self._perform(self._touched().woke(self.now))

    def _sleep(self, _: str) -> None:
        assert self.alarm is not None
        self.now = self.alarm

    def _hang(self, _: str) -> None:
        """The host stands still for longer than any command lives."""
        self.now += self.subject.limit_s(Act.SETS) + 1.0

    def _reply(self, _: str, spoil: int = 0) -> None:
        flight = self.core.flight
        assert flight is not None
        data = bytearray(reply_to(flight.job.request, flight.job.codec))
        data[-2] ^= spoil  # of the check, where there is one
        self._perform(self._touched().received(bytes(data), self.now))

    def _open(self, _: str) -> None:
        self.monitor.is_open = True
        self._perform(self._touched().opened(self.now))

    def _lose(self, _: str) -> None:
        self.monitor.lost()
        self._perform(self._touched().lost(PortLost("bus.closed"), self.now))

    def _latch(self, _: str, on: bool = True) -> None:
        self.monitor.latched = on
        self._touched().latch(None, on)

    def _remove(self, _: str) -> None:
        self.monitor.removed()
        self._perform(self._touched().remove(OURS, self.now))

    def _add(self, _: str) -> None:
        self.monitor.present = True
        self._touched().add(self.subject.dialect.link)

    def _read(self, _: str) -> None:
        self._ask(Ask(OURS, self.subject.dialect.plain_read()), "read")

    def _stop(self, _: str, how: Stop = Stop.STOP) -> None:
        self.monitor.stopped()
        self._ask(Ask(OURS, self.subject.stops(how), Lane.STOP, WriteClass.ABSOLUTE), "stop")

    def _everyone(self, _: str) -> None:
        self.monitor.stopped()
        request = self.subject.dialect.stop_everyone()[0]
        address = self.subject.dialect.codec.address_of(request)
        self._ask(Ask(address, request, Lane.STOP, WriteClass.BROADCAST), "stop")

    def _make(self, _: str) -> None:
        self.command = self.subject.talk.command(self.subject.kind, gate_question.around(self.core, self.now))
        self.wish, self.held, self._begun = Wish(self.now, self.monitor.epoch), None, False

    def _submit(self, _: str, raw: bool = False) -> None:
        """As a conversation does it; ``raw``: as a program may that calls the bus itself and labels it at will."""
        held = self.held
        assert held is not None
        frame, slot = self.subject.frames[held.place], min({0, 1, 2} - set(self.leaves))
        ask = Ask(OURS, frame.request, Lane.PARAMETER, WriteClass.ABSOLUTE, held.permit)
        if not raw:
            talking = self.subject.talk.ask(frame.request, Lane.COMMAND, frame.write_class, held.permit)
            step: Any = next(talking)
            talking.close()
            ask = step
        self.leaves[slot] = held.leave
        self._ask(ask, slot)

    def _forge(self, _: str) -> None:
        """Frames that act, under no permit or another's: each must be refused on the spot."""
        request = self.subject.frames[0].request
        permit = self.held.permit if self.held is not None and self.held.place == 0 else None
        asks = [("a permit", Ask(OURS, request, Lane.COMMAND)), ("a permit", Ask(OURS, request, Lane.POLL))]
        if permit is not None:
            swapped = Effect.SETTING if permit.effect is Effect.MOTION else Effect.MOTION
            asks += [
                ("permit for this station", Ask(OURS, request, Lane.COMMAND, permit=replace(permit, station=OTHER))),
                ("permit for this station", Ask(OTHER, self.subject.foreign, Lane.COMMAND, permit=permit)),
                ("permit for this station", Ask(OURS, self.subject.foreign, Lane.COMMAND, permit=permit)),
                ("permit for this effect", Ask(OURS, request, Lane.COMMAND, permit=replace(permit, effect=swapped))),
            ]
        self._touched().add(self.subject.other.link)
        for slot, (what, ask) in enumerate(asks, FORGED):
            data = self.subject.dialect.codec.encode_request(ask.request)
            least = Leave(data, self.monitor.act_of(data), self.now, self.monitor.epoch)
            leave = least if permit is None or self.held is None else self.held.leave
            self.leaves[slot] = replace(leave, data=data, lacks=(*leave.lacks, what))
            self._ask(ask, slot)
        del self._touched().stations[OTHER]

    def _cancel(self, slot: str) -> None:
        out = self.core.flight is not None and self.core.flight.job.token == int(slot)
        self._perform(self._touched().cancel(int(slot), self.now))
        if not out:
            self.leaves.pop(int(slot), None)

    # --- the shell ---------------------------------------------------------------------------------------------

    def _ask(self, ask: Ask, token: Any) -> None:
        self._perform(self._touched().submit(ask, token, self.now))

    def _perform(self, acts: list[Deed]) -> None:
        for act in acts:
            if type(act) is Transmit:
                self._left(act.data)
        for act in acts:
            if type(act) is WakeAt:
                self.alarm = act.when
            elif type(act) is Done:
                self._done(act)

    def _left(self, data: bytes) -> None:
        act, slot, lacks = self.monitor.left(data, self.leaves, self.now)
        self.seen.moved += act is Act.MOVES
        self.seen.acted += act is Act.SETS
        if lacks:
            self.seen.bad.append(f"{data.hex(' ')} left without: {', '.join(lacks)}")
        if slot is not None:
            self._begun = self.wish is not None and len(self.subject.frames) > 1
            self.leaves[slot] = replace(self.leaves[slot], sent=min(3, self.leaves[slot].sent + 1))

    def _done(self, done: Done) -> None:
        leave = self.leaves.pop(done.token, None)
        if leave is not None and (not leave.sent or isinstance(done.answer.error, NotPermitted | Expired | Superseded)):
            self.seen.refused.append(self.monitor.lacks(leave, self.now))
        if done.answer.sent and done.token != "read":
            self.subject.dialect.noted(done.answer.ask.request)


_EVENTS: dict[str, Callable[[World, str], None]] = {
    "step": World._step, "wake": World._wake, "sleep": World._sleep, "hang": World._hang, "reply": World._reply,
    "garble": lambda world, rest: world._reply(rest, 1), "open": World._open, "lose": World._lose,
    "latch": World._latch, "release": lambda world, rest: world._latch(rest, False), "remove": World._remove,
    "add": lambda world, rest: world._add(rest), "read": World._read, "stop": World._stop,
    "lease": lambda world, rest: world._stop(rest, Stop.JOG_STOP), "everyone": World._everyone, "wish": World._make,
    "submit": World._submit, "raw": lambda world, rest: world._submit(rest, True), "forge": World._forge,
    "cancel": World._cancel,
}  # fmt: skip
