"""Oracle of a scenario: checks the bytes on the wire, the motors and the results that users get against I1 to I12.

It shares no code with the bus, the drives or the codecs: effects of frames come from ``reference.request_effects``,
times from ``drive_variants``.
"""

from __future__ import annotations

import gc
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf
from typing import Any

from drivebus import clock
from drivebus.values import Quality
from verification.campaign import CampaignRun
from verification.drive_variants import DriveVariant, character_s
from verification.reference.effects import RequestEffect
from verification.reference.request_effects import classify_request
from verification.scenario.rules import ClassifiedFrame, DriveHistory, FrameRules, WriteRules, check_outcome
from verification.scenario.user_command import UserCommand

MAX_REMEMBERED_FRAMES = 64
"""Number of remembered frames and deliveries; a reply refers to one of the last few."""


class Oracle:
    """Observer of one simulated bus; its violations go to the campaign run."""

    def __init__(
        self, campaign_run: CampaignRun, variant: DriveVariant, simulated_bus: Any, name: str, now: Callable[[], float]
    ) -> None:
        self.campaign_run, self.variant, self.simulated_bus, self.name, self.now = (
            campaign_run,
            variant,
            simulated_bus,
            name,
            now,
        )
        self.request_count = self.reply_count = self.accepted_count = self.command_count = 0
        self.open_commands: dict[int, list[UserCommand]] = {}
        """Commands in progress, by address."""
        self.frame_rules = FrameRules(variant, character_s(simulated_bus.settings), self.violation)
        self._write_rules = WriteRules(variant, self.violation)
        self._requests: deque[tuple[Any, ClassifiedFrame]] = deque(maxlen=MAX_REMEMBERED_FRAMES)
        self._replies: deque[tuple[Any, ClassifiedFrame | None]] = deque(maxlen=MAX_REMEMBERED_FRAMES)
        """Replies, each with the request that caused it."""
        self._deliveries: deque[tuple[float, Any]] = deque(maxlen=MAX_REMEMBERED_FRAMES)
        """Transmissions that reached a master, with their times."""
        self.last_delivery_at: dict[Any, float] = {}
        """Time of the last bytes of each drive, by address."""
        self._last_character_end = -inf
        """End of the last character that reached a master; collided characters are dropped."""
        self._current_request: ClassifiedFrame | None = None
        self._expected_frames: list[tuple[bytes, UserCommand]] = []
        """Frames of user commands in progress."""
        self.histories: dict[int, DriveHistory] = {}
        """History of each drive, by address."""
        self._observe_wire()

    # --- frames on the wire --------------------------------------------------------------------------------------

    def _observe_wire(self) -> None:
        simulated_bus = self.simulated_bus
        simulated_bus.now()  # the bench moves into this loop: its wire is a new one
        transmit, deliver, dispatch = (
            simulated_bus.wire.transmit,
            simulated_bus._deliver_to_masters,
            simulated_bus._dispatch,
        )

        def on_transmit(source: Any, data: bytes, *more: Any, **named: Any) -> Any:
            transmission = transmit(source, data, *more, **named)
            if hasattr(source, "receive"):
                self._on_request(transmission, data)
            else:
                self.reply_count += 1
                self._replies.append((transmission, self._current_request))
                self._trace(f"< {source.address} {data.hex()}", transmission.start)
            return transmission

        def on_deliver(transmission: Any, first: int, last: int) -> None:
            self._deliveries.append((self.now(), transmission))
            self.last_delivery_at[getattr(transmission.source, "address", None)] = self.now()
            received = [index for index in range(first, last) if index not in transmission.dropped]
            if received:
                self._last_character_end = max(
                    self._last_character_end, transmission.start + (received[-1] + 1) * transmission.character_s
                )
            deliver(transmission, first, last)

        def on_dispatch(frame: Any, stations: Any, transmission: Any, now: float) -> None:
            self._current_request = next(
                (known for sent, known in reversed(self._requests) if sent is transmission), None
            )
            dispatch(frame, stations, transmission, now)
            self._current_request = None

        simulated_bus.wire.transmit, simulated_bus._deliver_to_masters, simulated_bus._dispatch = (
            on_transmit,
            on_deliver,
            on_dispatch,
        )
        for station in simulated_bus.stations:
            self.observe_station(station)

    def observe_station(self, station: Any) -> None:
        """Observe the effect of each frame on this station, also for a station that joins later."""
        handle_frame, history = station.handle_frame, DriveHistory(station, self.now, self.trace)
        self.histories[station.address] = history

        def on_handle_frame(message: Any, codec: Any, settings: Any, now: float, **named: Any) -> Any:
            station.advance(now)
            before = _station_state(station)
            frames = station.frame_count
            transmission = handle_frame(message, codec, settings, now, **named)
            if self._current_request is not None and station.frame_count > frames:
                history.on_frame(self._current_request)
            if _station_state(station) != before and self._current_request is not None:
                self._on_state_change(station, self._current_request, was_on=bool(before[0]))
            return transmission

        station.handle_frame = on_handle_frame

    def _on_request(self, transmission: Any, data: bytes) -> None:
        self.request_count += 1
        try:
            address, effect = classify_request(self.variant.model, self.variant.encoding, data)
        except (ValueError, IndexError) as error:
            self.violation(f"I7 no manual knows the request {data.hex(' ')}: {error}")
            return
        frame = ClassifiedFrame(transmission.start, transmission.end, address, effect, self._command_of(data, effect))
        self._trace(f"> {address} {effect} {data.hex()}", transmission.start)
        last_end = self._requests[-1][1].end if self._requests else 0.0
        answered = any(
            last_end < delivered.end <= transmission.start + 1e-9 for _, delivered in reversed(self._deliveries)
        )
        if effect is not RequestEffect.READ and address not in self.histories:
            self.campaign_run.count("acting frames to absent drives")
        if effect is not RequestEffect.READ:
            self._write_rules.on_write(frame, data, clock.wall_clock().date())
        self.frame_rules.on_request(frame, self._last_character_end, answered=answered)
        self._requests.append((transmission, frame))

    def _on_state_change(self, station: Any, frame: ClassifiedFrame, *, was_on: bool) -> None:
        """Check a frame that changed the state of a station (I2, I11)."""
        started = station.motor.energised and not was_on
        if frame.effect is RequestEffect.READ or (frame.effect is RequestEffect.STOP and started):
            self.violation(f"I11 a {frame.effect} changed station {station.address}")
        if not started:
            return
        self.trace(f"motor {station.address} on")
        history, command = self.histories[station.address], frame.user_command
        stopped_unobserved = history.stopped_unobserved
        history.on_motor_started(command)
        if command is None:
            return
        command.executions += 1
        if command.executions > 1 and not stopped_unobserved:
            self.violation(f"I2 {command} switched the motor on {command.executions} times")
        elif command.executions > 1:
            self.campaign_run.count("sent again after an unobserved local stop")

    @contextmanager
    def expecting_frame(self, command: UserCommand, data: bytes) -> Iterator[None]:
        """Assign frames of these bytes to a command within this context."""
        entry = data, command
        self._expected_frames.append(entry)
        try:
            yield
        finally:
            self._expected_frames.remove(entry)

    def _command_of(self, data: bytes, effect: RequestEffect) -> UserCommand | None:
        """Return the command that this frame belongs to; stops need none."""
        if effect in (RequestEffect.READ, RequestEffect.STOP, RequestEffect.RELEASE):
            return None
        command = next((command for expected, command in self._expected_frames if expected == data), None)
        if command is not None:
            command.frames_sent += 1
        return command

    # --- user commands ----------------------------------------------------------------------------

    def on_command(self, address: int, what: str, arguments: tuple[Any, ...]) -> UserCommand:
        """Record a command that a user gives now."""
        self.command_count += 1
        command = UserCommand(
            number=self.command_count,
            address=address,
            method=what,
            arguments=arguments,
            at=self.now(),
            day=clock.wall_clock().date(),
        )
        self.open_commands.setdefault(address, []).append(command)
        if address in self.histories:
            self.histories[address].on_command(command)
        self.trace(f"* {command}")
        if command.is_stop:
            self.frame_rules.on_stop_command(command, port_open=bool(self.simulated_bus.masters))
        return command

    def on_command_ended(self, command: UserCommand) -> None:
        """Check the result that the user got against the drive's history."""
        command.ended_at = self.now()
        self.open_commands[command.address].remove(command)
        self.campaign_run.count(f"{command.method}: {command.result_word}")
        self.trace(f"= {command} {command.result_word}")
        self.simulated_bus.advance()
        history = self.histories.get(command.address)
        if history is None and command.succeeded:
            self.violation(f"absent drive: {command} ended as {command.result_word}")
        elif history is not None:
            check_outcome(command, history, reports_running=self.variant.reports_running, violation=self.violation)

    def on_reply_accepted(self, answer: Any) -> None:
        """Check that an accepted reply is the station's reply to this request (I5)."""
        if answer.error is not None or answer.reply is None:
            return
        self.accepted_count += 1
        for transmission, cause in reversed(self._replies):
            if (
                cause is not None
                and cause.start == answer.sent_at
                and (answer.received_at, transmission) in self._deliveries
            ):
                return
        self.violation(f"I5 {answer.received.hex()} was taken for the answer to {answer.sent.hex()}")

    def on_unplugged(self) -> None:
        """Record that the adapter is unplugged."""
        self.frame_rules.on_port_lost(self.now())
        self.trace("unplugged")

    # --- trace ---------------------------------------------------------------------------------------------------

    def trace(self, text: str) -> None:
        """Add a line to the trace with the current time."""
        self._trace(text, self.now())

    def _trace(self, text: str, at: float) -> None:
        self.campaign_run.trace(f"{at:.6f} {self.name} {text}")

    def violation(self, text: str) -> None:
        """Report a violation with seed, time and scenario."""
        self.campaign_run.violation(f"seed {self.campaign_run.seed}, {self.now():.6f} s, {self.name}: {text}")


