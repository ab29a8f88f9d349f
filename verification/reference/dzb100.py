"""DZB100 protocol, read a second time from the manual: plain, and sharing no line with ``drivebus``.

Sections are the manual's. Where it contradicts itself or is silent: the head of a read is R (the text prints P,
example 3 prints R), Q is padded with 0000 like that R, and B of a C reply may be 06 (example 1) as well as X0 to X8.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from verification.reference.frame_shapes import Bytes, FrameShape, literal_places

FRAME_SIZE = 11
DECIMAL = b"0123456789"
DIGITS = b"0123456789ABCDEF"
"""Section 2 (4)."""
HEADS: Mapping[str, int] = {"control": 0x43, "write": 0x50, "read": 0x52, "query": 0x51}
"""Section 2 (5)."""
KINDS = {head: kind for kind, head in HEADS.items()}
CONSTANT = 0x03
"""S, "checksum 03H": the same in every frame."""
TO_ONE, TO_ALL = 0x01, 0x02
"""A of a request."""
RIGHT, WRONG = 0x06, 0x07
"""B of a reply."""
COMMANDS: Mapping[int, str] = {
    0: "stop",
    1: "forward",
    2: "stop",
    3: "reverse",
    4: "jog forward",
    5: "jog forward",
    6: "jog reverse",
    7: "jog reverse",
    8: "reset",
}
"""MM of C, and B of its reply: X0 to X8."""
FAULTS = tuple(f"{number:02d}" for number in range(21))
"""CD of Q03, as printed: decimal. The manual does not say whether the tenth is sent as 10 or as 0A."""
ACCEPTED_STATES = bytes(range(9)) + b"012345678"
"""B of a C reply as drivebus accepts it: X is 0 or 3, a number or its ASCII digit (T20)."""


@dataclass(frozen=True, slots=True)
class Dzb100Reference:
    """Reference codec."""

    marks: int = 0
    """Bytes at a frame's end that are always the same."""
    address: ClassVar[slice] = slice(3, 5)
    """Place of the address in a frame."""

    # --- building ---------------------------------------------------------------------------------------------------

    def build(self, kind: str, address: int, number: int, data: int = 0) -> bytes:
        """Return a request; ``number`` is MM or NN. Raises ValueError for what the manual does not define."""
        if not 0 <= address <= 31:
            raise ValueError("UU: 00 to 31")
        if address == 0 and kind != "control":
            raise ValueError("A: only C lists 02, all drives; 0 is the broadcast address (section 2.1)")
        if kind == "control" and number not in COMMANDS:
            raise ValueError("MM: X0 to X8; X is not defined, so 0")
        if kind in ("write", "read") and not 0 <= number <= 80:
            raise ValueError("NN: 00 to 80")
        if kind == "query" and number not in (0, 1, 2, 3):
            raise ValueError("NN of Q: X0 to X3; X is not defined, so 0")
        if kind in ("read", "query") and data != 0:
            raise ValueError("R and Q carry no data: 0000")
        return self._frame(kind, TO_ONE if address else TO_ALL, address, number, data)

    def build_reply(self, kind: str, b: int, address: int, number: int, data: int) -> bytes:
        """Return a reply of a drive. Nothing is checked: undefined numbers can be sent too."""
        return self._frame(kind, b, address, number, data)

    def _frame(self, kind: str, mark: int, address: int, number: int, data: int) -> bytes:
        if not 0 <= data <= 0xFFFF:
            raise ValueError("four hexadecimal digits")
        head = bytes((HEADS[kind], CONSTANT, mark))
        return head + self.two_decimal(address) + self.two_decimal(number) + b"%04X" % data

    def two_decimal(self, number: int) -> bytes:
        """Return UU, MM or NN. Raises ValueError for more than two digits."""
        if not 0 <= number <= 99:
            raise ValueError("two decimal digits")
        return b"%02d" % number

    def reseal(self, frame: bytes) -> bytes:
        """Return the frame with its constant; there is no checksum."""
        return frame[:1] + bytes((CONSTANT,)) + frame[2:] if len(frame) > 1 else frame

    # --- reading ----------------------------------------------------------------------------------------------------

    def parse_request(self, sent: bytes) -> tuple[str, int, int, int]:
        """Return kind, address, number (MM or NN) and data of a request. Raises ValueError for what the manual does not
        define."""
        if self.accepted_size(b"", sent) != len(sent):
            raise ValueError(f"no request of the DZB100: {sent.hex(' ')}")
        return KINDS[sent[0]], int(sent[3:5]), int(sent[5:7]), int(sent[7:11], 16)

    def decode_reply(self, sent: bytes, received: bytes) -> dict[str, Any] | None:
        """Return what the reply to this request means by the manual's letter; None where it knows no such reply."""
        kind, b = KINDS[sent[0]], received[2] if len(received) > 2 else 0
        known = b & 15 in COMMANDS if kind == "control" else b in (RIGHT, WRONG)
        if len(received) != FRAME_SIZE or not known or not _echoes(sent, received):
            return None
        number, data = int(received[5:7]), int(received[7:11], 16)
        result = {RIGHT: "right", WRONG: "wrong"}.get(b, b % 16)
        meaning = {"kind": kind, "address": int(received[3:5]), "number": number, "result": result, "data": data}
        if kind == "query" and number == 3 and b == RIGHT:
            fault = received[9:11].decode()
            if data >> 12 not in COMMANDS or fault not in FAULTS:
                return None  # NN = 03: A is the run command, 0 to 8; CD is 00 to 20
            meaning |= {"command": data >> 12, "state_digit": data >> 8 & 15, "fault_code": FAULTS.index(fault)}
        return meaning

    def accepted_size(self, sent: bytes, received: bytes) -> int | None:
        """Return 11 where ``got`` begins with a reply to ``sent`` (or, with nothing sent, with a request); else None.

        What a state word says is not read here.
        """
        if len(received) < FRAME_SIZE or not _has_valid_digits(received):
            return None
        accepted = _is_marked_reply(received) and _echoes(sent, received) if sent else _is_request(received)
        return FRAME_SIZE if accepted else None

    def is_well_formed(self, frame: bytes) -> bool:
        """Return whether head, marks and digits are those of a reply."""
        return len(frame) == FRAME_SIZE and _is_marked_reply(frame) and _has_valid_digits(frame)

    # --- shapes -----------------------------------------------------------------------------------------------------

    def shapes(self, sent: bytes) -> tuple[FrameShape, ...]:
        """Return the shapes of all valid replies to ``sent``, or of all valid requests."""
        if sent[3:5] == b"00":
            return ()
        places = (_reply_places(sent), _rejection_places(sent)) if sent else _request_places()
        return tuple(FrameShape(place, range(0), "none") for place in places)


