"""Frames out of a capture's records: what a line carried in one piece, and who said it. Pure; time is the capture's."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

from drivebus.capture import Bytes, Capture, Event
from drivebus.line import LineSettings
from drivebus.protocols.checksum import crc16

JOIN_S: Final = 0.02
"""Bytes heard after a shorter silence belong together: adapters hand them over in pieces, up to 16 ms apart."""
SHORTEST_REPLY: Final = 5
"""Octets (Modbus RTU's exception); fewer after an echo are no reply."""
SHORTEST_RTU: Final = 4


@dataclass(frozen=True, slots=True)
class Frame:
    """Bytes of the line that belong together."""

    time_s: float
    """Since the capture began: when they were handed to the port, or the first of them came from it."""
    data: bytes
    heard: bool
    by_master: bool
    """The master said it: sent, or heard as the echo of what was sent."""
    marks: int = 0
    """How many octets had a parity or framing error."""
    modbus: bool = False
    """It is, or answers, a frame of Modbus RTU."""
    events: tuple[str, ...] = ()
    """What else happened since the frame before, as lines of the capture."""
    ended_s: float = 0.0
    """When the last of its bytes came."""


def frames_of(capture: Capture, all_modbus: bool = False) -> list[Frame]:
    """The frames of a capture, in order.

    A frame that we sent is Modbus RTU where its CRC fits (another protocol's fits one time in 65,536), and so is what
    is heard after it, damaged or not. ``all_modbus``: so is everything.
    """
    found: list[Frame] = []
    for exchange in _exchanges(_joined(capture)):
        first = exchange[0]
        for one in exchange if first.heard else _echo_apart(first, exchange[1:]):
            found.append(replace(one, modbus=all_modbus or _is_modbus(one if first.heard else first)))
    return found


def _joined(capture: Capture) -> list[Frame]:
    """What was sent is a frame; what was heard is one together with what came soon after it."""
    found: list[Frame] = []
    events: list[str] = []
    settings = capture.header.settings
    for record in capture.records:
        if isinstance(record, Event):
            events.append(_line(record))
            settings = _settings(record, settings)
        elif found and not events and _belongs(found[-1], record, settings):
            last, at = found[-1], record.time_s
            found[-1] = replace(last, data=last.data + record.data, marks=last.marks + record.marks, ended_s=at)
        else:
            found.append(_begin(record, tuple(events)))
            events = []
    if found and events:
        found[-1] = replace(found[-1], events=(*found[-1].events, *events))
    return found


def _begin(record: Bytes, events: tuple[str, ...]) -> Frame:
    at, heard = record.time_s, record.direction == "rx"
    return Frame(at, record.data, heard, not heard, record.marks, events=events, ended_s=at)


def _line(event: Event) -> str:
    return json.dumps({"t": event.time_s, "event": event.name, **event.details}, ensure_ascii=False)


def _settings(event: Event, before: LineSettings) -> LineSettings:
    """Those of a port that was opened; a scan opens it with one after another."""
    if event.name != "opened":
        return before
    try:
        return LineSettings.parse(event.details["baud"], event.details["format"])
    except (KeyError, ValueError, TypeError, AttributeError):
        return before


def _belongs(last: Frame, record: Bytes, line: LineSettings) -> bool:
    silence_s = record.time_s - line.seconds(len(record.data)) - last.ended_s
    return last.heard and record.direction == "rx" and silence_s < max(JOIN_S, line.seconds(3.5))


def _exchanges(frames: list[Frame]) -> Iterator[list[Frame]]:
    """Each frame sent with all that was heard until the next; what was heard before the first stands alone."""
    starts = [at for at, one in enumerate(frames) if at == 0 or not one.heard]
    for start, end in pairwise([*starts, len(frames)]):
        yield frames[start:end]


def _echo_apart(asked: Frame, heard: list[Frame]) -> Iterator[Frame]:
    """An adapter's echo is the master's: the bytes just sent, where enough for a reply came after them."""
    yield asked
    size = len(asked.data)
    octets = sum(len(one.data) for one in heard)
    if heard and heard[0].data.startswith(asked.data) and octets - size >= SHORTEST_REPLY:
        yield replace(heard[0], data=asked.data, by_master=True)
        rest = heard.pop(0)
        if len(rest.data) > size:
            yield replace(rest, data=rest.data[size:], events=())
    yield from heard


def _is_modbus(frame: Frame) -> bool:
    return len(frame.data) >= SHORTEST_RTU and crc16(frame.data) == 0
