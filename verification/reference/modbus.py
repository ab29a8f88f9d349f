"""Modbus RTU and ASCII, read a second time (Application Protocol V1.1b3, 6 and 7; Serial Line V1.02; DF800's frame
tables)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import KW_ONLY, dataclass
from functools import cache, lru_cache

from verification.reference.frame_shapes import ANY, REMEMBERED_REQUESTS, Bytes, FrameShape, literal_places

READ_LIMITS = {1: 2000, 2: 2000, 3: 125, 4: 125}
"""Function → largest number of bits or registers of one read."""
WRITE_LIMITS = {15: 1968, 16: 123}
EXCEPTIONS = (1, 2, 3, 4, 5, 6, 7, 8, 10, 11)
DIGITS = b"0123456789ABCDEF"


def reference_crc(octets: bytes) -> int:
    """Return the CRC-16 of the standard's appendix B, bit by bit."""
    register = 0xFFFF
    for octet in octets:
        register ^= octet
        for _ in range(8):
            carry = register & 1
            register >>= 1
            if carry:
                register ^= 0xA001
    return register


def _sealed_rtu(octets: bytes) -> bytes:
    check = reference_crc(octets)
    return octets + bytes((check % 256, check // 256))


def _sealed_ascii(octets: bytes) -> bytes:
    return b":" + (octets + bytes(((256 - sum(octets) % 256) % 256,))).hex().upper().encode() + b"\r\n"


@dataclass(frozen=True, slots=True)
class ModbusReference:
    """Reference codec. ``short``: the DF800's short error is valid; ``resync``: junk bytes allowed before ':' of an
    ASCII frame."""

    encoding: str
    _: KW_ONLY
    short: bool = False
    resync: int = 0
    marks: int = 0
    """Bytes at a frame's end that are always the same."""
    count_bytes: int = 1
    """Bytes of the byte count in the reply to a read."""
    rejected_read: int = 0
    """Registers of a read that exception 03 answers, as it answers no other read of registers."""

    @property
    def address(self) -> slice:
        """Place of the address in a frame."""
        return slice(0, 1) if self.encoding == "rtu" else slice(1, 3)

    def parse_request(self, sent: bytes) -> bytes:
        """Return the octets of a request without their check. Raises ValueError for what the standard lacks."""
        return _parse_request(self, sent)

    def octets(self, frame: bytes) -> bytes:
        """Return the octets of a whole frame without their check. Raises ValueError where marks, digits or check are
        wrong."""
        if not self.is_well_formed(frame):
            raise ValueError(f"no frame of Modbus {self.encoding}: {frame.hex(' ')}")
        return frame[:-2] if self.encoding == "rtu" else bytes.fromhex(frame[1:-4].decode())

    def accepted_size(self, sent: bytes, received: bytes) -> int | None:
        """Return how many bytes of ``received`` are the reply to ``sent`` (or, with nothing sent, a request); None:
        none."""
        if self.encoding == "rtu":
            return self._rtu_size(sent[:-2], received)
        junk = received[: self.resync + 1].find(b":")
        if junk < 0:
            return None
        size = self._ascii_size(_octets(sent[1:-4]) or b"", received[junk:])
        return None if size is None else junk + size

    def is_well_formed(self, frame: bytes) -> bool:
        """Return whether marks, digits and check are right; the octets may hold anything."""
        if self.encoding == "rtu":
            return reference_crc(frame) == 0
        octets = _octets(frame[1:-2]) if frame[:1] == b":" and frame[-2:] == b"\r\n" else None
        return octets is not None and sum(octets) % 256 == 0

    def reseal(self, frame: bytes) -> bytes:
        """Return the frame with a correct check; unchanged where it is too short."""
        if self.encoding == "rtu":
            return _sealed_rtu(frame[:-2]) if len(frame) > 2 else frame
        octets = _octets(frame[1:-4])
        return frame if octets is None else _sealed_ascii(octets)

    def _rtu_size(self, request: bytes, received: bytes) -> int | None:
        for octets in self._extents(request, received):
            size = octets + 2
            if len(received) >= size and received[octets:size] == reference_crc(received[:octets]).to_bytes(
                2, "little"
            ):
                if (
                    size == 5
                    and request[1] == received[1] in (5, 6, 8, 15, 16)
                    and self._echo_begins(request, received)
                ):
                    continue  # With more after them they are the echo's first five, or nothing
                return size
        return None

    def _echo_begins(self, request: bytes, received: bytes) -> bool:
        return len(received) > 5 and _sealed_rtu(request[:6])[:5] == received[:5]

    def _ascii_size(self, request: bytes, received: bytes) -> int | None:
        head = _octets(received[1:15]) or _octets(received[1:13]) or _octets(received[1:7]) or b""
        for extent in self._extents(request, head):
            size = 2 * extent + 5
            octets = _octets(received[1 : size - 2])
            if len(received) >= size and received[size - 2 : size] == b"\r\n" and octets and sum(octets) % 256 == 0:
                whole = list(self._extents(request, octets[:-1]))
                return size if extent in whole else None
        return None

    def _extents(self, request: bytes, received: bytes) -> Iterator[int]:
        """Return every length that these octets may have if their check is right."""
        if len(received) < 3:
            return iter(())
        return _reply_extents(self, request, received) if request else _request_extents(received)

    def shapes(self, sent: bytes) -> tuple[FrameShape, ...]:
        """Return the shapes of all valid replies to ``sent``, or of all valid requests."""
        if self.encoding == "rtu":
            return tuple(
                FrameShape((*octets, ANY, ANY), range(len(octets), len(octets) + 2), "crc")
                for octets in self._octet_forms(sent[:-2])
            )
        return tuple(self._ascii_form(octets) for octets in self._octet_forms(_octets(sent[1:-4]) or b""))

    def _ascii_form(self, octets: tuple[Bytes, ...]) -> FrameShape:
        text = [place for octet in octets for place in _pair(octet)]
        digit = frozenset(DIGITS)
        places = (*literal_places(b":"), *text, digit, digit, *literal_places(b"\r\n"))
        return FrameShape(places, range(len(text) + 1, len(text) + 3))

    def _octet_forms(self, request: bytes) -> Iterator[tuple[Bytes, ...]]:
        yield from _reply_forms(self, request) if request else _request_forms()


@lru_cache(maxsize=REMEMBERED_REQUESTS)
def _parse_request(reference: ModbusReference, sent: bytes) -> bytes:
    if reference.accepted_size(b"", sent) != len(sent):
        raise ValueError(f"no request of Modbus {reference.encoding}: {sent.hex(' ')}")
    return reference.octets(sent)


def _octets(digits: bytes) -> bytes | None:
    """Return the octets that upper-case digits represent; None for anything else."""
    if len(digits) % 2 or any(digit not in DIGITS for digit in digits):
        return None
    return bytes(
        DIGITS.index(high) * 16 + DIGITS.index(low) for high, low in zip(digits[::2], digits[1::2], strict=True)
    )


@cache
def _pair(octet: Bytes) -> tuple[Bytes, Bytes]:
    return frozenset(DIGITS[value // 16] for value in octet), frozenset(DIGITS[value % 16] for value in octet)


def _number(octets: bytes) -> int:
    return octets[0] * 256 + octets[1]


def _exceptions(reference: ModbusReference, request: bytes) -> tuple[int, ...]:
    """Return the exceptions that may answer a request."""
    if not reference.rejected_read or request[1] not in (3, 4):
        return EXCEPTIONS
    if _number(request[4:6]) == reference.rejected_read:
        return (3,)
    return tuple(code for code in EXCEPTIONS if code != 3)


def _is_rejected(reference: ModbusReference, request: bytes) -> bool:
    return _exceptions(reference, request) == (3,)


def _reply_extents(reference: ModbusReference, request: bytes, received: bytes) -> Iterator[int]:
    if received[0] != request[0] or not request[0]:
        return
    function = request[1]
    if received[1] == function + 128 and received[2] in _exceptions(reference, request):
        yield 3
    if received[1] != function or _is_rejected(reference, request):
        return
    if reference.short and received[2] == 0:
        yield 3
    if function in READ_LIMITS:
        count = _number(request[4:6])
        octets = 2 * count if function in (3, 4) else (count + 7) // 8
        padding = count % 8 if function in (1, 2) else 0
        head = 2 + reference.count_bytes
        size = head + octets
        if received[2:head] == octets.to_bytes(head - 2, "big") and not (
            padding and len(received) >= size and received[size - 1] >> padding
        ):
            yield size
    elif received[:6] == request[:6]:
        yield 6


def _reply_forms(reference: ModbusReference, request: bytes) -> Iterator[tuple[Bytes, ...]]:
    address, function = literal_places(request[:1])[0], request[1]
    if not request[0]:
        return
    yield address, frozenset((function + 128,)), frozenset(_exceptions(reference, request))
    if _is_rejected(reference, request):
        return
    if reference.short:
        yield address, *literal_places(bytes((function, 0)))
    if function in READ_LIMITS:
        count = _number(request[4:6])
        octets = 2 * count if function in (3, 4) else (count + 7) // 8
        count_octets = octets.to_bytes(reference.count_bytes, "big")
        yield (*literal_places(request[:2]), *literal_places(count_octets), *(ANY,) * octets)
    else:
        yield literal_places(request[:6])


def _request_extents(received: bytes) -> Iterator[int]:
    address, function = received[0], received[1]
    if address > 247 or len(received) < 6:
        return
    register, word = _number(received[2:4]), _number(received[4:6])
    fits = word >= 1 and register + word <= 65536
    if (
        (function in READ_LIMITS and fits and word <= READ_LIMITS[function])
        or function == 6
        or (function == 5 and word in (0, 0xFF00))
        or (function == 8 and register == 0)
    ):
        yield 6
    elif function in WRITE_LIMITS and fits and word <= WRITE_LIMITS[function] and len(received) > 6:
        octets = 2 * word if function == 16 else (word + 7) // 8
        padding = word % 8 if function == 15 else 0
        if received[6] == octets and not (padding and len(received) >= 7 + octets and received[6 + octets] >> padding):
            yield 7 + octets


def _request_forms() -> Iterator[tuple[Bytes, ...]]:
    address, low = frozenset(range(248)), frozenset(range(8))
    for function, high in ((1, low), (2, low), (3, frozenset((0,))), (4, frozenset((0,))), (6, ANY)):
        yield address, *literal_places(bytes((function,))), ANY, ANY, high, ANY
    yield address, *literal_places(b"\x05"), ANY, ANY, frozenset((0, 255)), frozenset((0,))
    yield address, *literal_places(b"\x08\x00\x00"), ANY, ANY
    for octets in range(1, 247):
        for function, bits in ((15, range(8 * octets - 7, 8 * octets + 1)), (16, range(octets // 2, octets // 2 + 1))):
            if bits[-1] <= WRITE_LIMITS[function] and (function == 15 or octets % 2 == 0):
                words = frozenset(bit // 256 for bit in bits), frozenset(bit % 256 for bit in bits)
                yield (
                    address,
                    *literal_places(bytes((function,))),
                    ANY,
                    ANY,
                    *words,
                    *literal_places(bytes((octets,))),
                    *(ANY,) * octets,
                )
