"""Simulated C320 and the related models C300 … E550 in both encodings, after appendix one of the C320 manual.

The operation field acts in every class of frame (manual 2.4.4): a read that carries 01H starts this drive. The manual
names F0.1, F4.0, F1.10, F6.12, F9.3 and F9.4; all other places, the scales of times, the fault numbers and monitors
d.2, d.3 and d.5 are the simulator's own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

from drivebus.errors import ProtocolError
from drivebus.protocols import sunfar
from drivebus.protocols.checksum import sum16
from drivebus.protocols.codec import Codec
from drivebus.protocols.sunfar import SunfarOperation, SunfarReply, SunfarResponse, SunfarState
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.framing import FramingRule
from drivebus.simulator.motor import Motor, OutputPhase, Trip
from drivebus.simulator.parameter_memory import Access, ParameterSpec, RejectReason
from drivebus.simulator.station import SimulatedModel, SimulatedStation, StationReply

FREQUENCY_CHANNEL = 0x0_01
FROM_BUS = 2
START_MODE = 0x4_00
SPEED_SEARCH = 1
INPUT_CHARACTERISTIC = 0x1_0A
MONITOR_SELECTOR = 0x6_0C
KEYPAD_HZ = 0x0_02
COMMAND_CHANNEL = 0x0_03
MAXIMUM_HZ = 0x0_04
ACCEL_TIME, DECEL_TIME = 0x0_08, 0x0_09
JOG_HZ = 0x1_00

LAST_MONITOR = 37  # d-37 is the last monitor of the manual's table

RESPONSES_BY_REASON = {  # manual 2.4.5
    RejectReason.UNKNOWN: SunfarResponse.BAD_CODE,
    RejectReason.HIDDEN: SunfarResponse.RESERVED,
    RejectReason.READ_ONLY: SunfarResponse.RESERVED,
    RejectReason.PASSWORD: SunfarResponse.PASSWORD,
    RejectReason.RUNNING: SunfarResponse.RUNNING,
    RejectReason.RANGE: SunfarResponse.OUT_OF_RANGE,
}

FAULT_CODES = {trip: number for number, trip in enumerate(Trip, start=1)}


@dataclass(frozen=True, slots=True)
class CommLossSettings:
    """Parameters of a model's communication-loss behaviour. The time is in 0.1 s; 0 switches the timer off."""

    time: int
    action: ParameterSpec
    place: int  # parameter of the action
    stops: frozenset[int]
    trips: frozenset[int] = frozenset()


COMM_LOSS_F9 = CommLossSettings(0x9_04, ParameterSpec(1, 0, 2), 0x9_03, stops=frozenset({1}), trips=frozenset({2}))
"""C320: the values of F9.3 are the simulator's own."""
COMM_LOSS_F4 = CommLossSettings(0x4_04, ParameterSpec(0, 0, 0x0011), 0x4_03, stops=frozenset({0x00, 0x01}))
"""E300 (F4.3, F4.4) and E550: the tens digit is 0 stop, 1 keep running, each digit being four bits."""

_RESERVED = ParameterSpec(access=Access.HIDDEN)
_GROUP_SIZE = 32


def parameter_specs(step_hz: float, selector: int, comm_loss: CommLossSettings) -> dict[int, ParameterSpec]:
    """Return all sixteen groups as commissioned for RS485; places that the manual does not describe are reserved."""
    highest = round(400.0 / step_hz)
    table = {group << 8 | item: _RESERVED for group in range(16) for item in range(_GROUP_SIZE)}
    table |= {
        FREQUENCY_CHANNEL: ParameterSpec(FROM_BUS, 0, 9, Access.LOCKED_WHILE_RUNNING),
        KEYPAD_HZ: ParameterSpec(round(50.0 / step_hz), 0, highest),
        COMMAND_CHANNEL: ParameterSpec(FROM_BUS, 0, 2, Access.LOCKED_WHILE_RUNNING),
        MAXIMUM_HZ: ParameterSpec(round(50.0 / step_hz), round(5.0 / step_hz), highest, Access.LOCKED_WHILE_RUNNING),
        ACCEL_TIME: ParameterSpec(100, 1, 60000),
        DECEL_TIME: ParameterSpec(100, 1, 60000),
        JOG_HZ: ParameterSpec(round(5.0 / step_hz), 0, round(50.0 / step_hz)),
        INPUT_CHARACTERISTIC: ParameterSpec(0, 0, 0x1111),
        START_MODE: ParameterSpec(0, 0, 2, Access.LOCKED_WHILE_RUNNING),
        selector: ParameterSpec(0, 0, LAST_MONITOR),
        comm_loss.place: comm_loss.action,
        comm_loss.time: ParameterSpec(0, 0, 6000),
    }
    return table


