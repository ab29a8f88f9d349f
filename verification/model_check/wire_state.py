"""The gate campaign's second part: strangers and doubles are heard on the wire itself, by the real bus.

In the first part the evidence is chosen; here it comes from bytes: requests of another master, and two answers where
one was asked for. Removing the station, adding it again, losing and opening the port do not make them unheard.
"""

from __future__ import annotations

from collections import deque
from typing import Any, Self

from verification.model_check import permissive_inputs as gate_question
from verification.model_check.gate_state import GateState
from verification.model_check.model_subject import OUR_ADDRESS, ModelSubject, normal_reply
from verification.model_check.permissive_inputs import PermissiveInputs, all_permissives_met

FOREIGN_MASTER_LATCH_S, DUPLICATE_LATCH_S = 60.0, 600.0
"""A second master is over after a minute of peace, two drives at one address after ten."""
DETECTIONS_TO_BLOCK = 2
"""Once may be a slip; two make a second master, or a second drive."""

EVENTS_OF_OTHER_SEARCH = frozenset({"raw", "latch", "release", "hang", "stop", "sleep", "wish"})
"""What the first part tries."""

SILENCE_GRID_TICKS = 3
"""The bus looks at what it heard once the line is silent: the gap, after the last bit of a frame of its own."""


class WireState(GateState):
    """A world in which somebody else may be on the line."""

    __slots__ = ("duplicate_replies", "foreign_requests")

    def __init__(self, subject: ModelSubject) -> None:
        super().__init__(subject)
        self.foreign_requests: tuple[float, ...] = ()
        self.duplicate_replies: tuple[float, ...] = ()
        self._forget_measurements()

    def copy(self) -> Self:
        made = super().copy()
        made.foreign_requests, made.duplicate_replies = self.foreign_requests, self.duplicate_replies
        return made

    def state_key(self) -> tuple[Any, ...]:
        core, station = self.core, self.core.stations.get(OUR_ADDRESS)
        owed = (
            (max(0.0, station.last_request_sent_at - self.now), station.last_request_answered)
            if station is not None
            else None
        )
        received = (
            core.unsolicited.has_foreign_master(self.now),
            len(station.duplicate_reply_times) if station is not None else 0,
        )
        doubted = self.now - station.suspect_since <= 5.0 if station is not None else False
        return (*super().state_key(), received, doubted, owed, self.missing_on_wire())

    def _add(self, rest: str) -> None:
        super()._add(rest)
        self._forget_measurements()

    def _forget_measurements(self) -> None:
        """How long a station that answers twice is listened to follows its reply times, which all states share."""
        self.core.stations[OUR_ADDRESS].counters.reply_times_s = deque(maxlen=0)

    def missing_on_wire(self) -> tuple[str, ...]:
        """What the line itself forbids now."""
        strangers = (
            sum(self.now - at <= FOREIGN_MASTER_LATCH_S for at in self.foreign_requests[-DETECTIONS_TO_BLOCK:])
            >= DETECTIONS_TO_BLOCK
        )
        doubles = (
            sum(self.now - at <= DUPLICATE_LATCH_S for at in self.duplicate_replies[-DETECTIONS_TO_BLOCK:])
            >= DETECTIONS_TO_BLOCK
        )
        return ("no foreign master",) * strangers + ("no duplicate",) * doubles

    def possible_events(self, slots: int, rare: bool) -> list[str]:
        found = [one for one in super().possible_events(slots, False) if one not in EVENTS_OF_OTHER_SEARCH]
        flight = self.core.transaction
        if flight is None and self.core.is_open and OUR_ADDRESS in self.core.stations:
            found.append("stranger")
        elif flight is not None and flight.prepared.token == "read" and "reply" in found:
            found.append("double")
        found += ["command"] * (OUR_ADDRESS in self.core.stations and not self.permits)
        return found + ["peace"] * bool(self.foreign_requests or self.duplicate_replies)

    def apply(self, event: str) -> Self:
        if event not in ("stranger", "double", "peace", "command"):
            return super().apply(event)
        self.subject.command_word = self.shadow
        if event == "command":
            self._command()
        elif event == "peace":
            self.now += FOREIGN_MASTER_LATCH_S + 1.0 if self.foreign_requests else DUPLICATE_LATCH_S + 1.0
            self.foreign_requests = ()
            self.duplicate_replies = tuple(at for at in self.duplicate_replies if self.now - at <= DUPLICATE_LATCH_S)
        else:
            self._receive(event)
        self.shadow = self.subject.command_word
        return self

    def _command(self) -> None:
        """Wished for, asked for and submitted at once, with everything in order but for the line."""
        self._make_command("")
        assert self.command is not None
        shown = PermissiveInputs(state=all_permissives_met(self.subject).state, foreign=None, duplicate=None)
        seen, lacks = gate_question.bus_snapshot(self.core, self.now), self.missing_on_wire()
        if gate_question.request_permit(self.subject, self.command, 0, seen, shown) is not None:
            self.grant(0, shown, lacks)._submit("")
        elif lacks:
            self.events.denied.append(lacks)
        else:
            self.events.findings.append("refused with everything in order")
        self.command = self.model_command = self.held_permit = None

    def _receive(self, event: str) -> None:
        """Bytes, the silence after them, and the bus's chance to look at them."""
        flight = self.core.transaction
        if flight is not None:
            data = 2 * normal_reply(flight.prepared.request, flight.prepared.codec)
        else:
            data = self.subject.other.codec.encode_request(self.subject.other.echo_test_read())
        self._perform(self._own_core().on_data(data, self.now))
        for _ in range(SILENCE_GRID_TICKS):
            self.now += self.subject.grid.tick_s
            self._perform(self._own_core().on_timer(self.now))
            if not self.core.unsolicited.buffer:
                break
        if event == "double":
            self.duplicate_replies = (*self.duplicate_replies[-1:], self.now)
        else:
            self.foreign_requests = (*self.foreign_requests[-1:], self.now)
