"""Mitsubishi computer link, read a second time: LinuxCNC mitsub_vfd.py (076f45c8), FR-F500 manual, page 114, FR-E500
manual, pages 102 and 103.

    ENQ · station · instruction code · waiting time · data · sum      STX · station · data · ETX · sum
    ACK · station                                                     NAK · station · error code

The sum is that of the characters between the control codes, modulo 256, as two digits. Pr.124 = 0: no CR, no LF.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from verification.reference.frame_shapes import Bytes, FrameShape, literal_places

STX, ETX, ENQ, ACK, NAK = b"\x02", b"\x03", b"\x05", b"\x06", b"\x15"
DIGITS = b"0123456789ABCDEF"
FREQUENCY, CURRENT, VOLTAGE, STATUS = "6F", "70", "71", "7A"
SET_FREQUENCY, RUN = "ED", "FA"
READS = {FREQUENCY: 4, CURRENT: 4, VOLTAGE: 4, STATUS: 2}
"""Instruction code to the digits of its reply."""
WRITES = {SET_FREQUENCY: 4, RUN: 2}
"""Instruction code to the digits of its data."""
HIGHEST_STATION = 31


class MitsubishiFields(NamedTuple):
    """Fields of a request; ``data`` is None in a read."""

    station: int
    code: str
    data: int | None


@dataclass(frozen=True, slots=True)
class MitsubishiReference:
    """Reference codec."""

    marks: int = 0
    """Bytes at a frame's end that are always the same."""
    address: ClassVar[slice] = slice(1, 3)
    """Place of the station in a frame."""

    def parse_request(self, sent: bytes) -> MitsubishiFields:
        """Return the fields of a request. Raises ValueError for what the sources do not define."""
        if self.accepted_size(b"", sent) != len(sent):
            raise ValueError(f"no request of the computer link: {sent.hex(' ')}")
        data = sent[6:-2].decode()
        return MitsubishiFields(int(sent[1:3], 16), sent[3:5].decode(), int(data, 16) if data else None)

    def parse_reply(self, sent: bytes, received: bytes) -> int | None:
        """Return the number in the reply to this read; None where it is none."""
        if self.accepted_size(sent, received) != len(received) or received[:1] != STX:
            return None
        return int(received[3:-3], 16)

    def accepted_size(self, sent: bytes, received: bytes) -> int | None:
        """Return how many bytes of ``received`` are the reply to ``sent`` (or, with nothing sent, a request); None:
        none."""
        size = _reply_size(sent, received) if sent else _request_size(received)
        if size is None or len(received) < size:
            return None
        frame = received[:size]
        fits = _is_reply(sent, frame) if sent else _is_request(frame)
        return size if fits else None

    def is_well_formed(self, frame: bytes) -> bool:
        """Return whether marks, digits and sum of a reply are right; the fields may hold anything."""
        if frame[:1] == STX:
            return len(frame) in (8, 10) and _is_data_frame(frame)
        size = {ACK: 3, NAK: 4}.get(frame[:1])
        return len(frame) == size and _are_digits(frame[1:])

    def reseal(self, frame: bytes) -> bytes:
        """Return the frame with a correct sum where it has one."""
        if len(frame) < 6 or frame[:1] in (ACK, NAK):
            return frame
        end = -3 if frame[:1] == STX else -2
        return frame[:-2] + _sum(frame[1:end])

    def shapes(self, sent: bytes) -> tuple[FrameShape, ...]:
        """Return the shapes of all valid replies to ``sent``, or of all valid requests."""
        return tuple(_reply_shapes(sent) if sent else _request_shapes())


def _sum(text: bytes) -> bytes:
    return b"%02X" % (sum(text) % 256)


def _are_digits(text: bytes) -> bool:
    return all(byte in DIGITS for byte in text)


def _is_data_frame(frame: bytes) -> bool:
    text, end, check = frame[1:-3], frame[-3:-2], frame[-2:]
    return end == ETX and _are_digits(text) and check == _sum(text)


def _request_size(received: bytes) -> int | None:
    code = received[3:5].decode("latin-1")
    if received[:1] != ENQ or (code not in READS and code not in WRITES):
        return None
    return 8 + WRITES.get(code, 0)


def _is_request(frame: bytes) -> bool:
    text, check = frame[1:-2], frame[-2:]
    return _are_digits(text) and check == _sum(text) and int(text[:2], 16) <= HIGHEST_STATION


def _reply_size(sent: bytes, received: bytes) -> int | None:
    digits = READS.get(sent[3:5].decode())
    if received[:1] == NAK:
        return 4
    if digits is None:
        return 3 if received[:1] == ACK else None
    return 6 + digits if received[:1] == STX else None


def _is_reply(sent: bytes, frame: bytes) -> bool:
    if frame[1:3] != sent[1:3]:
        return False
    return _is_data_frame(frame) if frame[:1] == STX else _are_digits(frame[3:])


def _reply_shapes(sent: bytes) -> Iterator[FrameShape]:
    station, digit = literal_places(sent[1:3]), frozenset(DIGITS)
    yield FrameShape((*literal_places(NAK), *station, digit), range(0), "none")
    digits = READS.get(sent[3:5].decode())
    if digits is None:
        yield FrameShape((*literal_places(ACK), *station), range(0), "none")
        return
    places: tuple[Bytes, ...] = (*literal_places(STX), *station, *(digit,) * digits, *literal_places(ETX), digit, digit)
    yield FrameShape(places, range(len(places) - 2, len(places)))


def _request_shapes() -> Iterator[FrameShape]:
    digit = frozenset(DIGITS)
    for code, digits in (dict.fromkeys(READS, 0) | WRITES).items():
        body = (frozenset(b"01"), digit, *literal_places(code.encode()), digit, *(digit,) * digits)
        places = (*literal_places(ENQ), *body, digit, digit)
        yield FrameShape(places, range(len(places) - 2, len(places)))
