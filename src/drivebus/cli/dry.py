"""``--dry-run``: the exact bytes that would be sent, the reply expected, and the time on the bus. Opens no port."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drivebus.cli import voice
from drivebus.cli.connect import Target
from drivebus.cli.exits import Exit

if TYPE_CHECKING:
    from drivebus.drives.dialect import Dialect
    from drivebus.line import LineSettings
    from drivebus.message import Codec, StationTiming


@dataclass(frozen=True, slots=True)
class Planned:
    """One frame that would leave."""

    purpose: str
    """An i18n key: dry.<purpose>."""
    data: bytes
    reply_bytes: int
    """Length of the normal reply; 0 where nobody answers."""
    request_s: float
    gap_s: float
    reply_s: float
    turnaround_s: float
    timeout_s: float

    @property
    def bus_s(self) -> float:
        """Silence before, request, reply; after a broadcast its turnaround. The station's own delay comes on top."""
        return self.gap_s + self.request_s + (self.reply_s if self.reply_bytes else self.turnaround_s)

    def as_document(self) -> dict[str, Any]:
        return {
            "purpose": voice.say(f"dry.{self.purpose}"),
            "hex": self.data,
            "reply_bytes": self.reply_bytes,
            "gap_s": round(self.gap_s, 6),
            "request_s": round(self.request_s, 6),
            "reply_s": round(self.reply_s, 6),
            "bus_s": round(self.bus_s, 6),
            "timeout_s": round(self.timeout_s, 6),
        }


def plan(
    purpose: str, requests: Iterable[Any], codec: Codec, timing: StationTiming, line: LineSettings
) -> list[Planned]:
    """The frames of some requests. Raises ValueError for a field out of range, as sending would."""
    return [_planned(purpose, request, codec, timing, line) for request in requests]


def _planned(purpose: str, request: Any, codec: Codec, timing: StationTiming, line: LineSettings) -> Planned:
    data = codec.encode_request(request)
    reply = codec.reply_size(request)
    return Planned(
        purpose,
        data,
        reply,
        request_s=line.seconds(len(data)),
        gap_s=timing.gap_s(line),
        reply_s=line.seconds(reply),
        turnaround_s=timing.turnaround_s,
        timeout_s=timing.timeout_s(line, codec.largest_reply(request)) if reply else 0.0,
    )


class DryRun:
    """Collects what a verb would send to one drive."""

    def __init__(self, target: Target) -> None:
        from drivebus.drives.make import make_dialect

        self.target = target
        profile = target.profile()
        self.line = target.line()
        self.dialect: Dialect = make_dialect(
            profile, target.address, encoding=target.encoding, settings=target.settings()
        )
        self.planned: list[Planned] = []

    def add(self, purpose: str, requests: Iterable[Any]) -> None:
        """Requests, in the order in which they would leave."""
        link = self.dialect.link
        self.planned += plan(purpose, requests, link.codec, link.timing, self.line)

    def show(self, *notes: str) -> Exit:
        """Print everything; ``notes`` are keys of what depends on the drive's answers."""
        return show(self.planned, self.line, notes)


def show(planned: Sequence[Planned], line: LineSettings, notes: Sequence[str] = ()) -> Exit:
    """Print planned frames."""
    total = sum(one.bus_s for one in planned)
    voice.document(
        {
            "dry_run": True,
            "line": str(line),
            "frames": [one.as_document() for one in planned],
            "bus_s": round(total, 6),
            "notes": [voice.say(note) for note in notes],
        }
    )
    voice.show(_page(planned, line, total))
    for note in notes:
        voice.tell(note)
    return Exit.DONE


def _page(planned: Sequence[Planned], line: LineSettings, total: float) -> str:
    title = voice.say("dry.title", line=line, count=len(planned), bus_ms=f"{total * 1000:.1f}")
    lines = [voice.wrapped(title, sys.stdout)]
    for one in planned:
        answer = voice.say("dry.reply", count=one.reply_bytes) if one.reply_bytes else voice.say("dry.no_reply")
        lines.append(f"  {voice.plain(one.data)}")
        lines.append(f"    {voice.say(f'dry.{one.purpose}')} · {answer} · {one.bus_s * 1000:.1f} ms")
    return "\n".join(lines)
