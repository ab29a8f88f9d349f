"""Requests and replies of the Sunfar protocol as values, and the codes and names of their fields.

Section numbers are those of the C320 manual. Only ``SunfarControl`` carries an operation, because a drive obeys the
operation field in every class of frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar, Literal

from drivebus.errors import AlphabetError, CodeError, ProtocolError

BROADCAST = 31
"""Every station obeys it and none answers (2.4.2)."""

VOLTAGE_CLASSES = {"2": 220, "4": 380}
"""V by the first digit of identity group 0. The manual (3 (1)) has only 4; 2 is assumed."""

MonitorIndexCoding = Literal["binary", "bcd"]


class SunfarOperation(IntEnum):
    """Operation code of a request, obeyed in every class (2.4.4). ``*_AT`` sets the frequency as well."""

    NONE = 0x00
    RUN_FORWARD = 0x01
    RUN_REVERSE = 0x02
    STOP = 0x03
    JOG_FORWARD = 0x04
    JOG_REVERSE = 0x05
    JOG_STOP = 0x06
    SET_FREQUENCY = 0x10
    RUN_FORWARD_AT = 0x11
    RUN_REVERSE_AT = 0x12
    STOP_AT = 0x13
    JOG_FORWARD_AT = 0x14
    JOG_REVERSE_AT = 0x15
    JOG_STOP_AT = 0x16
    RESET_FAULT = 0x20
    EMERGENCY_STOP = 0x21

    @property
    def sets_frequency(self) -> bool:
        """Whether the data of a class-4 frame are the frequency."""
        return self & 0xF0 == 0x10


class SunfarState(IntEnum):
    """State code of a reply (2.4.6)."""

    NOT_READY = 0x00
    """The DC bus is not charged."""
    RUNNING_FORWARD = 0x01
    RUNNING_REVERSE = 0x02
    STOPPED = 0x03
    JOGGING_FORWARD = 0x04
    JOGGING_REVERSE = 0x05
    ACCELERATING_FORWARD = 0x11
    ACCELERATING_REVERSE = 0x12
    RESTARTING = 0x13
    """After an instantaneous power loss."""
    DECELERATING_FORWARD = 0x14
    DECELERATING_REVERSE = 0x15
    DC_BRAKING = 0x16
    FAULT = 0x20
    """The item field of the reply then holds the fault code."""
    EMERGENCY_STOP = 0x21


class SunfarResponse(IntEnum):
    """Response code of a reply (2.4.5). Codes 6, 7 and 8 come in the short frame."""

    OK = 0
    OUT_OF_RANGE = 1
    RUNNING = 2
    """The parameter can't be changed while the motor runs."""
    PASSWORD = 3
    RESERVED = 4
    """A reserved or hidden parameter."""
    BAD_CODE = 6
    """No such parameter or address."""
    BAD_ASCII = 7
    BAD_COMMAND = 8
    """No such class or operation."""

    @property
    def is_short(self) -> bool:
        """Sent as 11 bytes without state and data."""
        return self >= SunfarResponse.BAD_CODE


GROUP_LETTERS = "0123456789CEFHLP"
"""F0 … F9 = 0 … 9, FC = A, FE = B, FF = C, FH = D, FL = E, FP = F (section 3)."""


def parameter_name(group: int, item: int) -> str:
    """Return the manual's notation, e.g. (1, 10) → ``F1.10``."""
    return f"F{GROUP_LETTERS[group]}.{item}"


def monitor_item(index: int, coding: MonitorIndexCoding = "binary") -> int:
    """Return the item field of monitor d.``index``: binary (d.15 → 0FH) or, as the manual prints it, BCD (15H).

    Raises ValueError for an index outside 0-255, under "bcd" outside 0-99.
    """
    limit = 0xFF if coding == "binary" else 99
    if not 0 <= index <= limit:
        raise ValueError(f"monitor d.{index}: expected d.0 to d.{limit}")
    return index if coding == "binary" else int(str(index), 16)


