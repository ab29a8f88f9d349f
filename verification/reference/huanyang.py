"""Huanyang HY protocol, read a second time: LinuxCNC hy_comm.c (056edd9a), FluidNC Huanyang.cpp (f2b308f2), recorded
frames (unininu.tistory.com/288), Holip HLP-C+ manual, pages 73 and 74.

    address · function · length · data · CRC-16, low byte first

hy_comm.c has one length for each function and takes a shorter reply by its length byte; the recorded drive answers
parameters of one byte with length 2. FluidNC reads a status with two zero bytes more.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from verification.reference.frame_shapes import ANY, Bytes, FrameShape, literal_places
from verification.reference.modbus import reference_crc

READ, WRITE, CONTROL, STATUS, FREQUENCY = 1, 2, 3, 4, 5
REQUEST_LENGTHS = {READ: {3}, WRITE: {2, 3}, CONTROL: {1}, STATUS: {1, 3}, FREQUENCY: {2}}
REPLY_LENGTHS = {READ: {2, 3}, WRITE: {2, 3}, CONTROL: {1}, STATUS: {3}, FREQUENCY: {2}}
NUMBERED = (READ, WRITE, STATUS)
"""Functions whose first data byte is a parameter or a status item."""
HIGHEST_ADDRESS, HIGHEST_ITEM = 250, 7
REJECTION = 128


class HuanyangFields(NamedTuple):
    """Address, function and data of a frame."""

    address: int
    function: int
    data: bytes

    @property
    def value(self) -> int:
        """Number after the parameter or item, or the whole data of other functions."""
        return int.from_bytes(self.data[self.function in NUMBERED :])


@dataclass(frozen=True, slots=True)
class HuanyangReference:
    """Reference codec."""

    marks: int = 0
    """Bytes at a frame's end that are always the same."""
    address: ClassVar[slice] = slice(0, 1)
    """Place of the address in a frame."""

    def parse_request(self, sent: bytes) -> HuanyangFields:
        """Return the fields of a request. Raises ValueError for what the sources do not define."""
        if self.accepted_size(b"", sent) != len(sent):
            raise ValueError(f"no request of a HY drive: {sent.hex(' ')}")
        return HuanyangFields(sent[0], sent[1], sent[3:-2])

    def parse_reply(self, sent: bytes, received: bytes) -> HuanyangFields | None:
        """Return the fields of the reply to this request; None where it is none, or a rejection."""
        if self.accepted_size(sent, received) != len(received) or received[1] >= REJECTION:
            return None
        return HuanyangFields(received[0], received[1], received[3:-2])

    def accepted_size(self, sent: bytes, received: bytes) -> int | None:
        """Return how many bytes of ``received`` are the reply to ``sent`` (or, with nothing sent, a request); None:
        none."""
        if len(received) < 3:
            return None
        size = received[2] + 5
        if len(received) < size or reference_crc(received[:size]):
            return None
        fits = _is_reply(sent, received[: size - 2]) if sent else _is_request(received[: size - 2])
        return size if fits else None

    def is_well_formed(self, frame: bytes) -> bool:
        """Return whether length and check are right; the fields may hold anything."""
        return len(frame) > 5 and frame[2] + 5 == len(frame) and reference_crc(frame) == 0

    def reseal(self, frame: bytes) -> bytes:
        """Return the frame with a correct check; unchanged where it is too short."""
        if len(frame) < 3:
            return frame
        check = reference_crc(frame[:-2])
        return frame[:-2] + bytes((check % 256, check // 256))

    def shapes(self, sent: bytes) -> tuple[FrameShape, ...]:
        """Return the shapes of all valid replies to ``sent``, or of all valid requests."""
        forms = _reply_forms(sent) if sent else _request_forms()
        return tuple(FrameShape((*form, ANY, ANY), range(len(form), len(form) + 2), "crc") for form in forms)


def _is_request(body: bytes) -> bool:
    address, function, length = body[:3]
    if address > HIGHEST_ADDRESS or length not in REQUEST_LENGTHS.get(function, ()):
        return False
    return function != STATUS or body[3] <= HIGHEST_ITEM


def _is_reply(sent: bytes, body: bytes) -> bool:
    address, function, length = body[:3]
    if sent[0] == 0 or address != sent[0]:  # a broadcast has no reply
        return False
    if function == sent[1] + REJECTION:
        return length == 1 and (sent[1] not in (READ, WRITE) or body[3] == sent[3])
    if function != sent[1] or length not in REPLY_LENGTHS[function]:
        return False
    if function in NUMBERED:
        return body[3] == sent[3]
    return function == CONTROL or body[3:] == sent[3:-2]


def _reply_forms(sent: bytes) -> Iterator[tuple[Bytes, ...]]:
    if sent[0] == 0:
        return
    address, function = literal_places(sent[:1]), sent[1]
    number = literal_places(sent[3:4])
    yield *address, *literal_places(bytes((function + REJECTION, 1))), *(number if function < CONTROL else (ANY,))
    for length in sorted(REPLY_LENGTHS[function]):
        head = (*address, *literal_places(bytes((function, length))))
        if function in NUMBERED:
            yield *head, *number, *(ANY,) * (length - 1)
        else:
            yield *head, *((ANY,) if function == CONTROL else literal_places(sent[3:-2]))


def _request_forms() -> Iterator[tuple[Bytes, ...]]:
    address, items = frozenset(range(HIGHEST_ADDRESS + 1)), frozenset(range(HIGHEST_ITEM + 1))
    for function, lengths in REQUEST_LENGTHS.items():
        for length in sorted(lengths):
            first = items if function == STATUS else ANY
            yield address, *literal_places(bytes((function, length))), first, *(ANY,) * (length - 1)
