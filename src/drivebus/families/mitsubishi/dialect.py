"""Dialect of the Mitsubishi family.

A reply does not name its request, so a sync probe differs from the requests before it in the number of digits of its
reply, and the bus waits out a late reply where it does not. Parameters are not read: their instruction codes depend
on a page that another master or an earlier request may have selected (HFF).
"""

from __future__ import annotations

from typing import Any

from drivebus import i18n
from drivebus.bus.messages import RetryPolicy
from drivebus.drives.dialects.base import (
    UNNAMED_FAULT_CODE,
    CommandFrame,
    Dialect,
    Rejection,
    StopMode,
    shortest_period_s,
    signal_reading,
    signals_by_index,
)
from drivebus.drives.readings import ReadingPairs, Readings
from drivebus.drives.state import DerivedState, Direction, DriveState
from drivebus.errors import CapabilityError
from drivebus.families.mitsubishi.codec import (
    OUTPUT_FREQUENCY,
    RUN_COMMAND,
    RUN_FORWARD,
    RUN_REVERSE,
    SET_FREQUENCY,
    STATUS,
    STOP,
    MitsubishiCodec,
    MitsubishiReply,
    MitsubishiRequest,
    frame_effect,
)
from drivebus.profiles.model import DriveProfile, Parameter
from drivebus.protocols.codec import Codec, Effect
from drivebus.serial_settings import StationTiming
from drivebus.values import Quality, Reading, missing_reading

FORWARD_BIT, REVERSE_BIT, FAULT_BIT = 0x02, 0x04, 0x80
"""Bits of the status (7AH). Bits 1 and 2 are fixed; the drive's Pr.190 to Pr.196 can give bit 7 another meaning."""
SYNC_CODES = (STATUS, OUTPUT_FREQUENCY)
"""Reads with replies of two and of four digits, in turn."""
ALLOWED_COMMANDS = frozenset({STOP, RUN_FORWARD, RUN_REVERSE})


class MitsubishiDialect(Dialect):
    """Dialect of one drive."""

    reports_run_state = True
    state_names: tuple[str, ...] = ("state", "output_frequency")
    start_includes_setpoint = False

    def __init__(
        self, profile: DriveProfile, address: int, encoding: str, options: dict[str, Any], timing: StationTiming
    ) -> None:
        super().__init__(profile, address, options)
        self.codec: Codec = MitsubishiCodec()
        self._signals = signals_by_index(profile, "monitor")
        self._sync_count = 0
        self.station_config = self._make_station_config(timing, frame_effect)

    def _bus_sync_request(self, n: int) -> MitsubishiRequest:
        return self._read(SYNC_CODES[n % len(SYNC_CODES)])

    def sync_request(self, avoid: Any = None) -> MitsubishiRequest:
        """Return a read with another number of digits than the last one, and than ``avoid``."""
        self._sync_count += 1
        request = self._bus_sync_request(self._sync_count)
        return self.sync_request() if request == avoid else request

    def is_valid_sync_reply(self, reply: MitsubishiReply) -> bool:
        return reply.error is None

    def needs_sync(self, request: Any) -> bool:
        return True

    def state_reads(self) -> tuple[Any, ...]:
        return self._read(STATUS), self._read(OUTPUT_FREQUENCY)

    def echo_test_read(self) -> Any:
        return self._read(STATUS)

    def setpoint_reads(self) -> tuple[Any, ...]:
        return ()

    def setpoint_matches(self, readings: ReadingPairs, word: int, frequency_hz: float) -> bool | None:
        return None

    def can_confirm_speed(self) -> bool:
        return True

    def polls(self, names: tuple[str, ...]) -> tuple[tuple[Any, float], ...]:
        signal_items = {self.profile.signals[name].locator[1] for name in names if name in self.profile.signals}
        codes = sorted(signal_items | {STATUS, OUTPUT_FREQUENCY})
        return tuple((self._read(code), shortest_period_s(self.profile, self._signals.get(code, ()))) for code in codes)

    def _read(self, code: int) -> MitsubishiRequest:
        return MitsubishiRequest(self.address, code)

    def decode_readings(self, request: Any, reply: MitsubishiReply, at: float | None) -> Readings:
        signals = self._signals.get(request.code, [])
        if reply.error is not None:
            return {signal.name: missing_reading("drives.read_refused", signal.unit) for signal in signals}
        readings = {signal.name: signal_reading(signal, reply.data, at) for signal in signals}
        if request.code == STATUS:
            readings["state"] = Reading(
                value=reply.data, unit="", quality=Quality.GOOD, source_time=at, reason=None, raw=reply.data
            )
        return readings

    def derive_state(self, readings: ReadingPairs) -> DerivedState | None:
        """Return the state on which two reads agree; stopped only where no bit and no frequency shows motion."""
        states, output = readings.raw_pair("state"), readings.raw_pair("output_frequency")
        if states is None or output is None:
            return None
        older, newer = (_state_of(*pair) for pair in zip(states, output, strict=True))
        return newer if older.state is newer.state and older.direction is newer.direction else None

    def rejection(self, reply: MitsubishiReply) -> Rejection | None:
        if reply.error is None:
            return None
        key = f"mitsubishi.error_{reply.error:x}"
        return Rejection(key if key in i18n.catalogue("en") else "mitsubishi.error", reply.error)

    def start(self, direction: Direction | None, word: int) -> tuple[CommandFrame, ...]:
        command = RUN_REVERSE if direction is Direction.REVERSE else RUN_FORWARD
        return (CommandFrame(self._command(command), RetryPolicy.EDGE_TRIGGERED),)

    def set_frequency(self, word: int, readings: ReadingPairs) -> tuple[CommandFrame, ...]:
        return (CommandFrame(MitsubishiRequest(self.address, SET_FREQUENCY, word), RetryPolicy.IDEMPOTENT),)

    def stop(self, mode: StopMode) -> tuple[Any, ...]:
        if mode is not StopMode.STOP:
            raise CapabilityError("drives.cannot", model=self.profile.model, what=mode.value)
        return (self._command(STOP),)

    def _command(self, command: int) -> MitsubishiRequest:
        return MitsubishiRequest(self.address, RUN_COMMAND, command)

    def broadcast_stop(self) -> tuple[Any, ...]:
        return ()

    def read_parameter(self, parameter: Parameter) -> Any:
        return self._read(parameter.locator[1])

    def parameter_raw(self, reply: MitsubishiReply) -> int | None:
        return reply.data if reply.error is None else None

    def names_parameter(self, reply: MitsubishiReply) -> bool:
        return False

    def write_parameter(self, parameter: Parameter, raw: int, *, save: bool) -> CommandFrame:
        raise CapabilityError("drives.cannot", model=self.profile.model, what="write")

    def is_allowed(self, frame: bytes) -> bool:
        """Allow every canonical frame except a run command that no source explains."""
        if frame_effect(frame) in (Effect.NONE, Effect.SETTING):
            return True
        allowed = (self._command(command) for command in ALLOWED_COMMANDS)
        return frame in {self.codec.encode_request(request) for request in allowed}


def _state_of(status: int, output: int) -> DerivedState:
    direction = {FORWARD_BIT: Direction.FORWARD, REVERSE_BIT: Direction.REVERSE}.get(
        status & (FORWARD_BIT | REVERSE_BIT)
    )
    if status & FAULT_BIT:
        return DerivedState(DriveState.FAULT, direction, UNNAMED_FAULT_CODE)
    if status & (FORWARD_BIT | REVERSE_BIT) or output > 0:
        return DerivedState(DriveState.RUNNING, direction)
    return DerivedState(DriveState.STOPPED)