def _station_state(station: Any) -> tuple[object, ...]:
    motor, memory = station.motor, station.memory
    return (
        motor.energised,
        motor.target_hz,
        station.setpoint_hz,
        memory.ram_writes.total(),
        memory.eeprom_writes.total(),
    )


# --- readings and memory ----------------------------------------------------------------------------------------------

LONGEST_REPLY_TIMEOUT_S = 0.4
"""Longest reply timeout of any model at the campaigns' baud rates, in seconds."""
MAX_RETAINED = {"frames are remembered": 300, "entries are kept in one place": 600}
"""Limits of I12 for a bus of 31 drives."""
MAX_ALIVE = {"tasks": 400, "queued requests": 400, "events on the wire": 4000}
"""Limits of I12 for up to 31 drives under load."""


def check_invariants(scenario: Any) -> None:
    """Check I4, I8 and I12 of a ``Scenario`` at the current time."""
    violation = scenario.oracle.violation
    for failed in scenario.loop.failed:
        violation(f"I8 {failed.get('message')}: {failed.get('exception')!r}")
    scenario.loop.failed.clear()
    for address, monitor in scenario.monitors.items():
        check_ages(scenario, address, monitor)
    sizes = (len(scenario.loop.tasks), len(scenario.bus.core.scheduler), len(scenario.simulated_bus.wire._events))
    for (what, most), size in zip(MAX_ALIVE.items(), sizes, strict=True):
        if size > most:
            violation(f"I12 {size} {what}")


