"""May drives of two families share one pair of wires? Decided when the bus is configured, never at transmit. Pure.

T18: bytes of one protocol may look like a frame of another. Every representative frame that would be sent to one
family is shown to the other families' station-side parsers, at every offset; any match is refused. Stops are sent
whatever this says (ruling 5).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from drivebus.errors import ConfigurationError, ProtocolError
from drivebus.protocols.codec import Codec, Incomplete, StationConfig

SYNC_SAMPLES = 16
"""So many fences of a link stand for what will be sent to it, beside its polls and ``link.extra["frames"]``."""


def protocol_of(codec: Codec) -> tuple[str, str]:
    """Family and encoding: two encodings of one family are as foreign to each other as two families."""
    return codec.family, codec.encoding


def sample_frames(link: StationConfig) -> list[bytes]:
    """Representative outgoing frames of a link."""
    requests = [link.sync_request(n) for n in range(SYNC_SAMPLES)] + list(link.extra.get("frames", ()))
    return [link.codec.encode_request(request) for request in requests]


def check_compatible(link: StationConfig, others: Iterable[StationConfig], allow_mixed: bool) -> None:
    """Raises ConfigurationError where ``link`` must not join a bus with ``others``."""
    strangers = [other for other in others if protocol_of(other.codec) != protocol_of(link.codec)]
    if not strangers:
        return
    if not allow_mixed:
        first = strangers[0]
        raise ConfigurationError(
            "bus.mixed",
            found="/".join(protocol_of(link.codec)),
            expected="/".join(protocol_of(first.codec)),
            address=link.address,
            other=first.address,
        )
    for other in strangers:
        check_no_overlap(sample_frames(link), link, other)
        check_no_overlap(sample_frames(other), other, link)


def check_no_overlap(frames: Sequence[bytes], link: StationConfig, other: StationConfig) -> None:
    """Raises ConfigurationError where one of ``link``'s frames contains a request of ``other``'s protocol."""
    for frame in frames:
        for offset in range(len(frame)):
            if _decodes_as_request(other.codec, frame[offset:]):
                raise ConfigurationError(
                    "bus.mixed_frame",
                    address=link.address,
                    other=other.address,
                    frame=frame.hex(" ").upper(),
                    offset=offset,
                    found="/".join(protocol_of(link.codec)),
                    expected="/".join(protocol_of(other.codec)),
                )


def _decodes_as_request(codec: Codec, data: bytes) -> bool:
    try:
        return not isinstance(codec.decode_request(data), Incomplete)
    except ProtocolError:
        return False
