"""Latency of stops: calls of the host matched with the frames that the far end recorded."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.harness import Figures

REQUEST_CHARACTERS = 8
"""Characters of a request, a stop included."""
VC660_STOP_WRITE = b"\x06\x20\x00"
"""VC660: FC06 to 2000H; bit 1 stops."""

STOP_P999_MAX_MS, STOP_MAX_MS = 10, 50
STOP_GOALS = {"p99.9 beyond the bound, ms": STOP_P999_MAX_MS, "max beyond the bound, ms": STOP_MAX_MS}
QUANTILES = {"p50": 0.5, "p90": 0.9, "p99": 0.99, "p99.9": 0.999, "max": 1.0}


@dataclass(frozen=True, slots=True)
class WireRequest:
    """Request on a bus: seconds of its first bit and of its reply's last (None: no reply)."""

    at: float
    replied: float | None
    data: bytes

    @property
    def stopped_address(self) -> int | None:
        """Address of the VC660 that it stops; None where it is no stop."""
        return self.data[0] if self.data[1:4] == VC660_STOP_WRITE and self.data[5] & 2 else None


def read_frames(path: Path) -> dict[int, list[WireRequest]]:
    """Return the requests that ``station.c`` recorded, by bus."""
    found: dict[int, list[WireRequest]] = defaultdict(list)
    for words in map(str.split, path.read_text().splitlines()):
        replied = int(words[2]) / 1e9 if int(words[2]) else None
        found[int(words[0])].append(WireRequest(int(words[1]) / 1e9, replied, bytes.fromhex(words[3])))
    return found


@dataclass(frozen=True, slots=True)
class StopCall:
    """Call of a stop: its second, and where recorded the second of the write and the frames written in between."""

    line: int
    address: int
    at: float
    written_at: float = 0.0
    frames_between: int = 0


def read_calls(path: Path) -> list[StopCall]:
    """Return the calls that ``stop_host.py`` recorded."""
    lines = ([int(word) for word in line.split()] for line in path.read_text().splitlines())
    return [
        StopCall(number, address, at / 1e9, written / 1e9, frames) for number, address, at, written, frames in lines
    ]


def quantiles(values: Iterable[float]) -> dict[str, float]:
    """Return the quantiles by nearest rank."""
    ranked = sorted(values)
    return {name: round(ranked[max(0, -int(-share * len(ranked) // 1) - 1)], 3) for name, share in QUANTILES.items()}


def find_stop_frame(call: StopCall, frames: list[WireRequest]) -> int | None:
    """Return the index of the call's stop among the frames of its bus; None where the far end recorded none."""
    first = bisect_left(frames, call.at, key=lambda frame: frame.at)
    return next((n for n in range(first, len(frames)) if frames[n].stopped_address == call.address), None)


MatchedStop = tuple[StopCall, WireRequest, WireRequest]
"""A call, its stop at the far end, and the frame before that stop on its bus."""


def match_stops(calls: Iterable[StopCall], frames: Mapping[int, list[WireRequest]]) -> list[MatchedStop]:
    """Return the calls whose stop reached the far end."""
    found = ((call, frames[call.line], find_stop_frame(call, frames[call.line])) for call in calls)
    return [(call, line[place], line[place - 1]) for call, line, place in found if place is not None]


def lateness_beyond_bound(stops: Iterable[MatchedStop], bound_s: float, lost: int) -> Figures:
    """Return how much later than the bound the stops' first bits were, and whether the goal was met."""
    latencies = [stop.at - call.at for call, stop, _ in stops]
    over = quantiles((latency - bound_s) * 1e3 for latency in latencies)
    return {
        "latency_over_bound": quantiles(latency / bound_s for latency in latencies),
        "latency_minus_bound_ms": over,
        "goal_met": lost == 0 and over["p99.9"] <= STOP_P999_MAX_MS and over["max"] <= STOP_MAX_MS,
    }


def after_free_ms(stops: Iterable[MatchedStop], line: Mapping[str, float], request_s: float) -> dict[str, float]:
    """Return the milliseconds from the moment when the bus was free to the stop's first bit."""
    return quantiles((stop.at - max(call.at, _free_at(before, line, request_s))) * 1e3 for call, stop, before in stops)


def figures_of(
    calls: list[StopCall], frames: Mapping[int, list[WireRequest]], host: Mapping[str, float], baud: int
) -> Figures:
    """Return the report's figures; those that depend on the machine are under ``machine``."""
    stop_s = 10 * REQUEST_CHARACTERS / baud
    stops = match_stops(calls, frames)
    lost = len(calls) - len(stops)
    bound_s, own_s = host["bound_s"] - stop_s, host["own_bound_s"] - stop_s
    late = lateness_beyond_bound(stops, bound_s, lost)
    return {
        "stops": len(calls),
        "never_seen": lost,
        "not_confirmed": host["unconfirmed"],
        "bound_ms": {
            "to": "the stop's first bit; its last bit is its 8 characters later, in bound and measurement alike",
            "of the product's bus load estimate": round(bound_s * 1e3, 3),
            "of the reference calculation": round(own_s * 1e3, 3),
        },
        "goals": {**STOP_GOALS, "SIGTERM to the stopped event, s": 3},
        "machine": {
            "latency_over_bound": late["latency_over_bound"],
            "latency_minus_bound_ms": late["latency_minus_bound_ms"],
            "latency_minus_reference_bound_ms": quantiles((stop.at - call.at - own_s) * 1e3 for call, stop, _ in stops),
            "after_the_line_was_free_ms": after_free_ms(stops, host, stop_s),
            "write_to_far_end_ms": quantiles((stop.at - call.written_at) * 1e3 for call, stop, _ in stops),
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
    """Return when the bus was free: the reply or timeout of the frame before, plus the gap."""
    over = before.replied if before.replied is not None else before.at + request_s + line["timeout_s"]
    return over + line["gap_s"]
