"""Requests and replies of the C320 protocol as values. Only ``Control`` has an operation (T01, T07)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from drivebus.errors import AlphabetError, CodeError, ProtocolError
from drivebus.protocols.sunfar.tables import BROADCAST, SunfarOperation, SunfarResponse, SunfarState


@dataclass(frozen=True, slots=True)
class ReadIdentity:
    """Class 0: group 0 model, 1 series, 2 program version, 3 who controls."""

    address: int
    group: int
    frame_class: ClassVar[int] = 0


@dataclass(frozen=True, slots=True)
class ReadMonitor:
    """Class 1: monitor d.n; ``item`` as on the wire (``tables.monitor_item``)."""

    address: int
    item: int
    frame_class: ClassVar[int] = 1


@dataclass(frozen=True, slots=True)
class SunfarReadParameter:
    """Class 2: parameter F``group``.``item``."""

    address: int
    group: int
    item: int
    frame_class: ClassVar[int] = 2


@dataclass(frozen=True, slots=True)
class SunfarWriteParameter:
    """Class 3 (RAM), or class 5 (EEPROM) with ``save``."""

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

    ``expected_item`` is the monitor that F6.12 is known to select; without it the reply's data mean nothing.
    """

    address: int
    operation: SunfarOperation
    data: int = 0
    expected_item: int | None = None
    frame_class: ClassVar[int] = 4


SunfarRequest = ReadIdentity | ReadMonitor | SunfarReadParameter | SunfarWriteParameter | SunfarControl


@dataclass(frozen=True, slots=True)
class ReceivedRequest:
    """What a station hears: the request, and the operation that its bytes order whatever its class (T01).

    ``other_data``: set where the data read differently, nibble by nibble (T03).
    """

    request: SunfarRequest
    operation: SunfarOperation
    nibble_data: int | None = None


@dataclass(frozen=True, slots=True)
class SunfarReply:
    """A station's answer. Short replies (response 6, 7, 8) have nothing but address and response.

    ``item`` is None in a fault (``fault_code`` took its place, T05), in a reply to ``ReadIdentity`` (``info`` takes
    it), and with ``data`` in a reply to ``Control`` that did not name the expected item.
    ``info``: the six digits 7-12 of a class-0 reply; "-" for a digit that a fault may have taken.
    ``other_data``: set where the data are ambiguous: what they are if sent nibble by nibble (T03).
    """

    address: int
    response: SunfarResponse
    state: SunfarState | None = None
    group: int | None = None
    item: int | None = None
    data: int | None = None
    fault_code: int | None = None
    info: str | None = None
    nibble_data: int | None = None


class UnknownItemError(CodeError):
    """A group or item field that the class does not have: a station answers code 6."""


def error_reply(error: ProtocolError) -> SunfarReply | None:
    """What a station says to a request that it could frame but not obey; None: it keeps silent.

    A frame with a wrong head, sum or end mark, for nobody or for everybody gets no answer (section 3, first note).
    """
    address = error.params.get("address")
    if not isinstance(address, int) or not 0 <= address < BROADCAST:
        return None
    for kind, response in _ERROR_RESPONSES:
        if isinstance(error, kind):
            return SunfarReply(address, response)
    return None


_ERROR_RESPONSES: tuple[tuple[type[ProtocolError], SunfarResponse], ...] = (
    (UnknownItemError, SunfarResponse.BAD_CODE),
    (AlphabetError, SunfarResponse.BAD_ASCII),
    (CodeError, SunfarResponse.BAD_COMMAND),
)
