"""May drives of two families share one pair of wires? Decided when the bus is configured, never at transmit. Pure.

T18: bytes of one protocol may look like a frame of another. Every representative frame that would be sent to one
family is shown to the other families' station-side parsers, at every offset; any match is refused. Stops are sent
whatever this says (ruling 5).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from drivebus.errors import ConfigurationError, ProtocolError
from drivebus.message import Codec, Incomplete, StationLink

FENCES = 16
"""So many fences of a link stand for what will be sent to it, beside its polls and ``link.extra["frames"]``."""


def kind_of(codec: Codec) -> tuple[str, str]:
    """Family and encoding: two encodings of one family are as foreign to each other as two families."""
    return codec.family, codec.encoding


def frames_of(link: StationLink) -> list[bytes]:
    """Representative outgoing frames of a link."""
    requests = [link.fence(n) for n in range(FENCES)] + list(link.extra.get("frames", ()))
    return [link.codec.encode_request(request) for request in requests]


def check(link: StationLink, others: Iterable[StationLink], allow_mixed: bool) -> None:
    """Raises ConfigurationError where ``link`` must not join a bus with ``others``."""
    strangers = [other for other in others if kind_of(other.codec) != kind_of(link.codec)]
    if not strangers:
        return
    if not allow_mixed:
        first = strangers[0]
        raise ConfigurationError(
            "bus.mixed", found="/".join(kind_of(link.codec)), expected="/".join(kind_of(first.codec)),
            address=link.address, other=first.address,
        )  # fmt: skip
    for other in strangers:
        check_frames(frames_of(link), link, other)
        check_frames(frames_of(other), other, link)


def check_frames(frames: Sequence[bytes], link: StationLink, other: StationLink) -> None:
    """Raises ConfigurationError where one of ``link``'s frames contains a request of ``other``'s protocol."""
    for frame in frames:
        for offset in range(len(frame)):
            if _understood(other.codec, frame[offset:]):
                raise ConfigurationError(
                    "bus.mixed_frame", address=link.address, other=other.address, frame=frame.hex(" ").upper(),
                    offset=offset, found="/".join(kind_of(link.codec)), expected="/".join(kind_of(other.codec)),
                )  # fmt: skip


def _understood(codec: Codec, data: bytes) -> bool:
    try:
        return not isinstance(codec.decode_request(data), Incomplete)
    except ProtocolError:
        return False
