"""DZB100 frames, judged (manual sections 2 and 3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from verification.codec_fuzz.reference.frame_shapes import Bytes, FrameShape, literal_places

DZB100_FRAME_SIZE = 11
DECIMAL = b"0123456789"
HEX = b"0123456789ABCDEF"
DZB100_STATES = bytes(range(9)) + b"012345678"
"""B of a C reply may be one of the states X0-X8 (T20); 06 and 07 mean what they mean everywhere."""


@dataclass(frozen=True, slots=True)
class Dzb100Reference:
    marks: int = 0
    """Bytes at a frame's end that are always the same."""
    address: ClassVar[slice] = slice(3, 5)
    """Where a frame has its address."""

    def accepted_size(self, sent: bytes, got: bytes) -> int | None:
        """11 where ``got`` begins with the reply to ``sent`` (or, with nothing sent, with a request); else None."""
        if len(got) < DZB100_FRAME_SIZE or not _has_valid_digits(got):
            return None
        return DZB100_FRAME_SIZE if (_is_reply_to(sent, got) if sent else _is_request(got)) else None

    def is_well_formed(self, frame: bytes) -> bool:
        """A reply by its heads, marks and digits, whatever they say."""
        known = frame[2] in (6, 7) or (frame[0] == ord("C") and frame[2] in DZB100_STATES)
        return known and len(frame) == DZB100_FRAME_SIZE and _has_valid_digits(frame)

    def seal(self, frame: bytes) -> bytes:
        """There is no check: S is always 03."""
        return frame[:1] + b"\x03" + frame[2:] if len(frame) > 1 else frame

    def forms(self, sent: bytes) -> tuple[FrameShape, ...]:
        """All lawful frames."""
        if sent[3:5] == b"00":
            return ()
        places = (_reply_places(sent), _refusal_places(sent)) if sent else _request_places()
        return tuple(FrameShape(each_place, range(0), "none") for each_place in places)


def _has_valid_digits(got: bytes) -> bool:
    if got[0] not in b"CPRQ" or got[1] != 3:
        return False
    return all(digit in DECIMAL for digit in got[3:7]) and all(digit in HEX for digit in got[7:11])


def _is_request(got: bytes) -> bool:
    known = got[2] == 1 or (got[2] == 2 and got[0] == ord("C"))
    return known and got[3:5] <= b"31" and (got[0] != ord("C") or got[6] <= ord("8"))


def _is_reply_to(sent: bytes, got: bytes) -> bool:
    if got[0] != sent[0] or got[3:7] != sent[3:7] or not b"01" <= got[3:5] <= b"31":
        return False
    if got[2] not in (6, 7) and not (got[0] == ord("C") and got[2] in DZB100_STATES):
        return False
    return got[2] == 7 or got[0] in b"RQ" or got[7:11] == sent[7:11]


def _reply_places(sent: bytes) -> tuple[Bytes, ...]:
    marks = frozenset((6,)) if sent[0] != ord("C") else frozenset(DZB100_STATES) - {7}
    data = (frozenset(HEX),) * 4 if sent[0] in b"RQ" else literal_places(sent[7:11])
    return (*literal_places(sent[:2]), marks, *literal_places(sent[3:7]), *data)


def _refusal_places(sent: bytes) -> tuple[Bytes, ...]:
    return (*literal_places(sent[:2]), *literal_places(b"\x07"), *literal_places(sent[3:7]), *(frozenset(HEX),) * 4)


def _request_places() -> tuple[tuple[Bytes, ...], ...]:
    address, digit, data = (frozenset(b"0123"), frozenset(DECIMAL)), frozenset(DECIMAL), (frozenset(HEX),) * 4
    return (
        (*literal_places(b"C\x03"), frozenset((1, 2)), *address, digit, frozenset(b"012345678"), *data),
        (frozenset(b"PRQ"), *literal_places(b"\x03\x01"), *address, digit, digit, *data),
    )
