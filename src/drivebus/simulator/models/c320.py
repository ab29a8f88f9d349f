"""A pretend C320, and its sisters C300 … E550: both encodings, from appendix one of the C320 manual. Pure.

As the manual's section 2.4.4 says, the operation acts in every class of frame: a read that carries 01H starts this
drive (T01). What the drive then does is in ``c320_drive``, its parameters are in ``c320_tables``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar, Literal

from drivebus.errors import ProtocolError
from drivebus.protocols import sunfar
from drivebus.protocols.codec import Codec
from drivebus.protocols.sunfar import SunfarReply, SunfarResponse, SunfarState
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.framing import FramingRule
from drivebus.simulator.models import c320_variants
from drivebus.simulator.models.c320_drive import JOGS, STARTS, C320Drive
from drivebus.simulator.models.c320_tables import (
    COMM_LOSS_F4,
    COMM_LOSS_F9,
    FREQUENCY_CHANNEL,
    FROM_BUS,
    LAST_MONITOR,
    MONITOR_SELECTOR,
    RESPONSES_BY_REASON,
    CommLossSettings,
)
from drivebus.simulator.motor import Motor
from drivebus.simulator.station import SimulatedModel, StationReply


class C320Station(C320Drive):
    """Settings for what the manual leaves open, and for what its sisters do otherwise.

    ``monitor_index``: how d.15 is asked for, 0FH or 15H [OPEN]. ``step_hz``: 0.01 on C320 and C300, 0.1 on the E
    series. ``current_at_1``: d.1 is the current (C300, E300) instead of the voltage. ``selector``, ``comm_loss``:
    where a sister keeps what is F6.12, F9.3 and F9.4 here. ``watchdog``: which frames feed the comm-loss timer, its
    own or all [OPEN]. ``digits``, ``nibble``: how it spells its replies (``c320_spelling``) [OPEN]. ``class0_fault``:
    what stands in digits 7-8 of an identity reply in a fault, the fault's code or the information as ever [OPEN].
    """

    family: ClassVar[str] = "c320"
    rule: FramingRule = FramingRule(5.0, requires_gap=True, start_bytes=b"\x2a\x5a")
    broadcast: ClassVar[int] = sunfar.BROADCAST
    factory_settings: ClassVar[SerialSettings] = SerialSettings(9600, 8, "E")

    def __init__(
        self,
        address: int,
        *,
        monitor_index: Literal["binary", "bcd"] = "binary",
        watchdog: Literal["own", "all"] = "own",
        digits: Literal["strict", "tolerant"] = "strict",
        nibble: Literal["off", "on"] = "off",
        class0_fault: Literal["code", "information"] = "code",
        step_hz: float = 0.01,
        current_at_1: bool = False,
        selector: int = MONITOR_SELECTOR,
        comm_loss: CommLossSettings = COMM_LOSS_F9,
        delay_characters: float = 4.0,
        motor: Motor | None = None,
    ) -> None:
        super().__init__(address, step_hz, current_at_1, selector, comm_loss, motor)
        self.codecs: tuple[Codec, ...] = (sunfar.SunfarCodec("ascii"), sunfar.SunfarCodec("hex"))
        self.monitor_index = monitor_index
        self.watchdog = watchdog
        self.class0_fault = class0_fault
        self._reply_variants: list[Callable[[bytes], bytes]] = []
        if digits == "tolerant":
            self._reply_variants.append(c320_variants.tolerant_digits)
        if nibble == "on":
            self._reply_variants.append(c320_variants.unpacked_nibbles)
        self.delay_characters = delay_characters
        """At most 8 (2.2.4 (2))."""

    def reply_delay_s(self, line: SerialSettings) -> float:
        return line.seconds(self.delay_characters)

    # Frames.

    def handle_frame(self, *frame: Any, **details: Any) -> StationReply | None:
        said = super().handle_frame(*frame, **details)
        for spelled in self._reply_variants if said is not None else ():
            assert said is not None
            said = replace(said, data=spelled(said.data))
        return said

    def on_foreign_frame(self, now: float) -> None:
        if self.watchdog == "all":
            self.advance(now)
            self.silent_s = 0.0

    def reply_to_error(self, error: ProtocolError, codec: Codec) -> Any:
        """Codes 6, 7 and 8 in the short frame; a bad sum or end mark gets no answer (section 3)."""
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
        """Every full reply carries the state (a start's the one before it), in a fault its code for the item (T05)."""
        if reply.response.is_short:
            return reply
        code = self.trip_code(self.motor.trip) if state is SunfarState.FAULT and self.motor.trip else None
        info = reply.info
        if code is None or (info is not None and self.class0_fault == "information"):
            return SunfarReply(self.address, reply.response, state, reply.group, reply.item, reply.data, info=info)
        info = None if info is None else "--" + info[2:]
        return SunfarReply(self.address, reply.response, state, reply.group, None, reply.data, code, info)

    def _read_or_write(self, request: Any) -> SunfarReply:
        match request:
            case sunfar.ReadIdentity():
                return self._identity(request.group)
            case sunfar.ReadMonitor():
                number = sunfar.monitor_index(request.item, self.monitor_index)
                if number is None or number > LAST_MONITOR:
                    return SunfarReply(self.address, SunfarResponse.BAD_CODE)
                return self._monitor_reply(number, SunfarResponse.OK, request.item)
            case sunfar.SunfarReadParameter():
                return self._read(request.group, request.item)
        return self._write(request)

    def _identity(self, group: int) -> SunfarReply:
        """Class 0. Series and version are the sim's own."""
        plate = self.motor.rating
        digits = {
            0: f"{2 if plate.voltage_v < 300 else 4}0{round(plate.power_kw * 10):04d}",
            1: "000320",
            2: "000100",
            3: f"{int(self.obeys_bus)}{int(self.memory[FREQUENCY_CHANNEL] == FROM_BUS)}0000",
        }
        response = SunfarResponse.OK if group in digits else SunfarResponse.RESERVED
        return SunfarReply(self.address, response, group=group, info=digits.get(group, "000000"))

    def _monitor_reply(self, number: int, response: SunfarResponse, item: int) -> SunfarReply:
        data = self.monitor(number) & 0xFFFF if response is SunfarResponse.OK else 0
        return SunfarReply(self.address, response, group=0, item=item, data=data)

    @property
    def _selected_item(self) -> int:
        return sunfar.monitor_item(self.memory[self.selector], self.monitor_index)

    # Parameters.

    def _read(self, group: int, item: int) -> SunfarReply:
        key = group << 8 | item
        refusal = self.memory.read_rejection(key)
        response = RESPONSES_BY_REASON[refusal] if refusal else SunfarResponse.OK
        data = 0 if refusal else self.memory[key]
        return SunfarReply(self.address, response, group=group, item=item, data=data)

    def _write(self, request: sunfar.SunfarWriteParameter) -> SunfarReply:
        """Classes 3 (RAM) and 5 (EEPROM too). Refused: the data read 0000."""
        key = request.group << 8 | request.item
        refusal = self.memory.write_rejection(key, request.data, self.running)
        if refusal is None:
            self.memory.write(key, request.data, save=request.save)
        response = RESPONSES_BY_REASON[refusal] if refusal else SunfarResponse.OK
        data = 0 if refusal else request.data
        return SunfarReply(self.address, response, group=request.group, item=request.item, data=data)


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
    "e500": _model(step_hz=0.1, selector=0x308),
    "e550": _model(step_hz=0.1, comm_loss=COMM_LOSS_F4),
}
"""By their manuals E500 selects its monitor with F3.08; E300 and E550 keep F9.3 and F9.4 in F4.3 and F4.4."""
