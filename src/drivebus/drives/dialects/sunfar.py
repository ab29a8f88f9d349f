"""Dialect of the Sunfar family (C320 manual 2.3 and 2.4).

A reply does not name the class of its request, so a command is never confirmed by its own reply.
"""

from __future__ import annotations

from itertools import zip_longest
from typing import Any

from drivebus.bus.messages import RetryPolicy
from drivebus.drives.dialects.base import (
    CommandFrame,
    Dialect,
    Identity,
    Rejection,
    StopMode,
    decode_whole_request,
    shortest_period_s,
    signal_reading,
    signals_by_index,
    without_item_echo,
)
from drivebus.drives.readings import ReadingPairs, Readings
from drivebus.drives.state import DerivedState, Direction, DriveState
from drivebus.errors import CapabilityError, ConfigurationError
from drivebus.profiles.model import DriveProfile, Parameter
from drivebus.protocols.codec import Codec
from drivebus.protocols.sunfar import (
    VOLTAGE_CLASSES,
    MonitorIndexCoding,
    ReadIdentity,
    ReadMonitor,
    SunfarCodec,
    SunfarControl,
    SunfarOperation,
    SunfarReadParameter,
    SunfarReply,
    SunfarResponse,
    SunfarState,
    SunfarWriteParameter,
    frame_effect,
    monitor_index,
    monitor_item,
)
from drivebus.serial_settings import StationTiming
from drivebus.values import Quality, Reading, missing_reading

DRIVE_STATES: dict[int, tuple[DriveState, Direction | None]] = {
    SunfarState.NOT_READY: (DriveState.NOT_READY, None),
    SunfarState.RUNNING_FORWARD: (DriveState.RUNNING, Direction.FORWARD),
    SunfarState.RUNNING_REVERSE: (DriveState.RUNNING, Direction.REVERSE),
    SunfarState.STOPPED: (DriveState.STOPPED, None),
    SunfarState.JOGGING_FORWARD: (DriveState.JOGGING, Direction.FORWARD),
    SunfarState.JOGGING_REVERSE: (DriveState.JOGGING, Direction.REVERSE),
    SunfarState.ACCELERATING_FORWARD: (DriveState.ACCELERATING, Direction.FORWARD),
    SunfarState.ACCELERATING_REVERSE: (DriveState.ACCELERATING, Direction.REVERSE),
    SunfarState.RESTARTING: (DriveState.RESTARTING, None),
    SunfarState.DECELERATING_FORWARD: (DriveState.DECELERATING, Direction.FORWARD),
    SunfarState.DECELERATING_REVERSE: (DriveState.DECELERATING, Direction.REVERSE),
    SunfarState.DC_BRAKING: (DriveState.BRAKING, None),
    SunfarState.FAULT: (DriveState.FAULT, None),
    SunfarState.EMERGENCY_STOP: (DriveState.EMERGENCY_STOPPED, None),
}
"""Manual 2.4.6."""

STOP_OPERATIONS_BY_MODE = {
    StopMode.STOP: SunfarOperation.STOP,
    StopMode.QUICK_STOP: SunfarOperation.EMERGENCY_STOP,
    StopMode.JOG_STOP: SunfarOperation.JOG_STOP,
}


def sync_tags(profile: DriveProfile) -> list[tuple[int, int]]:
    """Return readable parameters outside group 0, neighbours in different groups: a fault hides the item.

    Raises ConfigurationError for a profile without one.
    """
    groups: dict[int, list[tuple[int, int]]] = {}
    for parameter in profile.parameters.values():
        group, item = parameter.locator[1] >> 8, parameter.locator[1] & 0xFF
        if parameter.locator[0] == "parameter" and group and parameter.readable:
            groups.setdefault(group, []).append((group, item))
    rounds = zip_longest(*(sorted(keys) for _, keys in sorted(groups.items())))
    tags = [key for turn in rounds for key in turn if key is not None]
    if not tags:
        raise ConfigurationError("drives.no_sync_probe", model=profile.model)
    return tags