_ODD_DIGITS = bytes.maketrans(b"ABCDEF", b":;<=>?")
_FIELD_WIDTHS = {12: (2, 1, 2, 1, 2, 4), 5: (2, 1, 2)}
"""Digits of each field of a full and of a short reply, by the total length of the fields."""


def tolerant_digits(frame: bytes) -> bytes:
    """Return an ASCII frame with 3AH-3FH for the digits A-F, also in its checksum (manual 4.5)."""
    if frame[:1] != b"*":
        return frame
    body = frame[1:-5].translate(_ODD_DIGITS)
    return b"*%b%b\r" % (body, (b"%04X" % sum16(body)).translate(_ODD_DIGITS))


def unpacked_nibbles(frame: bytes) -> bytes:
    """Return a hex frame with one digit in each byte and a packed checksum (manual 4.5, 4.6)."""
    if frame[:1] != b"Z":
        return frame
    body, at = b"", 1
    for width in _FIELD_WIDTHS[len(frame) - 6]:
        body += _unpack_field(frame[at : at + width])
        at += width
    return b"Z%b%b\r" % (body, sum16(body).to_bytes(4, "big"))


def _unpack_field(packed: bytes) -> bytes:
    """Return one byte a digit; identity digits already take one byte each."""
    value, width = int.from_bytes(packed, "big"), len(packed)
    if value >= 16**width:
        return packed
    return bytes(value >> 4 * place & 0xF for place in reversed(range(width)))


STARTS = {
    SunfarOperation.RUN_FORWARD: 1,
    SunfarOperation.RUN_REVERSE: -1,
    SunfarOperation.RUN_FORWARD_AT: 1,
    SunfarOperation.RUN_REVERSE_AT: -1,
}
JOGS = {
    SunfarOperation.JOG_FORWARD: 1,
    SunfarOperation.JOG_REVERSE: -1,
    SunfarOperation.JOG_FORWARD_AT: 1,
    SunfarOperation.JOG_REVERSE_AT: -1,
}
STOPS = frozenset(
    (SunfarOperation.STOP, SunfarOperation.STOP_AT, SunfarOperation.JOG_STOP, SunfarOperation.JOG_STOP_AT)
)


