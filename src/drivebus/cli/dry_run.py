"""``--dry-run``: the exact bytes that would be sent, the reply expected, and the time on the bus. Opens no port."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drivebus.cli import output
from drivebus.cli.connect import Target
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.drives.dialects.base import Dialect
    from drivebus.protocols.codec import Codec
    from drivebus.serial_settings import SerialSettings, StationTiming


@dataclass(frozen=True, slots=True)
class PlannedFrame:
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

    def to_json(self) -> dict[str, Any]:
        return {
            "purpose": output.text(f"dry.{self.purpose}"),
            "hex": self.data,
            "reply_bytes": self.reply_bytes,
            "gap_s": round(self.gap_s, 6),
            "request_s": round(self.request_s, 6),
            "reply_s": round(self.reply_s, 6),
            "bus_s": round(self.bus_s, 6),
            "timeout_s": round(self.timeout_s, 6),
        }


def plan_frames(
    purpose: str, requests: Iterable[Any], codec: Codec, timing: StationTiming, line: SerialSettings
) -> list[PlannedFrame]:
    """The frames of some requests. Raises ValueError for a field out of range, as sending would."""
    return [_plan_frame(purpose, request, codec, timing, line) for request in requests]


def _plan_frame(purpose: str, request: Any, codec: Codec, timing: StationTiming, line: SerialSettings) -> PlannedFrame:
    data = codec.encode_request(request)
    reply = codec.reply_size(request)
    return PlannedFrame(
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
        from drivebus.drives.dialects.create import create_dialect

        self.target = target
        profile = target.profile()
        self.serial_settings = target.serial_settings()
        self.dialect: Dialect = create_dialect(
            profile, target.address, encoding=target.encoding, settings=target.drive_options()
        )
        self.frames: list[PlannedFrame] = []

    def add(self, purpose: str, requests: Iterable[Any]) -> None:
        """Requests, in the order in which they would leave."""
        link = self.dialect.station_config
        self.frames += plan_frames(purpose, requests, link.codec, link.timing, self.serial_settings)

    def print(self, *notes: str) -> ExitCode:
        """Print everything; ``notes`` are keys of what depends on the drive's answers."""
        return print_plan(self.frames, self.serial_settings, notes)


def print_plan(planned: Sequence[PlannedFrame], line: SerialSettings, notes: Sequence[str] = ()) -> ExitCode:
    """Print planned frames."""
    total = sum(one.bus_s for one in planned)
    output.print_json(
        {
            "dry_run": True,
            "line": str(line),
            "frames": [one.to_json() for one in planned],
            "bus_s": round(total, 6),
            "notes": [output.text(note) for note in notes],
        }
    )
    output.print_text(_plan_text(planned, line, total))
    for note in notes:
        output.print_message(note)
    return ExitCode.DONE


def _plan_text(planned: Sequence[PlannedFrame], line: SerialSettings, total: float) -> str:
    title = output.text("dry.title", line=line, count=len(planned), bus_ms=f"{total * 1000:.1f}")
    lines = [output.wrap_for(title, sys.stdout)]
    for one in planned:
        answer = output.text("dry.reply", count=one.reply_bytes) if one.reply_bytes else output.text("dry.no_reply")
        lines.append(f"  {output.to_json_value(one.data)}")
        lines.append(f"    {output.text(f'dry.{one.purpose}')} · {answer} · {one.bus_s * 1000:.1f} ms")
    return "\n".join(lines)