def _has_valid_digits(received: bytes) -> bool:
    if received[0] not in KINDS or received[1] != CONSTANT:
        return False
    return all(digit in DECIMAL for digit in received[3:7]) and all(digit in DIGITS for digit in received[7:11])


def _is_request(received: bytes) -> bool:
    known = received[2] == TO_ONE or (received[2] == TO_ALL and received[0] == HEADS["control"])
    return known and received[3:5] <= b"31" and (received[0] != HEADS["control"] or received[6] <= ord("8"))


def _is_marked_reply(received: bytes) -> bool:
    return received[2] in (RIGHT, WRONG) or (received[0] == HEADS["control"] and received[2] in ACCEPTED_STATES)


def _echoes(sent: bytes, received: bytes) -> bool:
    """Return whether a reply repeats head, address, number and, where something was set and not rejected, the data.

    A broadcast has no reply (section 2).
    """
    if sent[2] == TO_ALL or not _has_valid_digits(received) or received[0] != sent[0] or received[3:7] != sent[3:7]:
        return False
    return received[2] == WRONG or KINDS[received[0]] in ("read", "query") or received[7:11] == sent[7:11]


def _reply_places(sent: bytes) -> tuple[Bytes, ...]:
    marks = frozenset((RIGHT,)) if sent[0] != HEADS["control"] else frozenset(ACCEPTED_STATES) - {WRONG}
    data = (frozenset(DIGITS),) * 4 if KINDS[sent[0]] in ("read", "query") else literal_places(sent[7:11])
    return (*literal_places(sent[:2]), marks, *literal_places(sent[3:7]), *data)


def _rejection_places(sent: bytes) -> tuple[Bytes, ...]:
    head = literal_places(sent[:2] + bytes((WRONG,)) + sent[3:7])
    return (*head, *(frozenset(DIGITS),) * 4)


def _request_places() -> tuple[tuple[Bytes, ...], ...]:
    digit, data = frozenset(DECIMAL), (frozenset(DIGITS),) * 4
    address = (frozenset(b"0123"), digit)
    return (
        (*literal_places(b"C\x03"), frozenset((TO_ONE, TO_ALL)), *address, digit, frozenset(b"012345678"), *data),
        (frozenset(b"PRQ"), *literal_places(b"\x03\x01"), *address, digit, digit, *data),
    )
