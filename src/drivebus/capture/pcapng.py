"""Writer of pcapng, the file format of Wireshark.

Little-endian; one section, one interface, times in microseconds of the Unix epoch. Source: the pcapng specification of
the IETF's opsawg (draft-ietf-opsawg-pcapng), 4.1 section header, 4.2 interface description, 4.3 enhanced packet.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from struct import pack
from typing import Final

MAX_TIME_US: Final = 2**64 - 1  # the time of a packet has 64 bits
_ANY_LENGTH: Final = -1
_MICROSECONDS: Final = b"\x06"
_IN, _OUT = 1, 2
_SYMBOL_ERROR: Final = 1 << 31
_MAX_TEXT_CHARACTERS: Final = 1000  # an option holds 65,535 octets


@dataclass(frozen=True, slots=True)
class PcapngInterface:
    """Interface on which the packets were captured."""

    link_type: int
    """Link type of the packets, from the registry at tcpdump.org."""
    name: str = ""
    description: str = ""
    speed_bit_s: int = 0


@dataclass(frozen=True, slots=True)
class PcapngPacket:
    """Captured packet."""

    time_us: int
    """Microseconds since the Unix epoch, 0 to ``MAX_TIME_US``."""
    data: bytes
    inbound: bool
    """Received; else sent by ourselves."""
    damaged: bool = False
    """Parity or framing error reported by the hardware."""
    comments: tuple[str, ...] = ()


def encode(packets: Iterable[PcapngPacket], interface: PcapngInterface, writer: str = "", comment: str = "") -> bytes:
    """Return the bytes of the file. Raises struct.error for a time out of range."""
    return b"".join((_section(writer, comment), _interface(interface), *map(_packet, packets)))


def _section(writer: str, comment: str) -> bytes:
    head = pack("<IHHq", 0x1A2B3C4D, 1, 0, _ANY_LENGTH)
    return _block(0x0A0D0D0A, head, _text_option(1, comment), _text_option(4, writer))


def _interface(interface: PcapngInterface) -> bytes:
    return _block(
        1,
        pack("<HHI", interface.link_type, 0, 0),
        _text_option(2, interface.name),
        _text_option(3, interface.description),
        _option(8, pack("<Q", interface.speed_bit_s)),
        _option(9, _MICROSECONDS),
    )


def _packet(packet: PcapngPacket) -> bytes:
    size, flags = len(packet.data), (_IN if packet.inbound else _OUT) | (_SYMBOL_ERROR if packet.damaged else 0)
    time_high, time_low = packet.time_us >> 32, packet.time_us & 0xFFFFFFFF
    head = pack("<5I", 0, time_high, time_low, size, size) + _padded(packet.data)
    return _block(6, head, _option(2, pack("<I", flags)), *(_text_option(1, comment) for comment in packet.comments))


def _block(kind: int, head: bytes, *options: bytes) -> bytes:
    """Return a block: type, total length, body, total length again; the options end with an empty one."""
    body = b"".join((head, *options, bytes(4)))
    size = pack("<I", len(body) + 12)
    return pack("<I", kind) + size + body + size


def _text_option(code: int, text: str) -> bytes:
    return _option(code, text[:_MAX_TEXT_CHARACTERS].encode("utf-8", "replace")) if text else b""


def _option(code: int, value: bytes) -> bytes:
    return pack("<HH", code, len(value)) + _padded(value)


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)
