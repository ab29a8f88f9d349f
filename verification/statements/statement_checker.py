"""Checks of sentences: what the product states of a drive is compared with what the fake drive did and reported.

A sentence is identified by its key and parameters; rules on words ("no reply", "nothing was sent") hold for the English
text of every key, so that a changed sentence is checked by what it then says.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any

from drivebus import i18n
from verification.statements.fake_line import Exchange, FakeLine
from verification.statements.reaction import Report

OUTPUT_OFF = ("stopped", "fault")
REPORT_TOLERANCE_HZ = 0.011  # one step of 0.01 Hz, and the rounding of its binary fraction
LATE_TOLERANCE_MS = 2  # rounding of the lateness in the sentence
ACTING_EFFECTS = ("set", "start", "stop", "reset", "level")
STOPPING_EFFECTS = ("stop", "level")
"""Effects of a stop that is still being repeated while another command is refused."""
SILENCE = re.compile(r"no reply(?! code| within)|not reply|stopped replying")
LINE_CONTEXT_S = 6.0
"""Time before a command from which a reply may still be late, so that an error may name it."""


@dataclass(slots=True, kw_only=True)
class Statement:
    """Sentence of the product about a command that was given at ``began_at`` and ended at ``ended_at``."""

    command: str
    status: str
    key: str
    params: Mapping[str, Any]
    began_at: float
    ended_at: float
    direction: str = "forward"

    @property
    def text(self) -> str:
        return i18n.text(self.key, "en", **self.params)


class StatementChecker:
    """Checks of the statements about one drive."""

    def __init__(self, line: FakeLine, *, reports_state: bool) -> None:
        self.line, self.reports_state = line, reports_state

    def contradictions(self, statement: Statement) -> Iterator[str]:
        """Yield what the fake drive contradicts."""
        exchanges = [e for e in self.line.exchanges if statement.began_at - 1e-9 <= e.at <= statement.ended_at]
        recent = [e for e in self.line.exchanges if statement.began_at - LINE_CONTEXT_S <= e.at <= statement.ended_at]
        yield from self._wording_contradictions(statement, exchanges, recent)
        yield from self._report_contradictions(statement, exchanges)
        yield from self._effect_contradictions(statement, exchanges)
        yield from self._line_contradictions(statement, recent)

    # --- words of the sentence ----------------------------------------------------------------------------------------

    def _wording_contradictions(
        self, statement: Statement, exchanges: list[Exchange], recent: list[Exchange]
    ) -> Iterator[str]:
        text, acting = (
            statement.text,
            [e for e in exchanges if e.reaction is not None and e.reaction.effect in ACTING_EFFECTS],
        )
        if "nothing was sent that moves" in text or "start was not sent" in text or "no start was sent" in text:
            if any(e.reaction is not None and e.reaction.effect == "start" for e in exchanges):
                yield "a start was sent"
        elif self._claims_nothing_sent(statement) and any(
            e.reaction is not None and e.reaction.effect not in STOPPING_EFFECTS for e in acting
        ):
            yield "acting frames were sent"
        if SILENCE.search(text) and "no valid reply" not in text and not any(self._is_unanswered(e) for e in recent):
            yield "every request was followed by bytes of the drive"
        if ("no valid reply" in text or "no usable reply" in text) and not any(self._is_unsuitable(e) for e in recent):
            yield "every request got a valid reply"
        if "rejected" in text and not any(e.reaction is not None and e.reaction.rejected for e in recent):
            yield "the drive rejected nothing"
        if (
            "unknown whether" not in text
            and ("the drive acknowledged" in text or "the drive accepted" in text or "was accepted" in text)
            and not any(self._is_accepted(e, statement) for e in acting)
        ):
            yield "no acting frame got a positive reply"

    @staticmethod
    def _claims_nothing_sent(statement: Statement) -> bool:
        """Return whether a sentence is about the whole command; one of the bus is about its last frame."""
        about_command = statement.command != "write" and not statement.key.startswith("bus.")
        return about_command and ("nothing was sent" in statement.text or "was not sent" in statement.text)

    def _is_unanswered(self, exchange: Exchange) -> bool:
        """Return whether no byte of the drive followed until the next request."""
        later = [e.at for e in self.line.exchanges if e.at > exchange.at]
        end = min(later, default=float("inf"))
        return not any(exchange.at < at <= end for at, _ in self.line.deliveries)

    def _is_unsuitable(self, exchange: Exchange) -> bool:
        rejected = exchange.reaction is not None and exchange.reaction.rejected
        return not exchange.is_clean or rejected or exchange.reply == exchange.request or self.line.plan.echoes

    # --- what the drive reported --------------------------------------------------------------------------------------

    def _report_contradictions(self, statement: Statement, exchanges: list[Exchange]) -> Iterator[str]:
        reports = [e.reaction.reports for e in exchanges if e.reaction is not None and e.reply]
        state = statement.params.get("state")
        if state is not None and self.reports_state and str(state) != "unknown":
            yield from self._state_contradictions(statement, str(state.value), reports)
        for name in ("output_hz", "found_hz"):
            value = statement.params.get(name)
            if value is not None and not self._was_reported_hz(float(value), statement.key, reports):
                yield f"{name} {value} was never reported"
        found = statement.params.get("found")
        if (
            found is not None
            and statement.key == "drives.wrong_direction"
            and str(found.value) not in {r.direction for r in reports}
        ):
            yield f"direction {found} was never reported"
        if statement.key == "drives.setpoint_confirmed" and statement.status == "confirmed":
            commanded_hz = float(statement.params["frequency_hz"])
            if not any(
                r.setpoint_hz is not None and abs(r.setpoint_hz - commanded_hz) <= REPORT_TOLERANCE_HZ for r in reports
            ):
                yield f"a set frequency of {commanded_hz} was never reported"

    def _state_contradictions(self, statement: Statement, state: str, reports: list[Report]) -> Iterator[str]:
        states = [r.state for r in reports if r.state is not None]
        if state not in states:
            yield f"state {state} was never reported, only {sorted(set(states))}"
        elif statement.status == "confirmed" and states.count(state) < 2:
            yield f"state {state} was reported only once"

    @staticmethod
    def _was_reported_hz(value: float, key: str, reports: list[Report]) -> bool:
        setpoint = key.startswith("drives.setpoint")
        values = (r.setpoint_hz if setpoint else r.hz for r in reports)
        return any(reported is not None and abs(reported - value) <= REPORT_TOLERANCE_HZ for reported in values)

    # --- what the drive did -------------------------------------------------------------------------------------------

    def _effect_contradictions(self, statement: Statement, exchanges: list[Exchange]) -> Iterator[str]:
        physics = self.line.physics
        if statement.key == "drives.no_fault" and str(statement.params["state"]) == "unknown" and self.reports_state:
            yield "an unknown state is no report of no fault"
        if statement.status == "confirmed":
            if statement.key in ("drives.stop_confirmed", "drives.output_off") and physics.is_on:
                yield f"the output is on, at {physics.hz} Hz"
            if statement.key == "drives.stop_confirmed_by_frequency" and physics.hz:
                yield f"the output is at {physics.hz} Hz"
            if statement.key in ("drives.start_confirmed", "drives.running_at") and not physics.was_on:
                yield "the output was never on"
            if statement.key in ("drives.start_confirmed", "drives.running_at"):
                directions = {e.reaction.reports.direction for e in exchanges[-4:] if e.reaction is not None} - {None}
                if directions and statement.direction not in directions:
                    yield f"the drive reports {directions}, commanded {statement.direction}"
            if statement.key == "drives.reset_confirmed" and physics.fault:
                yield f"fault {physics.fault} is present"
            if statement.key == "drives.no_fault" and physics.fault:
                yield f"fault {physics.fault} is present"
        if statement.status == "acknowledged" and not any(
            e.reaction is not None and e.reaction.effect in ACTING_EFFECTS for e in exchanges
        ):
            yield "the drive executed no frame of it"

    def write_contradictions(self, statement: Statement, memory_key: int, raw: int) -> Iterator[str]:
        """Yield what contradicts the outcome of a write of ``raw`` to this key of the memory."""
        stored = self.line.physics.memory.get(memory_key, 0)
        if statement.key in ("drives.write_confirmed", "drives.write_skipped") and stored != raw:
            yield f"the drive holds {stored}, not {raw}"
        if statement.key == "drives.write_differs" and stored == raw:
            yield f"the drive holds {raw}"

    # --- bytes on the line --------------------------------------------------------------------------------------------

    def _line_contradictions(self, statement: Statement, recent: list[Exchange]) -> Iterator[str]:
        params = statement.params
        match statement.key:
            case "bus.no_reply" | "bus.no_reply_to_next":
                window_s = params["milliseconds"] / 1000
                times = [at for at, _ in self.line.deliveries]
                if not any(not any(e.at < at < e.at + window_s - 0.001 for at in times) for e in recent):
                    yield "bytes followed each request in that time"
                if params["attempt"] > len(recent):
                    yield f"only {len(recent)} requests"
                if "since_ms" in params and not self._replied_before(params["since_ms"], recent):
                    yield f"no request came {params['since_ms']} ms after a reply"
            case "drives.stop_unusable_replies":
                if not any(isfinite(e.reply_at) for e in recent):
                    yield "nothing was received"
            case "bus.truncated":
                if not any(e.line_fault in ("cut", "damaged", "late", "before", "doubled", "foreign") for e in recent):
                    yield "no reply was cut"
            case "bus.stray_before":
                strays = {e.stray.hex(" ").upper() for e in recent if e.line_fault == "before"}
                if params["bytes"] not in strays and not self._is_tail(params["bytes"], recent):
                    yield f"the stray bytes were {sorted(strays)}"
            case "bus.trailing":
                if not any(e.line_fault in ("after", "doubled", "before", "late") for e in recent):
                    yield "nothing followed a reply"
            case "bus.second_reply":
                if not any(e.line_fault == "doubled" for e in recent) and not self._is_repeated(recent):
                    yield "no reply was received twice"
            case "bus.late_reply":
                late_ms = [(e.reply_at - e.at) * 1000 for e in recent if isfinite(e.reply_at)]
                if not any(delay_ms >= params["milliseconds"] - LATE_TOLERANCE_MS for delay_ms in late_ms):
                    yield f"replies came after {late_ms} ms"
            case "bus.other_station_replied":
                foreign = any(e.line_fault in ("foreign", "damaged") for e in recent)
                if not foreign or (params["found"] != self.line.address + 1 and "damaged" not in _faults(recent)):
                    yield "no such address replied"
            case "bus.own_echo" | "bus.only_own_frame":
                received = [e.reply for e in recent] + ([e.request for e in recent] if self.line.plan.echoes else [])
                if not any(e.request in received for e in recent):
                    yield "no reply equals its request"

    @staticmethod
    def _is_accepted(exchange: Exchange, statement: Statement) -> bool:
        """Return whether a whole positive reply was delivered before the statement, in its time or a little late."""
        whole = exchange.is_clean or (exchange.line_fault == "late" and exchange.reply_at <= statement.ended_at)
        return whole and exchange.reaction is not None and not exchange.reaction.rejected

    def _replied_before(self, milliseconds: int, recent: list[Exchange]) -> bool:
        """Return whether a request was sent so long after a reply of the drive."""
        begins = [e.at - len(e.request) * self.line.settings.character_s for e in recent]
        return any(
            abs((began - replied.reply_at) * 1000 - milliseconds) <= 1
            for began in begins
            for replied in self.line.exchanges
            if isfinite(replied.reply_at)
        )

    @staticmethod
    def _is_tail(text: str, recent: list[Exchange]) -> bool:
        """Return whether the bytes are the end of another reply, which came between."""
        data = bytes.fromhex(text)
        return any(e.reply.endswith(data) or e.stray.endswith(data) for e in recent)

    @staticmethod
    def _is_repeated(recent: list[Exchange]) -> bool:
        """Return whether two requests got the same reply, one of them late: then it looks like a second one."""
        return "late" in _faults(recent) or "cut" in _faults(recent)


def _faults(recent: list[Exchange]) -> set[str]:
    return {e.line_fault for e in recent}
