"""C320 protocol, read a second time from the manual: plain, and sharing no line with ``drivebus``.

Section numbers are the manual's. Three points are deduced from its frames: hex fields are packed to the right although
4.5 and 4.6 print nibbles, ASCII digits above 9 are the letters A to F although 4.5 prints 3AH, and digits 7 and 8 of a
class-0 reply may be one fault code while the drive is in a fault.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import ClassVar

from verification.reference.frame_shapes import ANY, REMEMBERED_REQUESTS, Bytes, FrameShape, literal_places

BROADCAST = 31
"""2.4.2: addresses are 0 to 30; 31 is every drive."""
OPERATIONS: Mapping[int, str] = {
    0x00: "none",
    0x01: "run forward",
    0x02: "run reverse",
    0x03: "stop",
    0x04: "jog forward",
    0x05: "jog reverse",
    0x06: "jog stop",
    0x10: "set frequency",
    0x11: "run forward with frequency",
    0x12: "run reverse with frequency",
    0x13: "stop with frequency",
    0x14: "jog forward with frequency",
    0x15: "jog reverse with frequency",
    0x16: "jog stop with frequency",
    0x20: "fault reset",
    0x21: "emergency stop",
}
"""2.4.4, without the reserved 30H and 31H."""
RESPONSES: Mapping[int, str] = {
    0: "ok",
    1: "value out of range",
    2: "not while running",
    3: "password",
    4: "reserved or hidden parameter",
    6: "bad code or address",
    7: "illegal ascii character",
    8: "illegal class or operation",
}
"""2.4.5, without the reserved 5 and 9 to F."""
SHORT_RESPONSES = (6, 7, 8)
"""2.4.5: replies of 11 bytes; all others have 18."""
STATES: Mapping[int, str] = {
    0x00: "dc bus not ready",
    0x01: "running forward",
    0x02: "running reverse",
    0x03: "stopped",
    0x04: "jogging forward",
    0x05: "jogging reverse",
    0x11: "accelerating forward",
    0x12: "accelerating reverse",
    0x13: "restarting after a short stop",
    0x14: "decelerating forward",
    0x15: "decelerating reverse",
    0x16: "dc braking",
    0x20: "fault",
    0x21: "emergency stop",
}
"""2.4.6, without the reserved 06H and 10H."""
FAULT = 0x20
READ, CONTROL, WRITE, SHORT = (2, 1, 2, 1, 2), (2, 1, 2, 4), (2, 1, 2, 1, 2, 4), (2, 1, 2)
"""Digits of each field: address, class or response, operation or state, then group, item and data as far as present."""
IDENTITY = (2, 1, 2, 1, 1, 1, 4)
"""Section 3 (1): digits 7 and 8 of a class-0 reply are two single digits (4.1 in hex: ``04 00``)."""
REQUEST_FIELDS = {0: READ, 1: READ, 2: READ, 3: WRITE, 4: CONTROL, 5: WRITE}
FIELDS_BY_LENGTH = {11: SHORT, 14: READ, 15: CONTROL, 18: WRITE}
CAPITALS = b"0123456789ABCDEF"

ParsedFields = tuple[list[int], int | None]
"""Numbers of the fields; the second one is the data read nibble by nibble where nothing in the frame decides (T03)."""
ShapeField = tuple[int, Sequence[int] | None]
"""Width, and the numbers that the field may hold; None: any word."""


@dataclass(frozen=True, slots=True)
class SunfarReference:
    """Reference codec of one encoding.

    ``tolerant``: in ASCII, a-f and 3AH-3FH count as digits (T02); in hex, frames of one nibble a byte count (T03).
    """

    encoding: str
    tolerant: bool = False
    marks: int = 1
    """Bytes at a frame's end that are always the same."""
    address: ClassVar[slice] = slice(1, 3)
    """Place of the address in a frame."""

    @property
    def head(self) -> int:
        return ord("*") if self.encoding == "ascii" else ord("Z")

    # --- building ---------------------------------------------------------------------------------------------------

    def build(self, address: int, kind: int, operation: int = 0, group: int = 0, item: int = 0, data: int = 0) -> bytes:
        """Return a request. Raises ValueError for what the manual does not define."""
        if not 0 <= address <= BROADCAST:
            raise ValueError("2.4.2: address")
        if kind not in REQUEST_FIELDS:
            raise ValueError("2.4.3: class 6 to F is reserved")
        if operation not in OPERATIONS:
            raise ValueError("2.4.4: operation")
        if not 0 <= group <= 15 or not 0 <= item <= 255 or not 0 <= data <= 65535:
            raise ValueError("2.3: a digit too many")
        if kind == 0 and item != 0:
            raise ValueError("3 (1): digits 7 and 8 are 0; 4 to F of digit 6 are reserved, but listed with an answer")
        if kind in (1, 4) and group != 0:
            raise ValueError("3 (2), (5): digit 6 of class 1 is 0, class 4 has none")
        if kind == 4 and item != 0:
            raise ValueError("3 (5): class 4 has no item")
        if kind in (0, 1, 2) and data != 0:
            raise ValueError("3 (1) to (3): no data")
        numbers = (address, kind, operation, data) if kind == 4 else (address, kind, operation, group, item, data)
        return self._frame(REQUEST_FIELDS[kind], numbers)

    def build_reply(self, address: int, response: int, state: int, group: int, item: int, data: int) -> bytes:
        """Return a reply of a drive (2.3.2). Nothing is checked: reserved numbers can be sent too."""
        widths = SHORT if response in SHORT_RESPONSES else WRITE
        return self._frame(widths, (address, response, state, group, item, data))

    def build_identity(
        self, address: int, response: int, state: int, group: int, digit_7: int, digit_8: int, data: int
    ) -> bytes:
        """Return a reply to class 0."""
        return self._frame(IDENTITY, (address, response, state, group, digit_7, digit_8, data))

    def _frame(self, widths: tuple[int, ...], numbers: Sequence[int]) -> bytes:
        fields = [self.write_field(width, number) for width, number in zip(widths, numbers, strict=False)]
        return self.seal(b"".join(fields))

    def write_field(self, digits: int, number: int) -> bytes:
        """Return a field. ASCII: one character a digit; hex: packed to the right, zeros before it (2.3 (2))."""
        if self.encoding == "ascii":
            return bytes(CAPITALS[(number >> 4 * place) & 15] for place in reversed(range(digits)))
        return number.to_bytes(digits, "big")

    def seal(self, fields: bytes) -> bytes:
        """Return the frame of these fields: header, fields, sum, end (2.4.1, 2.4.7, 2.4.8)."""
        return bytes((self.head,)) + fields + self.write_field(4, sum(fields)) + b"\r"

    def reseal(self, frame: bytes) -> bytes:
        """Return the frame with the right sum and end mark, in capitals or packed."""
        return frame[:1] + self.seal(frame[1:-5])[1:]

    # --- reading ----------------------------------------------------------------------------------------------------

    def parse_request(self, sent: bytes) -> list[int]:
        """Return the fields of a request: address, class, operation, then group, item and data as far as present.

        Raises ValueError for what the manual does not define; ``tolerant`` does not apply, as we send no such frames.
        """
        return _parse_request(SunfarReference(self.encoding), sent)

    def decode_reply(self, sent: bytes, received: bytes) -> dict[str, int] | None:
        """Return what the reply to this request means; None where the manual knows no such reply."""
        request = self.parse_request(sent)
        size = self._reply_size(request, received)
        if size != len(received):
            return None
        return self._reply_meaning(request, received)

    def accepted_size(self, sent: bytes, received: bytes) -> int | None:
        """Return how many bytes of ``received`` are the reply to ``sent`` (or, with nothing sent, a request); None:
        none."""
        if len(received) < 11 or received[0] != self.head:
            return None
        if sent:
            request = self.parse_request(sent)
            size = self._reply_size(request, received)
            return None if size is None or self._reply_meaning(request, received[:size]) is None else size
        widths = REQUEST_FIELDS.get(self.digit(received[3]))
        if widths is None or len(received) < sum(widths) + 6:
            return None
        frame = received[: sum(widths) + 6]
        return len(frame) if _is_request(self._read(frame, widths)) else None

    def is_well_formed(self, frame: bytes) -> bool:
        """Return whether end mark, digits and sum are right; the fields may hold anything."""
        widths = FIELDS_BY_LENGTH.get(len(frame))
        return widths is not None and frame[0] == self.head and self._read(frame, widths) is not None

    def _reply_size(self, request: list[int], received: bytes) -> int | None:
        """Return the size that the response code gives a reply (2.4.5)."""
        if len(received) < 11 or received[0] != self.head:
            return None
        response = self.digit(received[3])
        if response not in RESPONSES:
            return None
        size = 11 if response in SHORT_RESPONSES else 18
        return size if len(received) >= size else None

    def _reply_meaning(self, request: list[int], frame: bytes) -> dict[str, int] | None:
        if request[0] == BROADCAST:
            return None  # 2.2: a broadcast has no reply
        if len(frame) == 11:
            return self._short_meaning(request, frame)
        if request[1] == 0:
            return self._identity_meaning(request, frame)
        found = self._read(frame, WRITE)
        return None if found is None else _full_meaning(request, *found)

    def _short_meaning(self, request: list[int], frame: bytes) -> dict[str, int] | None:
        """Read a short reply: after the response come two zeros and the checksum (2.4.5)."""
        found = self._read(frame, SHORT)
        if found is None or found[0][0] != request[0] or found[0][2] != 0:
            return None
        return {"address": request[0], "response": found[0][1]}

    def _identity_meaning(self, request: list[int], frame: bytes) -> dict[str, int] | None:
        """Section 3 (1); 2.4.6: digits 7 and 8 may be the fault code, a number of two digits: neither is returned."""
        found = self._read(frame, IDENTITY)
        one_number = self._read(frame, WRITE) if found is None else None
        if one_number is not None and one_number[0][2] == FAULT:
            found = one_number
        if found is None:
            return None
        (address, response, state, group, *digits), data = found[0][:-1], found[0][-1]
        if address != request[0] or state not in STATES or group != request[3]:
            return None
        meaning = {"address": address, "response": response, "state": state, "group": group, "data": data}
        if state != FAULT:
            meaning |= {"digit_7": digits[0], "digit_8": digits[1]}
        return meaning

    def digit(self, byte: int) -> int:
        """Return 0-15, or -1 where the byte is no digit."""
        if self.encoding == "hex":
            return byte if byte < 16 else -1
        if self.tolerant and byte in b"abcdef":
            return byte - ord("a") + 10
        if self.tolerant and 0x3A <= byte <= 0x3F:
            return byte - 0x30
        return CAPITALS.find(byte)

    def _digits(self, text: bytes) -> int:
        """Return the number that these digits write, or -1."""
        number = 0
        for byte in text:
            digit = self.digit(byte)
            if digit < 0:
                return -1
            number = number * 16 + digit
        return number

    def _read(self, frame: bytes, widths: tuple[int, ...]) -> ParsedFields | None:
        """Return the fields where end mark, sum and digits are right (2.4.7, 2.4.8)."""
        total, check = sum(frame[1:-5]), frame[-5:-1]
        if frame[-1] != 13:
            return None
        if self.encoding == "hex" and int.from_bytes(check, "big") == total:
            return _mixed(_split(frame, widths)) if self.tolerant else _packed(_split(frame, widths))
        if (self.encoding == "ascii" or self.tolerant) and self._digits(check) == total:
            numbers = [self._digits(text) for text in _split(frame, widths)]
            return None if -1 in numbers else (numbers, None)
        return None

    # --- shapes -----------------------------------------------------------------------------------------------------

    def shapes(self, sent: bytes) -> tuple[FrameShape, ...]:
        """Return the shapes of all valid replies to ``sent``, or of all valid requests.

        Codes and states count digit by digit, so the shapes allow some frames more than there are.
        """
        all_fields = _reply_fields(tuple(self.parse_request(sent))) if sent else _request_fields()
        return tuple(self._shape(fields) for fields in all_fields)

    def _shape(self, fields: Sequence[ShapeField]) -> FrameShape:
        places = [place for field in (*fields, (4, None)) for place in _places(self, *field)]
        check = range(len(places) - 3, len(places) + 1)
        spellings = (1, 1) if not self.tolerant else (3**4, 3) if self.encoding == "ascii" else (2, 2)
        return FrameShape(
            (*literal_places(bytes((self.head,))), *places, *literal_places(b"\r")), check, "sum", *spellings
        )


