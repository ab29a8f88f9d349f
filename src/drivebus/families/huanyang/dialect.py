"""Dialect of the Huanyang family.

The protocol reports frequencies and no run state: a drive whose output frequency is above 0 runs, one at 0 Hz is
stopped. Direction and faults are not reported.
"""

from __future__ import annotations

from typing import Any

from drivebus.bus.messages import RetryPolicy
from drivebus.drives.dialects.base import (
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
from drivebus.families.huanyang.codec import (
    BROADCAST,
    CONTROL,
    READ,
    RUN_FORWARD,
    RUN_REVERSE,
    STATUS,
    STOP,
    HuanyangCodec,
    HuanyangReply,
    HuanyangRequest,
    control,
    frame_effect,
    read_parameter,
    read_status,
    set_frequency,
    write_parameter,
)
from drivebus.profiles.model import DriveProfile, Parameter
from drivebus.protocols.codec import Codec, Effect
from drivebus.serial_settings import StationTiming
from drivebus.values import missing_reading

LONGEST_VALUE = 2
"""Bytes of a parameter's value."""
SET_FREQUENCY_ITEM, OUTPUT_FREQUENCY_ITEM = 0, 1
ALLOWED_COMMANDS = frozenset({RUN_FORWARD, RUN_REVERSE, STOP})


class HuanyangDialect(Dialect):
    """Dialect of one drive."""

    reports_run_state = True  # by its output frequency
    state_names: tuple[str, ...] = ("output_frequency",)
    start_includes_setpoint = False

    def __init__(
        self, profile: DriveProfile, address: int, encoding: str, options: dict[str, Any], timing: StationTiming
    ) -> None:
        super().__init__(profile, address, options)
        self.codec: Codec = HuanyangCodec()
        self._signals = signals_by_index(profile, "item")
        self._probes = sorted(
            parameter.locator[1]
            for parameter in profile.parameters.values()
            if parameter.locator[0] == "parameter" and self._width(parameter, 0) == LONGEST_VALUE
        )
        """Parameters of two bytes: the bus takes a reply that is shorter than the longest one for a rejection."""
        self._sync_count = 0
        self._last_read: HuanyangRequest | None = None
        self.station_config = self._make_station_config(timing, frame_effect)

    def _bus_sync_request(self, n: int) -> HuanyangRequest:
        """Return a read of the parameter at an even place of the probes: the reply names the parameter."""
        own = self._probes[::2]
        request = read_parameter(self.address, own[n % len(own)])
        return request if request != self._last_read else self._bus_sync_request(n + 1)

    def sync_request(self, avoid: Any = None) -> HuanyangRequest:
        """Return a read of a parameter that the bus does not use for its own sync probes."""
        own = self._probes[1::2]
        self._sync_count += 1
        request = read_parameter(self.address, own[self._sync_count % len(own)])
        return self.sync_request() if request == avoid else request

    def is_valid_sync_reply(self, reply: HuanyangReply) -> bool:
        return True

    def needs_sync(self, request: Any) -> bool:
        return False

    def state_reads(self) -> tuple[Any, ...]:
        return (read_status(self.address, OUTPUT_FREQUENCY_ITEM),)

    def echo_test_read(self) -> Any:
        return read_status(self.address, OUTPUT_FREQUENCY_ITEM)

    def setpoint_reads(self) -> tuple[Any, ...]:
        return (read_status(self.address, SET_FREQUENCY_ITEM),)

    def can_confirm_speed(self) -> bool:
        return True

    def polls(self, names: tuple[str, ...]) -> tuple[tuple[Any, float], ...]:
        signal_items = {self.profile.signals[name].locator[1] for name in names if name in self.profile.signals}
        items = sorted(signal_items | {OUTPUT_FREQUENCY_ITEM})
        return tuple(
            (read_status(self.address, item), shortest_period_s(self.profile, self._signals.get(item, ())))
            for item in items
        )

    def decode_readings(self, request: Any, reply: HuanyangReply, at: float | None) -> Readings:
        if request.function != STATUS:
            return {}
        signals = self._signals.get(request.index, [])
        if not reply.accepted:
            return {signal.name: missing_reading("drives.read_refused", signal.unit) for signal in signals}
        return {signal.name: signal_reading(signal, reply.value, at) for signal in signals}

    def derive_state(self, readings: ReadingPairs) -> DerivedState | None:
        """Return running where the last two output frequencies are above 0, stopped where both are 0."""
        output = readings.raw_pair("output_frequency")
        if output is None or (output[0] > 0) is not (output[1] > 0):
            return None
        return DerivedState(DriveState.RUNNING if output[1] > 0 else DriveState.STOPPED)

    def rejection(self, reply: HuanyangReply) -> Rejection | None:
        return None if reply.accepted else Rejection("huanyang.rejected", reply.index)

    def start(self, direction: Direction | None, word: int) -> tuple[CommandFrame, ...]:
        command = RUN_REVERSE if direction is Direction.REVERSE else RUN_FORWARD
        return (CommandFrame(control(self.address, command), RetryPolicy.EDGE_TRIGGERED),)

    def set_frequency(self, word: int, readings: ReadingPairs) -> tuple[CommandFrame, ...]:
        return (CommandFrame(set_frequency(self.address, word), RetryPolicy.IDEMPOTENT),)

    def stop(self, mode: StopMode) -> tuple[Any, ...]:
        if mode is not StopMode.STOP:
            raise CapabilityError("drives.cannot", model=self.profile.model, what=mode.value)
        return (control(self.address, STOP),)

    def broadcast_stop(self) -> tuple[Any, ...]:
        return (control(BROADCAST, STOP),)

    def read_parameter(self, parameter: Parameter) -> Any:
        space, index = parameter.locator
        return read_status(self.address, index) if space == "item" else read_parameter(self.address, index)

    def parameter_raw(self, reply: HuanyangReply) -> int | None:
        return reply.value if reply.accepted else None

    def names_parameter(self, reply: HuanyangReply) -> bool:
        return True

    def write_parameter(self, parameter: Parameter, raw: int, *, save: bool) -> CommandFrame:
        """Return a write of one byte where no value of the parameter needs two."""
        request = write_parameter(self.address, parameter.locator[1], raw, self._width(parameter, raw))
        return CommandFrame(request, RetryPolicy.EEPROM)

    def _width(self, parameter: Parameter, raw: int) -> int:
        if parameter.choices:
            return 1
        highest = raw if parameter.maximum is None else parameter.scale.raw(parameter.maximum)
        return 1 if highest < 0x100 else 2

    def is_allowed(self, frame: bytes) -> bool:
        """Allow every canonical frame except a control that no source explains."""
        if len(frame) > 3 and frame[1] == CONTROL:
            return frame[3] in ALLOWED_COMMANDS
        return frame_effect(frame) in (Effect.NONE, Effect.SETTING)

    def on_sent(self, request: Any) -> None:
        """Remember the last parameter read, so that the next sync probe of the bus differs from it."""
        if request.function == READ:
            self._last_read = request