MIN_TAGS_TO_SHARE = 4
"""From this number of sync tags on, the bus and the operations have separate ones; draft profiles list fewer."""


IDENTITY_PARTS = ("model", "series", "version", "control")  # groups 0 to 3 of frame class 0


class SunfarDialect(Dialect):
    """Dialect of one drive of the family."""

    reports_run_state = True
    state_names: tuple[str, ...] = ("state",)
    start_includes_setpoint = True

    def __init__(
        self, profile: DriveProfile, address: int, encoding: Any, options: dict[str, Any], timing: StationTiming
    ) -> None:
        super().__init__(profile, address, options)
        digits, nibble = options.get("digits", "strict"), bool(options.get("nibble", False))
        self.codec: Codec = SunfarCodec(encoding=encoding, digits=digits, nibble=nibble)
        self._sync_tags = sync_tags(profile)
        self._signals = signals_by_index(profile, "monitor")
        self._sync_count = 0
        self._last_read: SunfarReadParameter | None = None
        self.station_config = self._make_station_config(
            timing,
            frame_effect,
            stop_request=self._control_request(SunfarOperation.STOP),
            longest_requests=(SunfarWriteParameter(address, 0, 0, 0),),
        )

    def _bus_sync_request(self, n: int) -> SunfarReadParameter:
        tags = self._sync_tags[0::2] if len(self._sync_tags) >= MIN_TAGS_TO_SHARE else self._sync_tags
        return self._tag_read(self._outside_group(tags, self._last_read) or tags, n)

    def sync_request(self, avoid: Any = None) -> SunfarReadParameter:
        tags = self._sync_tags[1::2] if len(self._sync_tags) >= MIN_TAGS_TO_SHARE else self._sync_tags
        tags = self._outside_group(tags, avoid) or self._outside_group(self._sync_tags, avoid) or tags
        self._sync_count += 1
        return self._tag_read(tags, self._sync_count)

    @staticmethod
    def _outside_group(tags: list[tuple[int, int]], request: Any) -> list[tuple[int, int]]:
        """Return the tags whose reply can't be that of ``request``: in a fault only the group is echoed."""
        return [tag for tag in tags if not isinstance(request, SunfarReadParameter) or tag[0] != request.group]

    def _tag_read(self, tags: list[tuple[int, int]], n: int) -> SunfarReadParameter:
        group, item = tags[n % len(tags)]
        return SunfarReadParameter(self.address, group, item)

    def is_valid_sync_reply(self, reply: SunfarReply) -> bool:
        """Reject a short reply (6, 7, 8), which echoes only the address."""
        return reply.state is not None

    def needs_sync(self, request: Any) -> bool:
        """Return True for a parameter: monitors and writes have the same echo, and in a fault the item is missing."""
        return isinstance(request, SunfarReadParameter)

    def state_reads(self) -> tuple[Any, ...]:
        """Return the read of the output frequency: every full reply carries the state too."""
        return tuple(request for request, _ in self.polls(("output_frequency",))[:1])

    def polls(self, names: tuple[str, ...]) -> tuple[tuple[Any, float], ...]:
        monitors = {self.profile.signals[name].locator[1] for name in names if self._is_monitor(name)}
        if not monitors:  # every reply carries the state, so any monitor will do
            monitors = {min(self._signals, default=0)}
        return tuple((self._monitor_read(index), self._period_s(index, names)) for index in sorted(monitors))

    def _is_monitor(self, name: str) -> bool:
        return name in self.profile.signals and self.profile.signals[name].locator[0] == "monitor"

    def _period_s(self, index: int, names: tuple[str, ...]) -> float:
        signals = self._signals.get(index, [])
        return shortest_period_s(self.profile, [signal for signal in signals if signal.name in names] or signals)

    def _monitor_read(self, index: int) -> ReadMonitor:
        return ReadMonitor(self.address, monitor_item(index, self._index_coding))

    @property
    def _index_coding(self) -> MonitorIndexCoding:
        return "bcd" if self.options.get("monitor_index") == "bcd" else "binary"

    def decode_readings(self, request: Any, reply: SunfarReply, at: float | None) -> Readings:
        if isinstance(request, SunfarControl):
            known = request.expected_item is not None and reply.item == request.expected_item
            return self._monitor_readings(request.expected_item, reply, at) if known else {}
        if reply.state is None:
            if not isinstance(request, ReadMonitor):
                return {}
            missing = {"state": missing_reading(self.read_rejection_key(reply))}
            return missing | self._monitor_readings(request.item, reply, at)
        readings = {
            "state": Reading(
                value=reply.state.name.lower(),
                unit="",
                quality=Quality.GOOD,
                source_time=at,
                reason=None,
                raw=int(reply.state),
            )
        }
        if reply.fault_code is not None:
            readings["fault"] = Reading(
                value=reply.fault_code, unit="", quality=Quality.GOOD, source_time=at, reason=None, raw=reply.fault_code
            )
        if isinstance(request, ReadMonitor):
            readings |= self._monitor_readings(request.item, reply, at)
        return readings

    def _monitor_readings(self, item: int | None, reply: SunfarReply, at: float | None) -> dict[str, Reading]:
        index = monitor_index(item or 0, self._index_coding)
        signals = [] if index is None else self._signals.get(index, [])
        if reply.response != 0 or reply.data is None:
            return {signal.name: missing_reading(self.read_rejection_key(reply), signal.unit) for signal in signals}
        readings = {signal.name: signal_reading(signal, reply.data, at) for signal in signals}
        if reply.item is not None:
            return readings
        if reply.data == 0:  # in a fault 0 may also mean "not executed" (manual 3 (4)): missing, not 0.0
            return {signal.name: missing_reading("drives.item_not_echoed", signal.unit) for signal in signals}
        return {name: without_item_echo(reading) for name, reading in readings.items()}

    def derive_state(self, readings: ReadingPairs) -> DerivedState | None:
        """Return the state of two readings that agree; of two different turning states the newer one counts."""
        pair = readings.raw_pair("state")
        if pair is None or any(raw not in DRIVE_STATES for raw in pair):
            return None
        (older, _), (state, direction) = DRIVE_STATES[pair[0]], DRIVE_STATES[pair[1]]
        if older is not state and not (older.turning and state.turning):
            return None
        if state is not DriveState.FAULT:
            return DerivedState(state, direction)
        code = readings.agreed_raw("fault")
        return None if code is None else DerivedState(state, None, code)

    def echo_test_read(self) -> Any:
        return self.state_reads()[0]

    def setpoint_reads(self) -> tuple[Any, ...]:
        if not self._is_monitor("set_frequency"):
            return ()
        return (self._monitor_read(self.profile.signals["set_frequency"].locator[1]),)

    def can_confirm_speed(self) -> bool:
        return self._is_monitor("output_frequency")

    def confirms_stop(self, readings: ReadingPairs) -> bool:
        """Return False only for an emergency stop (2.4.6), which counts as stopped, with a frequency beside it."""
        pair = readings.raw_pair("output_frequency")
        return readings.agreed_raw("state") != SunfarState.EMERGENCY_STOP or pair is None or not pair[1]

    def rejection(self, reply: SunfarReply) -> Rejection | None:
        """Return the rejection of response codes 1 to 8 (manual 2.4.5)."""
        if reply.response is SunfarResponse.OK:
            return None
        return Rejection(f"drives.sunfar_response_{reply.response.value}", reply.response.value)

    def start(self, direction: Direction | None, word: int) -> tuple[CommandFrame, ...]:
        reverse = direction is Direction.REVERSE
        return self._edge_frame(SunfarOperation.RUN_REVERSE_AT if reverse else SunfarOperation.RUN_FORWARD_AT, word)

    def set_frequency(self, word: int, readings: ReadingPairs) -> tuple[CommandFrame, ...]:
        return (CommandFrame(self._control_request(SunfarOperation.SET_FREQUENCY, word), RetryPolicy.IDEMPOTENT),)

    def jog(self, direction: Direction, word: int | None) -> tuple[CommandFrame, ...]:
        reverse = direction is Direction.REVERSE
        if word is None:
            return self._edge_frame(SunfarOperation.JOG_REVERSE if reverse else SunfarOperation.JOG_FORWARD)
        return self._edge_frame(SunfarOperation.JOG_REVERSE_AT if reverse else SunfarOperation.JOG_FORWARD_AT, word)

    def stop(self, mode: StopMode) -> tuple[Any, ...]:
        if mode not in STOP_OPERATIONS_BY_MODE:
            raise CapabilityError("drives.cannot", model=self.profile.model, what=mode.value)
        return (self._control_request(STOP_OPERATIONS_BY_MODE[mode]),)

    def broadcast_stop(self) -> tuple[Any, ...]:
        broadcast = self.profile.broadcast
        return () if broadcast is None else (SunfarControl(broadcast, SunfarOperation.STOP),)

    def reset(self) -> tuple[CommandFrame, ...]:
        return self._edge_frame(SunfarOperation.RESET_FAULT)

    def _edge_frame(self, operation: SunfarOperation, word: int = 0) -> tuple[CommandFrame, ...]:
        return (CommandFrame(self._control_request(operation, word), RetryPolicy.EDGE_TRIGGERED),)

    def _control_request(self, operation: SunfarOperation, word: int = 0) -> SunfarControl:
        item = self.options.get("class4_item")
        return SunfarControl(self.address, operation, word, item if isinstance(item, int) and item >= 0 else None)

    def read_parameter(self, parameter: Parameter) -> Any:
        space, index = parameter.locator
        if space == "monitor":
            return self._monitor_read(index)
        return SunfarReadParameter(self.address, index >> 8, index & 0xFF)

    def parameter_raw(self, reply: SunfarReply) -> int | None:
        hidden = reply.item is None and not reply.data
        return reply.data if reply.response == 0 and not hidden else None

    def names_parameter(self, reply: SunfarReply) -> bool:
        return reply.item is not None

    def write_parameter(self, parameter: Parameter, raw: int, *, save: bool) -> CommandFrame:
        index = parameter.locator[1]
        request = SunfarWriteParameter(self.address, index >> 8, index & 0xFF, raw, save)
        return CommandFrame(request, RetryPolicy.EEPROM if save else RetryPolicy.IDEMPOTENT)

    def is_allowed(self, frame: bytes) -> bool:
        """Allow an operation only in a control frame, and no broadcast."""
        received = decode_whole_request(self.codec, frame)
        if received is None or received.request.address == self.profile.broadcast:
            return False
        return isinstance(received.request, SunfarControl) or received.operation is SunfarOperation.NONE

    def on_sent(self, request: Any) -> None:
        """Remember the last parameter read, so that the next sync probe of the bus differs from it."""
        if isinstance(request, SunfarReadParameter):
            self._last_read = request

    def identity_reads(self) -> tuple[ReadIdentity, ...]:
        """Return the reads of class 0, groups 0 to 3."""
        return tuple(ReadIdentity(self.address, group) for group in range(len(IDENTITY_PARTS)))

    def decode_identity(self, replies: tuple[Any, ...]) -> Identity:
        """Decode voltage class and power from group 0, the control source from group 3 (C320 manual 3 (1))."""
        parts = zip(IDENTITY_PARTS, replies, strict=True)
        digits = {part: reply.info for part, reply in parts if reply is not None and reply.info}
        first, control = digits.get("model", "------"), digits.get("control", "--")
        return Identity(
            model=self.profile.model,
            reported=bool(digits),
            voltage_class_v=VOLTAGE_CLASSES.get(first[0]),
            power_kw=int(first[2:]) / 10 if first[2:].isdecimal() else None,
            digits=tuple(digits.items()),
            host_controls=_flag(control[0]),
            host_sets_frequency=_flag(control[1]),
        )


def _flag(digit: str) -> bool | None:
    return {"0": False, "1": True}.get(digit)