@lru_cache(maxsize=REMEMBERED_REQUESTS)
def _parse_request(reference: SunfarReference, sent: bytes) -> list[int]:
    if reference.accepted_size(b"", sent) != len(sent):
        raise ValueError(f"no request of the C320: {sent.hex(' ')}")
    found = reference._read(sent, REQUEST_FIELDS[reference.digit(sent[3])])
    assert found is not None
    return found[0]


def _split(frame: bytes, widths: tuple[int, ...]) -> list[bytes]:
    return [frame[1 + sum(widths[:n]) : 1 + sum(widths[: n + 1])] for n in range(len(widths))]


def _packed(raw: list[bytes]) -> ParsedFields | None:
    numbers = [int.from_bytes(text, "big") for text in raw]
    fits = all(number < 16 ** len(text) for number, text in zip(numbers, raw, strict=True))
    return (numbers, None) if fits else None


def _mixed(raw: list[bytes]) -> ParsedFields | None:
    """Read each field by its own bytes; 00 00 0x 0y, which fits both forms, like the others, or packed without any."""
    kinds = [_field_spelling(text) for text in raw]
    known = {kind for kind in kinds if kind in ("packed", "nibbles")}
    for text, kind in zip(raw, kinds, strict=True):
        if (kind == "nibbles" or len(text) == 1) and max(text) > 15:
            return None
    numbers = [
        _nibbles(text) if kind == "nibbles" else int.from_bytes(text, "big")
        for text, kind in zip(raw, kinds, strict=True)
    ]
    if "open" not in kinds:
        return numbers, None
    other = _nibbles(raw[kinds.index("open")])
    if known == {"nibbles"}:
        numbers[kinds.index("open")] = other
    return numbers, None if len(known) == 1 else other


