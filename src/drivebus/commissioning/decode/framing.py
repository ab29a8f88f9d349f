"""Frames of a capture: its records joined to frames, with direction and sender. Times are those of the capture."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

from drivebus.capture.dbcap import BytesRecord, Capture, EventRecord
from drivebus.protocols.checksum import crc16
from drivebus.serial_settings import SerialSettings

MAX_PIECE_GAP_S: Final = 0.02
"""Longest gap within a received frame: adapters deliver bytes in pieces up to 16 ms apart."""
MIN_REPLY_BYTES: Final = 5
"""Size of the shortest reply, a Modbus RTU exception; fewer bytes after an echo are no reply."""
MIN_RTU_BYTES: Final = 4
"""Size of the shortest RTU frame: address, function, CRC."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CapturedFrame:
    """Bytes on the bus that belong together."""

    time_s: float
    """Time since the start of the capture at which the bytes were sent, or the first of them was received."""
    data: bytes
    received: bool
    from_master: bool
    """Whether the master sent it; also of the echo of what it sent."""
    line_errors: int = 0
    """Number of bytes with a parity or framing error."""
    modbus: bool = False
    """Whether the frame, or the request before it, is Modbus RTU."""
    events: tuple[str, ...] = ()
    """Other records since the preceding frame, as lines of the capture."""
    end_s: float = 0.0
    """Time of its last byte, on the clock of ``time_s``."""


def split_frames(capture: Capture, *, all_modbus: bool = False) -> list[CapturedFrame]:
    """Return the frames of a capture, in order.

    A sent frame is Modbus RTU where its CRC fits (by chance once in 65,536), and so are the frames received after it,
    damaged or not. With ``all_modbus`` every frame is.
    """
    frames: list[CapturedFrame] = []
    for exchange in _group_exchanges(_join_records(capture)):
        first = exchange[0]
        for frame in exchange if first.received else _split_echo(first, exchange[1:]):
            frames.append(replace(frame, modbus=all_modbus or _is_modbus(frame if first.received else first)))
    return frames


def _join_records(capture: Capture) -> list[CapturedFrame]:
    """Join received records with short gaps to frames; each sent record is a frame."""
    frames: list[CapturedFrame] = []
    events: list[str] = []
    settings = capture.header.settings
    for record in capture.records:
        if isinstance(record, EventRecord):
            events.append(_event_text(record))
            settings = _settings_after(record, settings)
        elif frames and not events and _continues(frames[-1], record, settings):
            last, at = frames[-1], record.time_s
            frames[-1] = replace(
                last, data=last.data + record.data, line_errors=last.line_errors + record.line_errors, end_s=at
            )
        else:
            frames.append(_new_frame(record, tuple(events)))
            events = []
    if frames and events:
        frames[-1] = replace(frames[-1], events=(*frames[-1].events, *events))
    return frames


def _new_frame(record: BytesRecord, events: tuple[str, ...]) -> CapturedFrame:
    received = record.direction == "rx"
    return CapturedFrame(
        time_s=record.time_s,
        data=record.data,
        received=received,
        from_master=not received,
        line_errors=record.line_errors,
        events=events,
        end_s=record.time_s,
    )


def _event_text(event: EventRecord) -> str:
    return json.dumps({"t": event.time_s, "event": event.name, **event.details}, ensure_ascii=False)


def _settings_after(event: EventRecord, settings: SerialSettings) -> SerialSettings:
    """Return the serial settings after an event: a scan opens the port with several."""
    if event.name != "opened":
        return settings
    try:
        return SerialSettings.parse(event.details["baud"], event.details["format"])
    except (KeyError, ValueError, TypeError, AttributeError):
        return settings


def _continues(last: CapturedFrame, record: BytesRecord, settings: SerialSettings) -> bool:
    silence_s = record.time_s - settings.seconds(len(record.data)) - last.end_s
    return last.received and record.direction == "rx" and silence_s < max(MAX_PIECE_GAP_S, settings.seconds(3.5))


def _group_exchanges(frames: list[CapturedFrame]) -> Iterator[list[CapturedFrame]]:
    """Yield each sent frame with the frames received until the next frame; earlier ones form a separate group."""
    starts = [at for at, frame in enumerate(frames) if at == 0 or not frame.received]
    for start, end in pairwise([*starts, len(frames)]):
        yield frames[start:end]


def _split_echo(sent: CapturedFrame, received: list[CapturedFrame]) -> Iterator[CapturedFrame]:
    """Separate the adapter's echo, which is the bytes just sent, if enough bytes for a reply follow it."""
    yield sent
    size = len(sent.data)
    count = sum(len(frame.data) for frame in received)
    if received and received[0].data.startswith(sent.data) and count - size >= MIN_REPLY_BYTES:
        yield replace(received[0], data=sent.data, from_master=True)
        rest = received.pop(0)
        if len(rest.data) > size:
            yield replace(rest, data=rest.data[size:], events=())
    yield from received


def _is_modbus(frame: CapturedFrame) -> bool:
    return len(frame.data) >= MIN_RTU_BYTES and crc16(frame.data) == 0
