"""Stops and polls of a service as the far end of its buses recorded them."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path

from benchmarks.harness import Figures
from benchmarks.latency import (
    REQUEST_CHARACTERS,
    StopCall,
    WireRequest,
    after_free_ms,
    lateness_beyond_bound,
    match_stops,
)
from drivebus import profiles
from drivebus.drives.dialects.create import create_dialect
from drivebus.serial_settings import SerialSettings

STATUS_POLL = b"\x03\x30\x00"
"""VC660: FC03 from 3000H on."""
LONGEST_REPLY_BYTES = 13
"""Reply to FC03 of four registers."""
AnsweredCall = tuple[StopCall, str]
"""A stop call and the outcome or error key that it returned."""


def calls_by_interface(path: Path) -> dict[str, list[AnsweredCall]]:
    """Return the calls that ``stop_load`` recorded, by interface."""
    found: dict[str, list[AnsweredCall]] = defaultdict(list)
    for way, line, address, at, word in (text.split(maxsplit=4) for text in path.read_text().splitlines()):
        found[way].append((StopCall(int(line), int(address), int(at) / 1e9), word))
    return dict(found)


def line_times(baud: int) -> dict[str, float]:
    """Return the timeout and gap of the bus in seconds, as the plant computes them."""
    line, timing = SerialSettings.parse(baud, "8N1"), create_dialect(profiles.load("vc660"), 1).station_config.timing
    return {"timeout_s": timing.timeout_s(line, LONGEST_REPLY_BYTES), "gap_s": timing.gap_s(line)}


def lateness_of_stops(
    calls: list[AnsweredCall], frames: Mapping[int, list[WireRequest]], bound_s: float, baud: int
) -> Figures:
    """Return the latencies of these stops; a stop that the far end did not record counts as a missed goal."""
    stop_s = 10 * REQUEST_CHARACTERS / baud
    matched = match_stops((call for call, _ in calls), frames)
    found: Figures = {
        "stops": len(calls),
        "answers": dict(sorted(Counter(word for _, word in calls).items())),
        "never_seen": len(calls) - len(matched),
        "bound_ms_to_first_bit": round((bound_s - stop_s) * 1e3, 3),
    }
    if not matched:
        return found | {"goal_met": False}
    found |= lateness_beyond_bound(matched, bound_s - stop_s, found["never_seen"])
    return found | {"after_the_line_was_free_ms": after_free_ms(matched, line_times(baud), stop_s)}


def poll_intervals(
    frames: Mapping[int, list[WireRequest]], alive: Iterable[int], window: tuple[float, float]
) -> Figures:
    """Return how often each responding drive was polled, and the longest pause between two polls of one."""
    begun, ended = window
    places = [(line, address) for line in frames for address in alive]
    times: dict[tuple[int, int], list[float]] = {place: [begun] for place in places}
    polls = 0
    for line, recorded in frames.items():
        for frame in recorded:
            place = line, frame.data[0]
            if frame.data[1:4] == STATUS_POLL and place in times and begun <= frame.at <= ended:
                times[place].append(frame.at)
                polls += 1
    pauses = [later - at for many in times.values() for at, later in zip(many, [*many[1:], ended], strict=True)]
    seconds = ended - begun
    return {
        "of_a_drive_per_s": round(polls / seconds / len(places), 2),
        "longest_pause_s": round(max(pauses), 3),
        "frames_of_a_line_per_s": round(
            sum(begun <= frame.at <= ended for recorded in frames.values() for frame in recorded)
            / seconds
            / len(frames),
            1,
        ),
    }
