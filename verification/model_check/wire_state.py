"""Second part of the model check: foreign masters and duplicate addresses are detected from bytes by the real bus.

Removing and adding the station or losing and opening the port must not clear a detection.
"""

from __future__ import annotations

from collections import deque
from typing import Any, Self

from verification.model_check import permissive_inputs
from verification.model_check.gate_state import GateState
from verification.model_check.model_subject import OUR_ADDRESS, ModelSubject, normal_reply
from verification.model_check.permissive_inputs import PermissiveInputs, all_permissives_met

FOREIGN_MASTER_WINDOW_S, DUPLICATE_WINDOW_S = 60.0, 600.0
"""Seconds after which a foreign master and a duplicate address are no longer assumed."""
DETECTIONS_TO_BLOCK = 2
"""Detections that raise the alarm; a single one may be an error."""

EVENTS_OF_OTHER_SEARCH = frozenset({"raw", "inhibit", "release", "hang", "stop", "sleep", "create"})
"""Events of the first part."""

SILENCE_GRID_TICKS = 3
"""Ticks until the bus examines unsolicited bytes: it waits for a silent line."""


class WireState(GateState):
    """State in which another master or a second drive may be on the wire."""

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
        unanswered = (
            (max(0.0, station.last_request_sent_at - self.now), station.last_request_answered)
            if station is not None
            else None
        )
        received = (
            core.unsolicited.has_foreign_master(self.now),
            len(station.duplicate_reply_times) if station is not None else 0,
        )
        recently_suspect = self.now - station.suspect_since <= 5.0 if station is not None else False
        return (*super().state_key(), received, recently_suspect, unanswered, self.missing_on_wire())

    def _add(self, rest: str) -> None:
        super()._add(rest)
        self._forget_measurements()

    def _forget_measurements(self) -> None:
        """Remove the measured reply times, which all states share."""
        self.core.stations[OUR_ADDRESS].counters.reply_times_s = deque(maxlen=0)

    def missing_on_wire(self) -> tuple[str, ...]:
        """Return the conditions that the wire itself denies now."""
        foreign_master = (
            sum(self.now - at <= FOREIGN_MASTER_WINDOW_S for at in self.foreign_requests[-DETECTIONS_TO_BLOCK:])
            >= DETECTIONS_TO_BLOCK
        )
        duplicate = (
            sum(self.now - at <= DUPLICATE_WINDOW_S for at in self.duplicate_replies[-DETECTIONS_TO_BLOCK:])
            >= DETECTIONS_TO_BLOCK
        )
        return ("no foreign master",) * foreign_master + ("no duplicate",) * duplicate

    def possible_events(self, slots: int, *, rare: bool) -> list[str]:
        found = [event for event in super().possible_events(slots, rare=False) if event not in EVENTS_OF_OTHER_SEARCH]
        transaction = self.core.transaction
        if transaction is None and self.core.is_open and OUR_ADDRESS in self.core.stations:
            found.append("foreign")
        elif transaction is not None and transaction.prepared.token == "read" and "reply" in found:
            found.append("duplicate")
        found += ["command"] * (OUR_ADDRESS in self.core.stations and not self.permits)
        return found + ["quiet"] * bool(self.foreign_requests or self.duplicate_replies)

    def apply(self, event: str) -> Self:
        if event not in ("foreign", "duplicate", "quiet", "command"):
            return super().apply(event)
        self.subject.command_word = self.command_word
        if event == "command":
            self._command()
        elif event == "quiet":
            self.now += FOREIGN_MASTER_WINDOW_S + 1.0 if self.foreign_requests else DUPLICATE_WINDOW_S + 1.0
            self.foreign_requests = ()
            self.duplicate_replies = tuple(at for at in self.duplicate_replies if self.now - at <= DUPLICATE_WINDOW_S)
        else:
            self._receive(event)
        self.command_word = self.subject.command_word
        return self

    def _command(self) -> None:
        """Create, permit and submit a command with every input met except those of the wire."""
        self._make_command("")
        assert self.command is not None
        shown = PermissiveInputs(state=all_permissives_met(self.subject).state, foreign=None, duplicate=None)
        conditions, missing = permissive_inputs.bus_snapshot(self.core, self.now), self.missing_on_wire()
        if permissive_inputs.request_permit(self.subject, self.command, 0, conditions, shown) is not None:
            self.grant(0, shown, missing)._submit("")
        elif missing:
            self.events.denied.append(missing)
        else:
            self.events.findings.append("refused with everything in order")
        self.command = self.model_command = self.held_permit = None

    def _receive(self, event: str) -> None:
        """Receive bytes and let the bus examine them after the following silence."""
        transaction = self.core.transaction
        if transaction is not None:
            data = 2 * normal_reply(transaction.prepared.request, transaction.prepared.station.codec)
        else:
            data = self.subject.other.codec.encode_request(self.subject.other.echo_test_read())
        self._perform(self._own_core().on_data(data, self.now, 0))
        for _ in range(SILENCE_GRID_TICKS):
            self.now += self.subject.grid.tick_s
            self._perform(self._own_core().on_timer(self.now))
            if not self.core.unsolicited.buffer:
                break
        if event == "duplicate":
            self.duplicate_replies = (*self.duplicate_replies[-1:], self.now)
        else:
            self.foreign_requests = (*self.foreign_requests[-1:], self.now)
