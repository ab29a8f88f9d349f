"""Check, when a bus is configured, whether stations of different protocols may share it.

Bytes of one protocol may look like a frame of another. Every representative frame to a station of one protocol is
decoded as a request of the others, at every offset; any match is rejected.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from drivebus.bus.messages import StationConfig
from drivebus.bus.unsolicited import decode_request_prefix
from drivebus.errors import ConfigurationError
from drivebus.protocols.codec import Codec

SYNC_SAMPLES = 16  # sync requests that stand for what will be sent to a station, beside ``sample_requests``


def protocol_of(codec: Codec) -> tuple[str, str]:
    """Return family and encoding: two encodings of one family are as foreign to each other as two families."""
    return codec.family, codec.encoding


def sample_frames(config: StationConfig) -> list[bytes]:
    """Return representative frames to a station."""
    requests = [*map(config.sync_request, range(SYNC_SAMPLES)), *config.sample_requests]
    return [config.codec.encode_request(request) for request in requests]


def check_compatible(config: StationConfig, others: Iterable[StationConfig], *, allow_mixed: bool) -> None:
    """Raise ConfigurationError where a station must not join a bus with ``others``."""
    foreign = [other for other in others if protocol_of(other.codec) != protocol_of(config.codec)]
    if not foreign:
        return
    if not allow_mixed:
        raise ConfigurationError(
            "bus.mixed",
            found="/".join(protocol_of(config.codec)),
            expected="/".join(protocol_of(foreign[0].codec)),
            address=config.address,
            other=foreign[0].address,
        )
    for other in foreign:
        check_no_overlap(sample_frames(config), config, other)
        check_no_overlap(sample_frames(other), other, config)


def check_no_overlap(frames: Sequence[bytes], config: StationConfig, other: StationConfig) -> None:
    """Raise ConfigurationError where a frame to ``config`` contains a request of the protocol of ``other``."""
    for frame in frames:
        for offset in range(len(frame)):
            if decode_request_prefix(other.codec, frame[offset:]) is not None:
                raise ConfigurationError(
                    "bus.mixed_frame",
                    address=config.address,
                    other=other.address,
                    frame=frame.hex(" ").upper(),
                    offset=offset,
                    found="/".join(protocol_of(config.codec)),
                    expected="/".join(protocol_of(other.codec)),
                )
