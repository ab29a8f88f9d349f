"""Frames out of a capture's records: what a line carried in one piece, and who said it. Pure; time is the capture's."""

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
"""Bytes heard after a shorter silence belong together: adapters hand them over in pieces, up to 16 ms apart."""
MIN_REPLY_OCTETS: Final = 5
"""Octets (Modbus RTU's exception); fewer after an echo are no reply."""
MIN_RTU_OCTETS: Final = 4


@dataclass(frozen=True, slots=True)
class CapturedFrame:
    """Bytes of the line that belong together."""

    time_s: float
    """Since the capture began: when they were handed to the port, or the first of them came from it."""
    data: bytes
    received: bool
    from_master: bool
    """The master said it: sent, or heard as the echo of what was sent."""
    line_errors: int = 0
    """How many octets had a parity or framing error."""
    modbus: bool = False
    """It is, or answers, a frame of Modbus RTU."""
    events: tuple[str, ...] = ()
    """What else happened since the frame before, as lines of the capture."""
    ended_s: float = 0.0
    """When the last of its bytes came."""


def split_frames(capture: Capture, all_modbus: bool = False) -> list[CapturedFrame]:
    """The frames of a capture, in order.

    A frame that we sent is Modbus RTU where its CRC fits (another protocol's fits one time in 65,536), and so is what
    is heard after it, damaged or not. ``all_modbus``: so is everything.
    """
    found: list[CapturedFrame] = []
    for exchange in _group_exchanges(_join_records(capture)):
        first = exchange[0]
        for one in exchange if first.received else _split_echo(first, exchange[1:]):
            found.append(replace(one, modbus=all_modbus or _is_modbus(one if first.received else first)))
    return found


def _join_records(capture: Capture) -> list[CapturedFrame]:
    """What was sent is a frame; what was heard is one together with what came soon after it."""
    found: list[CapturedFrame] = []
    events: list[str] = []
    settings = capture.header.settings
    for record in capture.records:
        if isinstance(record, EventRecord):
            events.append(_event_text(record))
            settings = _settings_after(record, settings)
        elif found and not events and _continues(found[-1], record, settings):
            last, at = found[-1], record.time_s
            found[-1] = replace(
                last, data=last.data + record.data, line_errors=last.line_errors + record.line_errors, ended_s=at
            )
        else:
            found.append(_new_frame(record, tuple(events)))
            events = []
    if found and events:
        found[-1] = replace(found[-1], events=(*found[-1].events, *events))
    return found


def _new_frame(record: BytesRecord, events: tuple[str, ...]) -> CapturedFrame:
    at, heard = record.time_s, record.direction == "rx"
    return CapturedFrame(at, record.data, heard, not heard, record.line_errors, events=events, ended_s=at)


def _event_text(event: EventRecord) -> str:
    return json.dumps({"t": event.time_s, "event": event.name, **event.details}, ensure_ascii=False)


def _settings_after(event: EventRecord, before: SerialSettings) -> SerialSettings:
    """Those of a port that was opened; a scan opens it with one after another."""
    if event.name != "opened":
        return before
    try:
        return SerialSettings.parse(event.details["baud"], event.details["format"])
    except (KeyError, ValueError, TypeError, AttributeError):
        return before


def _continues(last: CapturedFrame, record: BytesRecord, line: SerialSettings) -> bool:
    silence_s = record.time_s - line.seconds(len(record.data)) - last.ended_s
    return last.received and record.direction == "rx" and silence_s < max(MAX_PIECE_GAP_S, line.seconds(3.5))


def _group_exchanges(frames: list[CapturedFrame]) -> Iterator[list[CapturedFrame]]:
    """Each frame sent with all that was heard until the next; what was heard before the first stands alone."""
    starts = [at for at, one in enumerate(frames) if at == 0 or not one.received]
    for start, end in pairwise([*starts, len(frames)]):
        yield frames[start:end]


def _split_echo(asked: CapturedFrame, heard: list[CapturedFrame]) -> Iterator[CapturedFrame]:
    """An adapter's echo is the master's: the bytes just sent, where enough for a reply came after them."""
    yield asked
    size = len(asked.data)
    octets = sum(len(one.data) for one in heard)
    if heard and heard[0].data.startswith(asked.data) and octets - size >= MIN_REPLY_OCTETS:
        yield replace(heard[0], data=asked.data, from_master=True)
        rest = heard.pop(0)
        if len(rest.data) > size:
            yield replace(rest, data=rest.data[size:], events=())
    yield from heard


def _is_modbus(frame: CapturedFrame) -> bool:
    return len(frame.data) >= MIN_RTU_OCTETS and crc16(frame.data) == 0