def monitor_index(item: int, coding: MonitorIndexCoding = "binary") -> int | None:
    """Return the n of d.n for an item field; None where the item is no decimal number under "bcd"."""
    if coding == "binary":
        return item
    return int(f"{item:X}") if f"{item:X}".isdecimal() else None


CLASS_OFFSET = 3
"""Offset of the byte that decides the length: class of a request, response code of a reply."""
OPERATION_BY_CODE = {int(operation): operation for operation in SunfarOperation}
STATE_BY_CODE = {int(state): state for state in SunfarState}
RESPONSE_BY_CODE = {int(response): response for response in SunfarResponse}


@dataclass(frozen=True, slots=True)
class ReadIdentity:
    """Class 0: group 0 model, 1 series, 2 program version, 3 control source."""

    address: int
    group: int
    frame_class: ClassVar[int] = 0


@dataclass(frozen=True, slots=True)
class ReadMonitor:
    """Class 1: monitor d.n; ``item`` as on the wire (see ``monitor_item``)."""

    address: int
    item: int
    frame_class: ClassVar[int] = 1


@dataclass(frozen=True, slots=True)
class SunfarReadParameter:
    """Class 2: read parameter F``group``.``item``."""

    address: int
    group: int
    item: int
    frame_class: ClassVar[int] = 2


@dataclass(frozen=True, slots=True)
class SunfarWriteParameter:
    """Class 3 (RAM), or with ``save`` class 5 (EEPROM)."""

    address: int
    group: int
    item: int
    data: int
    save: bool = False

    @property
    def frame_class(self) -> int:
        return 5 if self.save else 3


@dataclass(frozen=True, slots=True)
class SunfarControl:
    """Class 4. ``data`` is the frequency of an operation that sets one, else 0.

    ``expected_item`` is the monitor that parameter F6.12 selects for the reply; without it the reply has no data.
    """

    address: int
    operation: SunfarOperation
    data: int = 0
    expected_item: int | None = None
    frame_class: ClassVar[int] = 4


SunfarRequest = ReadIdentity | ReadMonitor | SunfarReadParameter | SunfarWriteParameter | SunfarControl


@dataclass(frozen=True, slots=True)
class ReceivedRequest:
    """Request as a station decodes it, with the operation that the frame carries whatever its class.

    ``nibble_data`` is set where the data bytes also read as one nibble a byte, with another value.
    """

    request: SunfarRequest
    operation: SunfarOperation
    nibble_data: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SunfarReply:
    """Reply of a station. A short reply (response 6, 7, 8) has only address and response.

    ``item`` is None in a fault (``fault_code`` stands in its field), in a reply to ``ReadIdentity`` (``info`` does),
    and together with ``data`` in a reply to ``SunfarControl`` that does not name the expected item.
    """

    address: int
    response: SunfarResponse
    state: SunfarState | None = None
    group: int | None = None
    item: int | None = None
    data: int | None = None
    fault_code: int | None = None
    info: str | None = None
    """Digits 7-12 of a class-0 reply; "-" for a digit that a fault code may have replaced."""
    nibble_data: int | None = None
    """Data read as one nibble a byte, where the frame does not decide between the two readings."""


class UnknownItemError(CodeError):
    """Group or item in a class that has none: a station answers response 6."""


def error_reply(error: ProtocolError) -> SunfarReply | None:
    """Return the reply of a station to a frame that it can't obey, or None where it sends none.

    A frame with a wrong head, checksum or end mark, and a broadcast, gets no reply (section 3, first note).
    """
    address = error.params.get("address")
    if not isinstance(address, int) or not 0 <= address < BROADCAST:
        return None
    for error_type, response in _ERROR_RESPONSES:
        if isinstance(error, error_type):
            return SunfarReply(address=address, response=response)
    return None


_ERROR_RESPONSES: tuple[tuple[type[ProtocolError], SunfarResponse], ...] = (
    (UnknownItemError, SunfarResponse.BAD_CODE),
    (AlphabetError, SunfarResponse.BAD_ASCII),
    (CodeError, SunfarResponse.BAD_COMMAND),
)
