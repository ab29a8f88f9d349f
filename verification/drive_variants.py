"""Drive variant of the campaigns: the times that a manual gives, and the bounds on a bus that follow from them.

Read a second time from the manuals; no code is shared with ``drivebus.bus``. The variants of each family stand in
``verification.families``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from drivebus.serial_settings import SerialSettings

NOT_YET_COVERED_BY = frozenset({"clock", "commands", "failures", "fairness", "replug", "soak", "stop"})
"""Campaigns that the first four models alone have: their cells, commands and parameters are written for those."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameLengths:
    """Characters of one family's frames in one encoding, and when its stations reply."""

    request: int
    """The longest request that a master sends."""
    reply: int
    """The longest reply to any of them."""
    stop: int
    delay_s: float = 0.0
    """Constant part of the longest time to the reply's first bit, in seconds."""
    delay_characters: float = 0.0
    """Rest of that time, in characters; RTU: the 3.5 of silence by which a station knows that the request has ended."""
    reply_to: Callable[[bytes], int] | None = None
    """Return the characters of the longest reply to one request; None: ``reply`` for each."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveVariant:
    """Drive model in one encoding, with the times that its manual gives or, where it gives none, the product's page
    on timing."""

    name: str
    model: str
    encoding: str
    baud: int
    frames: FrameLengths
    drive_options: Mapping[str, Any] = field(default_factory=dict)
    """Undocumented options that the master takes as determined."""
    options: Mapping[str, str] = field(default_factory=dict)
    """Options of the simulated drives that match ``drive_options``."""
    gap_characters: float = 3.5
    gap_floor_s: float = 0.0
    min_timeout_s: float = 0.1
    """Constant part of the minimum time from the master's last bit until it may give up, in seconds."""
    min_timeout_characters: float = 8
    """Rest of that time, in characters."""
    max_reply_lateness_s: float = 0.5
    """Longest lateness of a reply of this model, in seconds."""
    identical_probe_quarantine_s: float = 0.0
    """Quarantine after an unanswered read of the same register count, in seconds: the sync probes of the DF800 differ
    only in that count."""
    reports_running: bool = True
    """Whether the drive reports that it runs."""
    reports_faults: bool = True
    """Whether the drive reports a trip; else it looks like a stopped one."""
    numbers_faults: bool = True
    """Whether the report of a trip has the number of the fault."""
    broadcast: int | None = 0
    maximum_hz: float = 50.0
    """Highest frequency that may be sent unless the user of the drive raises the limit."""
    plain_reply: tuple[int, tuple[int, ...]]
    """Bytes of the reply to a read of one value, and the places where it repeats the request's address and function."""
    start_has_setpoint: bool = False
    """Whether the frame that starts the drive carries the setpoint; else the setpoint is written before it."""
    setpoint_readable: bool = False
    """Whether a read shows the setpoint that the drive holds."""
    status_read_count: int = 1
    """Number of different reads that show together whether the drive runs."""
    stops_by_broadcast: bool = True
    """Whether a stop of all drives begins with a broadcast."""
    lateness_range_s: tuple[float, float] = (0.2, 0.5)
    """Lateness after the deadline and within the longest lateness, in seconds."""
    undetected_swaps: tuple[int, int] | None = None
    """First and last place (exclusive) of the request's fields in a reply, where its check detects no swap of two
    neighbours; None: it detects every swap."""
    has_checksum: bool = True
    """Whether replies have a checksum: without one, two stations that collide can make a valid digit."""
    addresses: range = range(1, 32)
    """31 addresses of the protocol."""
    not_covered_by: frozenset[str] = frozenset()
    """Campaigns that do not run this variant; the page on verification gives the reasons."""


# --- bounds on the bus ------------------------------------------------------------------------------------------------

ADAPTER_DELAY_MAX_S = 0.02
TURNAROUND_S = 0.1
"""Turnaround after a broadcast, in seconds."""
FOREIGN_TRAFFIC_MAX_CHARACTERS = 64
"""Longest wait of a stop for a busy line, for example with a late reply, in characters."""


def character_s(line: SerialSettings) -> float:
    """Return the time of a character in seconds: start bit, data bits, parity bit where there is one, stop bits."""
    return (1 + line.data_bits + (line.parity != "N") + line.stop_bits) / line.baud


class TimingBounds:
    """Bounds of a model on a bus, in seconds."""

    def __init__(self, variant: DriveVariant, line: SerialSettings) -> None:
        self.variant, self.frames = variant, variant.frames
        self.character_s = character_s(line)
        self.gap_s = max(variant.gap_characters * self.character_s, variant.gap_floor_s)
        self.foreign_traffic_max_s = self.gap_s + FOREIGN_TRAFFIC_MAX_CHARACTERS * self.character_s

    def reply_timeout_s(self, address: int, data: bytes) -> float:
        """Return the time from the last bit of this request until its reply is whole or given up."""
        if address == self.variant.broadcast:
            return TURNAROUND_S
        return self._timeout_for_reply_s(self._longest_reply(data))

    def _timeout_for_reply_s(self, answer: int) -> float:
        frames = self.frames
        return frames.delay_s + (frames.delay_characters + answer) * self.character_s + ADAPTER_DELAY_MAX_S

    def _longest_reply(self, data: bytes) -> int:
        """Return the characters of the longest reply to this request."""
        longest = self.frames.reply_to
        return self.frames.reply if longest is None else longest(data)

    @property
    def stop_bound_s(self) -> float:
        """The longest request has just begun and its drive is silent; gap, stop frame to its last bit."""
        frames = self.frames
        sent_s = (frames.request + frames.stop) * self.character_s
        return sent_s + self._timeout_for_reply_s(frames.reply) + self.gap_s

    @property
    def failed_poll_s(self) -> float:
        """Longest time of a request to a silent station, in seconds."""
        frames = self.frames
        return self.gap_s + frames.request * self.character_s + self._timeout_for_reply_s(frames.reply)
