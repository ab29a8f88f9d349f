"""Fields of frames, read from their bytes by the manuals alone: which reads are fences, what a frame carries."""

from __future__ import annotations

from verification.drive_variants import DriveVariant


def modbus_octets(kind: DriveVariant, frame: bytes) -> bytes:
    """A Modbus frame without its check."""
    return frame[:-2] if kind.encoding == "rtu" else bytes.fromhex(frame[1:-2].decode())[:-1]


def c320_field(kind: DriveVariant, frame: bytes, first: int, width: int) -> int:
    """C320 2.4: a number of so many characters, in hex frames so many bytes."""
    part = frame[first : first + width]
    return int(part, 16) if kind.encoding == "ascii" else int.from_bytes(part)


def is_sync_probe(kind: DriveVariant, frame: bytes) -> bool:
    """Ruling 2. C320: class 2 with a group; DZB100: R; VC660: FC08; DF800: two registers, which nothing else reads."""
    if kind.model == "c320":
        return c320_field(kind, frame, 3, 1) == 2 and c320_field(kind, frame, 6, 1) != 0
    if kind.model == "dzb100":
        return frame[:1] == b"R"
    words = modbus_octets(kind, frame)
    return words[1] == 8 if kind.model == "vc660" else words[1] == 3 and words[4:6] == b"\x00\x02"


def modbus_write(kind: DriveVariant, frame: bytes) -> tuple[int, int] | None:
    """Modbus: the register and value of a write."""
    words = modbus_octets(kind, frame)
    return (int.from_bytes(words[2:4]), int.from_bytes(words[4:6])) if words[1] == 6 else None


def shows_standstill(kind: DriveVariant, request: bytes, reply: bytes) -> bool | None:
    """Does this answer say that the output is off? None where it says nothing of that."""
    if kind.model == "c320":
        return c320_field(kind, reply, 4, 2) in (0x03, 0x21, 0x20, 0x00) if len(reply) == 18 else None
    if kind.model == "dzb100" and request[:1] == b"Q":
        return {b"01": reply[7:11] == b"0000", b"03": reply[7:8] in b"02"}.get(request[5:7])
    if kind.model == "vc660" and request[1] == 3 and request[2:4] == b"\x30\x00":
        return not reply[4] & 0x08
    return None


def status_read_key(kind: DriveVariant, request: bytes) -> bytes | None:
    """What names the question of a state read: equal for equal questions; None for other requests."""
    if kind.model == "c320":
        return request if c320_field(kind, request, 3, 1) == 1 else None
    if kind.model == "dzb100":
        return request if request[:1] == b"Q" and request[5:7] in (b"01", b"03") else None
    return request[2:4] if kind.model == "vc660" and request[1] == 3 and request[2:4] == b"\x30\x00" else None
