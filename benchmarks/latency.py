"""Stops as they were called and as the far end of the lines saw them: how late each was, and what went before it."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.harness import Figures

REQUEST = 8
"""Characters of a request, also of a stop."""
STOP_P999_MAX_MS, STOP_MAX_MS = 10, 50
STOP_GOALS = {"p99.9 beyond the bound, ms": STOP_P999_MAX_MS, "max beyond the bound, ms": STOP_MAX_MS}
QUANTILES = {"p50": 0.5, "p90": 0.9, "p99": 0.99, "p99.9": 0.999, "max": 1.0}


@dataclass(frozen=True, slots=True)
class WireRequest:
    """A request on a line: seconds of its first bit and of its reply's last (None: no reply)."""

    at: float
    replied: float | None
    data: bytes

    @property
    def stopped_address(self) -> int | None:
        """VC660, 2000H bit 1: the address that it stops."""
        return self.data[0] if self.data[1:4] == b"\x06\x20\x00" and self.data[5] & 2 else None


def read_frames(path: Path) -> dict[int, list[WireRequest]]:
    """What ``station.c`` recorded, by line."""
    found: dict[int, list[WireRequest]] = defaultdict(list)
    for words in map(str.split, path.read_text().splitlines()):
        replied = int(words[2]) / 1e9 if int(words[2]) else None
        found[int(words[0])].append(WireRequest(int(words[1]) / 1e9, replied, bytes.fromhex(words[3])))
    return found


@dataclass(frozen=True, slots=True)
class StopCall:
    """A stop that a program asked for: seconds of the call; where it was looked at, of the write to the port too."""

    line: int
    address: int
    at: float
    written_at: float = 0.0
    frames_between: int = 0


def read_calls(path: Path) -> list[StopCall]:
    """What ``stop_host.py`` recorded."""
    lines = ([int(word) for word in line.split()] for line in path.read_text().splitlines())
    return [
        StopCall(number, address, at / 1e9, written / 1e9, frames) for number, address, at, written, frames in lines
    ]


def quantiles(values: Iterable[float]) -> dict[str, float]:
    """The nearest rank."""
    ranked = sorted(values)
    return {name: round(ranked[max(0, -int(-share * len(ranked) // 1) - 1)], 3) for name, share in QUANTILES.items()}


def find_stop_frame(call: StopCall, seen: list[WireRequest]) -> int | None:
    """The place of the call's stop among the frames of its line; None where the far end never saw one."""
    first = bisect_left(seen, call.at, key=lambda frame: frame.at)
    return next((n for n in range(first, len(seen)) if seen[n].stopped_address == call.address), None)


MatchedStop = tuple[StopCall, WireRequest, WireRequest]
"""A call, its stop as the far end saw it, and the frame before that on its line."""


def match_stops(calls: Iterable[StopCall], frames: Mapping[int, list[WireRequest]]) -> list[MatchedStop]:
    """The calls whose stop reached the far end."""
    found = ((call, frames[call.line], find_stop_frame(call, frames[call.line])) for call in calls)
    return [(call, seen[place], seen[place - 1]) for call, seen, place in found if place is not None]


def lateness_beyond_bound(seen: Iterable[MatchedStop], bound_s: float, lost: int) -> Figures:
    """How late the stops were beside the bound to their first bit, and whether that is good enough."""
    latencies = [stop.at - call.at for call, stop, _ in seen]
    over = quantiles((latency - bound_s) * 1e3 for latency in latencies)
    return {
        "latency_over_bound": quantiles(latency / bound_s for latency in latencies),
        "latency_minus_bound_ms": over,
        "goal_met": lost == 0 and over["p99.9"] <= STOP_P999_MAX_MS and over["max"] <= STOP_MAX_MS,
    }


def after_free_ms(seen: Iterable[MatchedStop], line: Mapping[str, float], request_s: float) -> dict[str, float]:
    """From the moment when the line was free for the stop to its first bit."""
    return quantiles((stop.at - max(call.at, _free_at(before, line, request_s))) * 1e3 for call, stop, before in seen)


def figures_of(
    calls: list[StopCall], frames: Mapping[int, list[WireRequest]], host: Mapping[str, float], baud: int
) -> Figures:
    """The report's figures; what depends on the machine is under ``machine``."""
    stop_s = 10 * REQUEST / baud
    seen = match_stops(calls, frames)
    lost = len(calls) - len(seen)
    bound_s, own_s = host["bound_s"] - stop_s, host["own_bound_s"] - stop_s
    late = lateness_beyond_bound(seen, bound_s, lost)
    return {
        "stops": len(calls),
        "never_seen": lost,
        "not_confirmed": host["unconfirmed"],
        "bound_ms": {
            "to": "the stop's first bit; its last bit is its 8 characters later, in bound and measurement alike",
            "of the product's arithmetic": round(bound_s * 1e3, 3),
            "of 5.1, from the manual": round(own_s * 1e3, 3),
        },
        "goals": {**STOP_GOALS, "SIGTERM to its last word, s": 3},
        "machine": {
            "latency_over_bound": late["latency_over_bound"],
            "latency_minus_bound_ms": late["latency_minus_bound_ms"],
            "latency_minus_bound_of_5.1_ms": quantiles((stop.at - call.at - own_s) * 1e3 for call, stop, _ in seen),
            "after_the_line_was_free_ms": after_free_ms(seen, host, stop_s),
            "of_it_from_write_to_far_end_ms": quantiles((stop.at - call.written_at) * 1e3 for call, stop, _ in seen),
            "frames_written_between_call_and_stop": dict(
                sorted(Counter(call.frames_between for call in calls).items())
            ),
            "goal_met": late["goal_met"],
            "requests_per_s_answered": round(host["requests_per_s"], 1),
            "ms_each": round(host["request_ms"], 3),
            "lines_occupied_percent": round(host["occupied_percent"], 1),
        },
    }


def _free_at(before: WireRequest, line: Mapping[str, float], request_s: float) -> float:
    """When the stop could have left: after the frame before it was answered or given up, and the gap."""
    over = before.replied if before.replied is not None else before.at + request_s + line["timeout_s"]
    return over + line["gap_s"]