def _field_spelling(text: bytes) -> str:
    half = len(text) // 2
    if half and any(text[:half]):
        return "nibbles"
    if half and max(text[half:]) > 15:
        return "packed"
    return "open" if len(text) == 4 and text[2] else "alike"


def _nibbles(text: bytes) -> int:
    if len(text) == 1:
        return text[0]
    return sum(byte << 4 * place for place, byte in enumerate(reversed(text)))


def _is_request(found: ParsedFields | None) -> bool:
    if found is None:
        return False
    address, kind, operation, *rest = found[0]
    if address > BROADCAST or operation not in OPERATIONS:
        return False
    return not ((kind == 0 and rest[1]) or (kind == 1 and rest[0]))


def _full_meaning(request: list[int], found: list[int], other: int | None) -> dict[str, int] | None:
    """Return what a reply of 18 bytes to class 1 to 5 means (2.3.2, section 3 (2) to (5))."""
    address, response, state, group, item, data = found
    if address != request[0] or state not in STATES or group != (0 if request[1] == 4 else request[3]):
        return None
    meaning = {"address": address, "response": response, "state": state, "group": group}
    if state == FAULT:
        meaning["fault_code"] = item  # 2.4.6: digits 7 and 8 are the fault code (T05)
    elif request[1] != 4 and item != request[4]:
        return None
    else:
        meaning["item"] = item  # F6.12 chooses the item of class 4
    if request[1] in (3, 5):
        if response == 0 and request[5] not in (data, other):
            return None  # 3 (4): digits 9 to 12 are the data that was set
        if response != 0 and data != 0:
            return None  # 3 (4), note: 0000 where the order can't be carried out (T21)
    meaning["data"] = data
    return meaning