class C320Station(SimulatedStation):
    """Simulated C320 or a related model, with settings for what the manual leaves open.

    The arguments are described in ``docs/reference/simulated-drives.md``.
    """

    rule: FramingRule = FramingRule(gap_characters=5.0, requires_gap=True, start_bytes=b"\x2a\x5a")
    broadcast: ClassVar[int] = sunfar.BROADCAST
    factory_settings: ClassVar[SerialSettings] = SerialSettings(9600, 8, "E")
    ramp_keys = (ACCEL_TIME, DECEL_TIME)

    def __init__(
        self,
        address: int,
        *,
        monitor_index: Literal["binary", "bcd"] = "binary",  # d.15 is requested as 0FH or as 15H
        watchdog: Literal["own", "all"] = "own",  # frames that restart the communication-loss timer
        digits: Literal["strict", "tolerant"] = "strict",  # digits A-F of ASCII replies as letters or as 3AH-3FH
        nibble: Literal["off", "on"] = "off",  # hex replies packed, or one digit in a byte
        class0_fault: Literal["code", "information"] = "code",  # digits 7-8 of an identity reply in a fault
        step_hz: float = 0.01,  # 0.1 on the E series
        current_at_1: bool = False,  # d.1 is the current (C300, E300) instead of the voltage
        selector: int = MONITOR_SELECTOR,
        comm_loss: CommLossSettings = COMM_LOSS_F9,
        delay_characters: float = 4.0,  # at most 8 (manual 2.2.4)
        motor: Motor | None = None,
    ) -> None:
        super().__init__(address, parameter_specs(step_hz, selector, comm_loss), motor)
        self.codecs: tuple[Codec, ...] = (sunfar.SunfarCodec("ascii"), sunfar.SunfarCodec("hex"))
        self.monitor_index = monitor_index
        self.watchdog = watchdog
        self.class0_fault = class0_fault
        self.step_hz = step_hz
        self.current_at_1 = current_at_1
        self.selector = selector
        self.comm_loss = comm_loss
        self.delay_characters = delay_characters
        self._reply_variants: list[Callable[[bytes], bytes]] = []
        if digits == "tolerant":
            self._reply_variants.append(tolerant_digits)
        if nibble == "on":
            self._reply_variants.append(unpacked_nibbles)
        self.power_up()

    def power_up(self) -> None:
        self.emergency = False
        self.dip_left_s = 0.0
        self.restarting = False
        self.silent_s: float | None = None  # seconds since the last frame, None before the first

    def reply_delay_s(self, settings: SerialSettings) -> float:
        return settings.seconds(self.delay_characters)

    def handle_frame(self, *frame: Any, **details: Any) -> StationReply | None:
        reply = super().handle_frame(*frame, **details)
        if reply is not None:
            for variant in self._reply_variants:
                reply = replace(reply, data=variant(reply.data))
        return reply

    def on_foreign_frame(self, now: float) -> None:
        if self.watchdog == "all":
            self.advance(now)
            self.silent_s = 0.0

    def reply_to_error(self, error: ProtocolError, codec: Codec) -> Any:
        """Return codes 6, 7 and 8 in a short frame; a wrong checksum or end mark gets no reply (manual 3)."""
        self.silent_s = 0.0
        reply = sunfar.error_reply(error)
        return reply if reply is not None and reply.address == self.address else None

    def handle_request(self, message: Any, codec: Codec) -> Any:
        self.silent_s = 0.0
        request, operation = message.request, message.operation
        before = self.state
        if isinstance(request, sunfar.SunfarControl):
            response = self.execute(operation, request.data)
            reply = self._monitor_reply(self.memory[self.selector], response, self._selected_item)
        else:
            reply = self._read_or_write(request)
            if not reply.response.is_short:
                self.execute(operation, None)
        return self._with_state(reply, before if operation in STARTS or operation in JOGS else self.state)

    def _with_state(self, reply: SunfarReply, state: SunfarState) -> SunfarReply:
        """Complete a full reply with the state, and in a fault with the fault code in place of the item."""
        if reply.response.is_short:
            return reply
        code = self.trip_code(self.motor.trip) if state is SunfarState.FAULT and self.motor.trip else None
        info = reply.info
        if code is None or (info is not None and self.class0_fault == "information"):
            return SunfarReply(
                address=self.address,
                response=reply.response,
                state=state,
                group=reply.group,
                item=reply.item,
                data=reply.data,
                info=info,
            )
        info = None if info is None else "--" + info[2:]
        return SunfarReply(
            address=self.address,
            response=reply.response,
            state=state,
            group=reply.group,
            item=None,
            data=reply.data,
            fault_code=code,
            info=info,
        )

    def _read_or_write(self, request: Any) -> SunfarReply:
        match request:
            case sunfar.ReadIdentity():
                return self._identity(request.group)
            case sunfar.ReadMonitor():
                number = sunfar.monitor_index(request.item, self.monitor_index)
                if number is None or number > LAST_MONITOR:
                    return SunfarReply(address=self.address, response=SunfarResponse.BAD_CODE)
                return self._monitor_reply(number, SunfarResponse.OK, request.item)
            case sunfar.SunfarReadParameter():
                return self._read(request.group, request.item)
        return self._write(request)

    def _identity(self, group: int) -> SunfarReply:
        """Reply to class 0. Series and version are the simulator's own."""
        plate = self.motor.rating
        digits = {
            0: f"{2 if plate.voltage_v < 300 else 4}0{round(plate.power_kw * 10):04d}",
            1: "000320",
            2: "000100",
            3: f"{int(self.obeys_bus)}{int(self.memory[FREQUENCY_CHANNEL] == FROM_BUS)}0000",
        }
        response = SunfarResponse.OK if group in digits else SunfarResponse.RESERVED
        return SunfarReply(address=self.address, response=response, group=group, info=digits.get(group, "000000"))

    def _monitor_reply(self, number: int, response: SunfarResponse, item: int) -> SunfarReply:
        data = self.monitor(number) & 0xFFFF if response is SunfarResponse.OK else 0
        return SunfarReply(address=self.address, response=response, group=0, item=item, data=data)

    @property
    def _selected_item(self) -> int:
        return sunfar.monitor_item(self.memory[self.selector], self.monitor_index)

    def _read(self, group: int, item: int) -> SunfarReply:
        key = group << 8 | item
        rejection = self.memory.read_rejection(key)
        response = RESPONSES_BY_REASON[rejection] if rejection else SunfarResponse.OK
        data = 0 if rejection else self.memory[key]
        return SunfarReply(address=self.address, response=response, group=group, item=item, data=data)

    def _write(self, request: sunfar.SunfarWriteParameter) -> SunfarReply:
        """Execute classes 3 (RAM) and 5 (EEPROM too). A rejected write replies with data 0000."""
        key = request.group << 8 | request.item
        rejection = self.memory.write_rejection(key, request.data, running=self.running)
        if rejection is None:
            self.memory.write(key, request.data, save=request.save)
        response = RESPONSES_BY_REASON[rejection] if rejection else SunfarResponse.OK
        data = 0 if rejection else request.data
        return SunfarReply(address=self.address, response=response, group=request.group, item=request.item, data=data)

    def elapse(self, dt: float) -> None:
        self.motor.accel_s = self.memory[ACCEL_TIME] / 10.0
        self.motor.decel_s = self.memory[DECEL_TIME] / 10.0
        self.motor.ramp_base_hz = self.memory[MAXIMUM_HZ] * self.step_hz
        while dt > 0.0:
            piece = min(dt, self._until_event())
            self.motor.step(piece)
            self._advance_timers(piece)
            dt -= piece

    def _until_event(self) -> float:
        left = self.dip_left_s if self.dip_left_s > 0.0 else float("inf")
        limit = self.memory[self.comm_loss.time] / 10.0
        if limit and self.silent_s is not None and self.silent_s < limit:
            left = min(left, limit - self.silent_s)
        return left

    def _advance_timers(self, seconds: float) -> None:
        if self.dip_left_s > 0.0:
            self.dip_left_s -= seconds
            if self.dip_left_s <= 1e-9:
                self._restore_mains()
        if self.silent_s is not None:
            limit = self.memory[self.comm_loss.time] / 10.0
            before, self.silent_s = self.silent_s, self.silent_s + seconds
            if limit and before < limit - 1e-9 <= self.silent_s:
                self.silent_s = max(self.silent_s, limit)
                self._on_comm_loss()

    def _on_comm_loss(self) -> None:
        """Execute the action of F9.3 after F9.4 without a frame (manual 2.2.4 (3); E300, E550: F4.3, F4.4)."""
        if self.memory[COMMAND_CHANNEL] != FROM_BUS or not self.running:
            return
        action = self.memory[self.comm_loss.place]
        if action in self.comm_loss.trips:
            self.motor.force_trip(Trip.COMM_LOSS)
        elif action in self.comm_loss.stops:
            self.motor.stop()

    def power_dip(self, seconds: float) -> None:
        """Interrupt the mains. With F4.0 = 1 a running drive restarts by speed search afterwards (state 13H)."""
        self.motor.mains, self.dip_left_s = 0.0, seconds
        if self.running and self.memory[START_MODE] == SPEED_SEARCH:
            self.restarting = True
            self.motor.coast()

    def _restore_mains(self) -> None:
        self.dip_left_s, self.motor.mains = 0.0, 1.0
        self.motor.step(1e-3)
        if self.restarting:
            self.restarting = False
            self.run_towards(self.reference_hz)

    def monitor(self, number: int) -> int:
        """Return the value of d.n."""
        motor = self.displayed_motor
        match number:
            case 0:
                return round(abs(motor.output_hz) / self.step_hz)
            case 1:
                return round(motor.current_a * 10) if self.current_at_1 else round(motor.voltage_v)
            case 2:
                return round(motor.voltage_v) if self.current_at_1 else round(motor.current_a * 10)
            case 3:
                return round(abs(motor.speed_rpm))
            case 4:
                return round(motor.bus_v)
            case 5:
                return round(motor.temperature_c)
            case 6:
                return round(self.reference_hz / self.step_hz)
            case 37:
                return self.fault_temperature_c
        return 0

    @property
    def fault_temperature_c(self) -> int:
        """Module temperature at the last fault (d.37), which a reset keeps."""
        return round(self.motor.trip_temperature_c)

    @property
    def obeys_bus(self) -> bool:
        return self.memory[COMMAND_CHANNEL] == FROM_BUS

    @property
    def reference_hz(self) -> float:
        """Set frequency: from the bus with F0.1 = 2, else from the keypad."""
        if self.memory[FREQUENCY_CHANNEL] == FROM_BUS:
            return self.setpoint_hz
        return self.memory[KEYPAD_HZ] * self.step_hz

    def execute(self, operation: SunfarOperation, data: int | None) -> SunfarResponse:
        """Execute an operation; ``data`` is a frequency in class 4 only."""
        if operation.sets_frequency and data is not None:
            if data > self.memory[MAXIMUM_HZ]:
                return SunfarResponse.OUT_OF_RANGE
            if operation not in JOGS:
                self._set_frequency(data * self.step_hz)
        if not self.obeys_bus:
            return SunfarResponse.OK
        if operation in STARTS and not self.emergency:
            self._start(STARTS[operation])
        elif operation in JOGS and not self.emergency:
            self._jog(JOGS[operation], data if operation.sets_frequency else None)
        elif operation in STOPS:
            self._stop(jog_only=operation in (SunfarOperation.JOG_STOP, SunfarOperation.JOG_STOP_AT))
        elif operation is SunfarOperation.EMERGENCY_STOP:
            self.emergency = True
            self.motor.coast()
        elif operation is SunfarOperation.RESET_FAULT:
            self.emergency = False
            self.motor.reset()
        return SunfarResponse.OK

    def keypad_run(self, frequency_hz: float, *, reverse: bool = False) -> None:
        """Start the drive at its keypad, except during an emergency stop: the manual names no way to run then."""
        if not self.emergency:
            super().keypad_run(frequency_hz, reverse=reverse)

    def _set_frequency(self, frequency_hz: float) -> None:
        self.setpoint_hz = frequency_hz
        if self.running and not self.jogging and not self.motor.stopping:
            self.run_towards(self.reference_hz)

    def _start(self, direction: int) -> None:
        self.jogging, self.reverse = False, direction < 0
        self.run_towards(self.reference_hz)

    def _jog(self, direction: int, data: int | None) -> None:
        """Jog, unless the drive runs."""
        if self.running and not self.jogging:
            return
        self.jogging = True
        raw = self.memory[JOG_HZ] if data is None else data
        self.motor.run(direction * raw * self.step_hz)

    def _stop(self, *, jog_only: bool) -> None:
        self.emergency = self.restarting = False
        if self.jogging or not jog_only:
            self.motor.stop()

    @property
    def state(self) -> SunfarState:
        """State code of manual 2.4.6."""
        motor = self.motor
        if motor.trip is not None:
            return SunfarState.FAULT
        if self.emergency:
            return SunfarState.EMERGENCY_STOP
        if self.restarting:
            return SunfarState.RESTARTING
        if not motor.ready:
            return SunfarState.NOT_READY
        if not motor.energised:
            return SunfarState.STOPPED
        return self._moving_state(motor)

    def _moving_state(self, motor: Motor) -> SunfarState:
        backward = motor.output_hz < 0.0 or (motor.output_hz == 0.0 and motor.target_hz < 0.0)
        phase = motor.phase
        if phase is OutputPhase.DC_BRAKING:
            return SunfarState.DC_BRAKING
        if self.jogging and not motor.stopping:
            return SunfarState.JOGGING_REVERSE if backward else SunfarState.JOGGING_FORWARD
        if phase is OutputPhase.ACCELERATING:
            return SunfarState.ACCELERATING_REVERSE if backward else SunfarState.ACCELERATING_FORWARD
        if phase is OutputPhase.DECELERATING:
            return SunfarState.DECELERATING_REVERSE if backward else SunfarState.DECELERATING_FORWARD
        return SunfarState.RUNNING_REVERSE if backward else SunfarState.RUNNING_FORWARD

    @property
    def profile_options(self) -> dict[str, str]:
        return {"setpoint_step": f"{self.step_hz:g}"}

    def trip_code(self, trip: Trip) -> int:
        """Return the number n of Fu.n on the keypad."""
        return FAULT_CODES[trip]


_OPTIONS = {
    "monitor_index": ("binary", "bcd"),
    "watchdog": ("own", "all"),
    "digits": ("strict", "tolerant"),
    "nibble": ("off", "on"),
    "class0_fault": ("code", "information"),
}


def _model(**fixed: Any) -> SimulatedModel:
    return SimulatedModel(station=C320Station, addresses=range(31), options=_OPTIONS, fixed=fixed)


MODELS = {
    "c320": _model(),
    "c300": _model(current_at_1=True),
    "e300": _model(step_hz=0.1, current_at_1=True, comm_loss=COMM_LOSS_F4),
    "e350": _model(step_hz=0.1),
    "e500": _model(step_hz=0.1, selector=0x308),
    "e550": _model(step_hz=0.1, comm_loss=COMM_LOSS_F4),
}
"""By their manuals E500 selects its monitor with F3.08; E300 and E550 keep F9.3 and F9.4 in F4.3 and F4.4."""