def check_ages(scenario: Any, address: int, monitor: Any) -> None:
    """Check that no reading older than max(3 × period, 1 s) + timeout is good (I4).

    The age is that of the reading's time, and at least the time since the drive's last bytes on the wire.
    """
    now, signals = scenario.loop.time(), scenario.drives[address].profile.signals
    silent_s = now - scenario.oracle.last_delivery_at.get(address, -inf)
    for name, reading in monitor.status().readings.items():
        if reading.quality is Quality.GOOD:
            age = inf if reading.source_time is None else max(now - reading.source_time, silent_s)
            if age > max(3 * signals[name].period_s, 3 * scenario.period_s, 1.0) + LONGEST_REPLY_TIMEOUT_S:
                scenario.oracle.violation(f"I4 {name} of {address} is called good at an age of {age} s")


def check_memory(scenario: Any) -> None:
    """Check how many objects the bus retains (I12)."""
    for (what, most), size in zip(MAX_RETAINED.items(), count_retained_objects(scenario.bus.core), strict=True):
        if size > most:
            scenario.oracle.violation(f"I12 {size} {what}")


def count_retained_objects(core: object) -> tuple[int, int]:
    """Return the number of prepared requests reachable from the bus, and the length of the longest container."""
    visited, waiting, prepared, longest = {id(core)}, [core], 0, 0
    while waiting:
        for referent in gc.get_referents(waiting.pop()):
            kind = type(referent)
            if id(referent) not in visited and (kind in _CONTAINERS or kind.__module__.startswith("drivebus.bus")):
                visited.add(id(referent))
                waiting.append(referent)
                prepared += kind.__name__.startswith("Prepared")
                longest = max(longest, len(referent) if kind in _CONTAINERS else 0)
    return prepared, longest


_CONTAINERS = frozenset({list, tuple, dict, set, deque})