@cache
def _digit_spellings(reference: SunfarReference) -> tuple[Bytes, ...]:
    return tuple(frozenset(byte for byte in range(256) if reference.digit(byte) == digit) for digit in range(16))


def _places(reference: SunfarReference, width: int, numbers: Sequence[int] | None) -> list[Bytes]:
    return _cached_places(reference, width, None if numbers is None else tuple(numbers))


@cache
def _cached_places(reference: SunfarReference, width: int, numbers: tuple[int, ...] | None) -> list[Bytes]:
    digits = [{number >> 4 * n & 15 for number in numbers or ()} or set(range(16)) for n in reversed(range(width))]
    spellings = _digit_spellings(reference)
    nibbles = [frozenset().union(*(spellings[digit] for digit in place)) for place in digits]
    if reference.encoding == "ascii":
        return nibbles
    free = [{0}, {0}, set(ANY), set(ANY)]
    octets = [{number >> 8 * n & 255 for number in numbers or ()} or free[-1 - n] for n in reversed(range(width))]
    return [
        frozenset(octet) | (nibble if reference.tolerant else frozenset())
        for octet, nibble in zip(octets, nibbles, strict=True)
    ]


def _reply_fields(request: tuple[int, ...]) -> Iterator[tuple[ShapeField, ...]]:
    """Yield the fields of all replies to a request with these fields."""
    address, kind = (2, request[:1]), request[1]
    if request[0] == BROADCAST:
        return
    yield address, (1, SHORT_RESPONSES), (2, (0,))
    states, any_item = tuple(STATES), (2, range(256))
    head, group = (address, (1, range(5)), (2, states)), (1, request[3:4])
    if kind == 4:
        yield *head, (1, (0,)), any_item, (4, None)
    elif kind == 0:
        yield *head, group, (1, range(16)), (1, range(16)), (4, None)
        yield address, (1, range(5)), (2, (FAULT,)), group, any_item, (4, None)
    else:
        for shown, items in ((states, request[4:5]), ((FAULT,), range(256))):
            if kind in (1, 2):
                yield address, (1, range(5)), (2, shown), group, (2, items), (4, None)
            else:
                yield address, (1, (0,)), (2, shown), group, (2, items), (4, request[5:])
                yield address, (1, range(1, 5)), (2, shown), group, (2, items), (4, (0,))


def _request_fields() -> Iterator[tuple[ShapeField, ...]]:
    """Yield the fields of all requests."""
    address, operation, digit, octet = (2, range(32)), (2, tuple(OPERATIONS)), (1, range(16)), (2, range(256))
    yield address, (1, (0,)), operation, digit, (2, (0,))
    yield address, (1, (1,)), operation, (1, (0,)), octet
    yield address, (1, (2,)), operation, digit, octet
    yield address, (1, (3, 5)), operation, digit, octet, (4, None)
    yield address, (1, (4,)), operation, (4, None)
