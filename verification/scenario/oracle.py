"""The observer of a stand: sees the bytes on the copper, the motors and what users were told, and nothing else.

It shares no code with the bus, the drives or the codecs: what a frame does it reads with ``manual``, times it knows
from ``kinds``. Every event is held against the invariants I1 to I12, here and in ``conduct``, ``writes`` and
``truth``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf
from typing import Any

from drivebus import clock
from drivebus.bus.messages import BusResult
from verification.campaign import CampaignRun
from verification.drive_variants import DriveVariant
from verification.reference.request_effects import RequestEffect, classify_request
from verification.scenario.drive_history import DriveHistory
from verification.scenario.frame_rules import ClassifiedFrame, FrameRules
from verification.scenario.outcome_rules import check_outcome
from verification.scenario.user_command import UserCommand
from verification.scenario.write_rules import WriteRules
from verification.timing_bounds import character_s

MAX_REMEMBERED_FRAMES = 64
"""So many frames and deliveries are remembered: an answer refers to one of the last few."""


class Oracle:
    """Watches one bench. Everything that it finds goes to the session."""

    def __init__(
        self, session: CampaignRun, kind: DriveVariant, bench: Any, name: str, now: Callable[[], float]
    ) -> None:
        self.session, self.kind, self.bench, self.name, self.now = session, kind, bench, name, now
        self.request_count = self.reply_count = self.accepted_count = self.command_count = 0
        self.open_commands: dict[int, list[UserCommand]] = {}
        """Open wishes by address."""
        self.frame_rules = FrameRules(kind, character_s(bench.settings), self.violation)
        self._write_rules = WriteRules(kind, self.violation)
        self._requests: deque[tuple[Any, ClassifiedFrame]] = deque(maxlen=MAX_REMEMBERED_FRAMES)
        self._replies: deque[tuple[Any, ClassifiedFrame | None]] = deque(maxlen=MAX_REMEMBERED_FRAMES)
        """Replies, with the request that caused each."""
        self._deliveries: deque[tuple[float, Any]] = deque(maxlen=MAX_REMEMBERED_FRAMES)
        """What reached a host, and when."""
        self.last_delivery_at: dict[Any, float] = {}
        """When each drive was last heard at all."""
        self._last_character_end = -inf
        """The end of the last character that reached a host: what collided with an earlier one is swallowed."""
        self._current_request: ClassifiedFrame | None = None
        self._expected_frames: list[tuple[bytes, UserCommand]] = []
        """Frames that users' commands wait for."""
        self.histories: dict[int, DriveHistory] = {}
        """What became of each drive, by address."""
        self._observe_wire()

    # --- the tap on the copper -----------------------------------------------------------------------------------

    def _observe_wire(self) -> None:
        bench = self.bench
        bench.now()  # the bench moves into this loop: its wire is a new one
        say, to_hosts, dispatch = bench.wire.transmit, bench._deliver_to_masters, bench._dispatch

        def on_say(talker: Any, data: bytes, *more: Any, **named: Any) -> Any:
            text = say(talker, data, *more, **named)
            if hasattr(talker, "receive"):
                self._on_request(text, data)
            else:
                self.reply_count += 1
                self._replies.append((text, self._current_request))
                self._trace(f"< {talker.address} {data.hex()}", text.start)
            return text

        def on_to_hosts(text: Any, first: int, last: int) -> None:
            self._deliveries.append((self.now(), text))
            self.last_delivery_at[getattr(text.source, "address", None)] = self.now()
            kept = [index for index in range(first, last) if index not in text.dropped]
            if kept:
                self._last_character_end = max(self._last_character_end, text.start + (kept[-1] + 1) * text.character_s)
            to_hosts(text, first, last)

        def on_dispatch(frame: Any, stations: Any, text: Any, now: float) -> None:
            self._current_request = next((known for one, known in reversed(self._requests) if one is text), None)
            dispatch(frame, stations, text, now)
            self._current_request = None

        bench.wire.transmit, bench._deliver_to_masters, bench._dispatch = on_say, on_to_hosts, on_dispatch
        for station in bench.stations:
            self.observe_station(station)

    def observe_station(self, station: Any) -> None:
        """See what each frame does to the motor of this station (for one that joins later)."""
        received, deeds = station.handle_frame, DriveHistory(station, self.now, self.trace)
        self.histories[station.address] = deeds

        def on_heard(message: Any, codec: Any, line: Any, now: float, **named: Any) -> Any:
            station.advance(now)
            before = _station_state(station)
            frames = station.frame_count
            text = received(message, codec, line, now, **named)
            if self._current_request is not None and station.frame_count > frames:
                deeds.on_frame(self._current_request)
            if _station_state(station) != before and self._current_request is not None:
                self._on_state_change(station, self._current_request, was_on=bool(before[0]))
            return text

        station.handle_frame = on_heard

    def _on_request(self, said: Any, data: bytes) -> None:
        self.request_count += 1
        try:
            address, does = classify_request(self.kind.model, self.kind.encoding, data)
        except (ValueError, IndexError) as error:
            self.violation(f"I7 no manual knows the request {data.hex(' ')}: {error}")
            return
        frame = ClassifiedFrame(said.start, said.end, address, does, self._command_of(data, does))
        self._trace(f"> {address} {does} {data.hex()}", said.start)
        last_end = self._requests[-1][1].end if self._requests else 0.0
        answered = any(last_end < one.end <= said.start + 1e-9 for _, one in reversed(self._deliveries))
        if does is not RequestEffect.READ and address not in self.histories:
            self.session.count("acting frames to drives that are not there (G19)")
        if does is not RequestEffect.READ:
            self._write_rules.on_write(frame, data, clock.wall_clock().date())
        self.frame_rules.on_request(frame, self._last_character_end, answered)
        self._requests.append((said, frame))

    def _on_state_change(self, station: Any, frame: ClassifiedFrame, was_on: bool) -> None:
        """I2, I11: a frame changed something in this station."""
        started = station.motor.energised and not was_on
        if frame.effect is RequestEffect.READ or (frame.effect is RequestEffect.STOP and started):
            self.violation(f"I11 a {frame.effect} changed station {station.address}")
        if not started:
            return
        self.trace(f"motor {station.address} on")
        deeds, command = self.histories[station.address], frame.user_command
        stood_unseen = deeds.stopped_unobserved
        deeds.on_motor_started(command)
        if command is None:
            return
        command.executions += 1
        if command.executions > 1 and not stood_unseen:
            self.violation(f"I2 {command} switched the motor on {command.executions} times")
        elif command.executions > 1:
            self.session.count("resent after a person at the drive had stopped it unseen (ruling 6)")

    @contextmanager
    def expecting_frame(self, wish: UserCommand, data: bytes) -> Iterator[None]:
        """While this lasts, a frame of these bytes is this wish's."""
        entry = data, wish
        self._expected_frames.append(entry)
        try:
            yield
        finally:
            self._expected_frames.remove(entry)

    def _command_of(self, data: bytes, does: RequestEffect) -> UserCommand | None:
        """The wish that this frame serves; stops and what follows them need none."""
        if does in (RequestEffect.READ, RequestEffect.STOP, RequestEffect.RELEASE):
            return None
        command = next((command for asked, command in self._expected_frames if asked == data), None)
        if command is not None:
            command.frames_sent += 1
        return command

    # --- what users wish and are told ----------------------------------------------------------------------------

    def on_command(self, address: int, what: str, arguments: tuple[Any, ...]) -> UserCommand:
        """A user gives a command now."""
        self.command_count += 1
        command = UserCommand(self.command_count, address, what, arguments, self.now(), clock.wall_clock().date())
        self.open_commands.setdefault(address, []).append(command)
        if address in self.histories:
            self.histories[address].on_command(command)
        self.trace(f"* {command}")
        if command.is_stop:
            self.frame_rules.on_stop_command(command, bool(self.bench.masters))
        return command

    def on_command_ended(self, command: UserCommand) -> None:
        """Check the result that the user got against what happened."""
        command.ended_at = self.now()
        self.open_commands[command.address].remove(command)
        self.session.count(f"{command.method}: {command.result_word}")
        self.trace(f"= {command} {command.result_word}")
        self.bench.advance()
        deeds = self.histories.get(command.address)
        if deeds is None and command.result_word in ("confirmed", "acknowledged"):
            self.violation(f"G19 {command}: {command.result_word}, and there is no such drive")
        elif deeds is not None:
            check_outcome(command, deeds, self.kind.reports_running, self.violation)

    def on_reply_accepted(self, answer: BusResult) -> None:
        """I5: an accepted reply is the one that the station gave to this very request."""
        if answer.error is not None or answer.reply is None:
            return
        self.accepted_count += 1
        for text, cause in reversed(self._replies):
            if cause is not None and cause.start == answer.sent_at and (answer.received_at, text) in self._deliveries:
                return
        self.violation(f"I5 {answer.received.hex()} was taken for the answer to {answer.sent.hex()}")

    def on_unplugged(self) -> None:
        """The adapter is pulled now."""
        self.frame_rules.on_port_lost(self.now())
        self.trace("unplugged")

    # --- telling -------------------------------------------------------------------------------------------------

    def trace(self, text: str) -> None:
        """One line of the trace, now."""
        self._trace(text, self.now())

    def _trace(self, text: str, at: float) -> None:
        self.session.trace(f"{at:.6f} {self.name} {text}")

    def violation(self, text: str) -> None:
        """Of this line, at this moment."""
        self.session.violation(f"seed {self.session.seed}, {self.now():.6f} s, {self.name}: {text}")


def _station_state(station: Any) -> tuple[object, ...]:
    motor, memory = station.motor, station.memory
    return (
        motor.energised,
        motor.target_hz,
        station.setpoint_hz,
        memory.ram_writes.total(),
        memory.eeprom_writes.total(),
    )
