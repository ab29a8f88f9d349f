"""Export of a capture for Wireshark (pcapng, see docs/how-to/wireshark.md), with each frame in a UDP datagram.

Wireshark's Modbus RTU dissector learns the direction of a frame only from UDP ports; in a serial encapsulation it
guesses, and leaves functions 05, 06 and 08 undecoded. Ports and addresses of the datagram (those for documentation,
RFC 5737) therefore name sender and receiver; the octets of the frame are unchanged.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from struct import pack
from typing import Final

from drivebus.capture import pcapng
from drivebus.capture.dbcap import Capture, CaptureError
from drivebus.commissioning.decode.framing import CapturedFrame

MODBUS_PORT: Final = 50502
"""UDP port of a Modbus RTU station; given to Wireshark with ``mbrtu.udp.port``."""
OTHER_PORT: Final = 50501
"""UDP port of a station of another protocol."""
MASTER_PORT: Final = 50500
WIRESHARK_OPTIONS: Final = f"-o mbrtu.udp.port:{MODBUS_PORT} -o mbrtu.crc_verification:TRUE"
"""Options with which Wireshark and tshark dissect the frames as Modbus RTU and check them."""
MAX_DATAGRAM_OCTETS: Final = 4096
"""Octets of one datagram; longer data are split."""
_MASTER: Final = bytes((198, 51, 100, 1))
_UNKNOWN_STATION: Final = bytes((198, 51, 100, 2))
"""Address of a station that the first octet of the frame does not name."""
_STATIONS: Final = bytes((192, 0, 2))
_LINKTYPE_IPV4: Final = 228
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)


def encode_wireshark(capture: Capture, frames: Sequence[CapturedFrame], comment: str = "") -> bytes:
    """Return the pcapng file. Raises CaptureError for a time beyond the range of the format."""
    header, start_us = capture.header, capture_start_us(capture) or 0
    if frames and start_us + round(frames[-1].time_s * 1e6) > pcapng.MAX_TIME_US:
        raise CaptureError("capture.export.too_late", time_s=f"{frames[-1].time_s:g}")
    interface = pcapng.PcapngInterface(_LINKTYPE_IPV4, header.port, str(header.settings), header.settings.baud)
    packets = (packet for frame in frames for packet in _packets(frame, start_us))
    return pcapng.encode(packets, interface, header.writer, comment)


def capture_start_us(capture: Capture) -> int | None:
    """Return the start of the capture in microseconds of the Unix epoch; None where the capture does not give it."""
    try:
        at = datetime.fromisoformat(capture.header.started)
    except ValueError:
        return None
    since_us = ((at if at.tzinfo else at.replace(tzinfo=UTC)) - _EPOCH) // timedelta(microseconds=1)
    return since_us if since_us >= 0 else None


def _packets(frame: CapturedFrame, start_us: int) -> Iterator[pcapng.PcapngPacket]:
    time_us, damaged = start_us + round(frame.time_s * 1e6), frame.line_errors > 0
    for at in range(0, max(1, len(frame.data)), MAX_DATAGRAM_OCTETS):
        data = _datagram(frame, frame.data[at : at + MAX_DATAGRAM_OCTETS])
        yield pcapng.PcapngPacket(time_us, data, frame.received, damaged, () if at else frame.events)


def _datagram(frame: CapturedFrame, data: bytes) -> bytes:
    """Return the IPv4 packet around the octets, from the master or to it."""
    station = _STATIONS + frame.data[:1] if frame.modbus and frame.data else _UNKNOWN_STATION
    port = MODBUS_PORT if frame.modbus else OTHER_PORT
    ports, addresses = (MASTER_PORT, port), (_MASTER, station)
    order = 1 if frame.from_master else -1
    udp = pack(">4H", *ports[::order], 8 + len(data), 0) + data
    head, ends = pack(">2B3H2B", 0x45, 0, 20 + len(udp), 0, 0, 64, 17), b"".join(addresses[::order])
    return head + _ipv4_checksum(head + ends) + ends + udp


def _ipv4_checksum(octets: bytes) -> bytes:
    """Return the checksum of an IPv4 header without its checksum field (RFC 791, 3.1)."""
    total = sum(int.from_bytes(octets[at : at + 2], "big") for at in range(0, len(octets), 2))
    total = (total & 0xFFFF) + (total >> 16)
    return (~total & 0xFFFF).to_bytes(2, "big")
