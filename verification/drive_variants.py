"""Drive variants of the campaigns, and the times that the manuals give for them.

Read a second time from the manuals; no code is shared with ``drivebus.bus``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drivebus.serial_settings import SerialSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveVariant:
    """Drive model in one encoding, with the times that its manual gives or, where it gives none, the product's page
    on timing."""

    name: str
    model: str
    encoding: str
    baud: int
    drive_options: Mapping[str, Any] = field(default_factory=dict)
    """Undocumented options that the master takes as determined."""
    options: Mapping[str, str] = field(default_factory=dict)
    """Options of the simulated drives that match ``drive_options``."""
    gap_characters: float = 3.5
    gap_floor_s: float = 0.0
    min_timeout_s: float = 0.1
    """Minimum time from the master's last bit until it may give up, in seconds …"""
    min_timeout_characters: float = 8
    """… plus this number of characters."""
    max_reply_lateness_s: float = 0.5
    """Longest lateness of a reply of this model, in seconds."""
    identical_probe_quarantine_s: float = 0.0
    """Quarantine after an unanswered read of the same register count, in seconds: the sync probes of the DF800 differ
    only in that count."""
    reports_running: bool = True
    """Whether the drive reports that it runs."""
    broadcast: int | None = 0
    maximum_hz: float = 50.0
    """Highest frequency that may be sent unless the user of the drive raises the limit."""


_CODINGS = {"setpoint_coding": "hex-0.1", "query_coding": "hex-0.1", "parameter_coding": "hex-0.1"}
_DIRECTION_CALIBRATED = {"direction_calibrated": True}

C320 = DriveVariant(
    name="c320-ascii",
    model="c320",
    encoding="ascii",
    baud=9600,
    gap_characters=5,
    min_timeout_s=0.0,
    min_timeout_characters=26,
    max_reply_lateness_s=0.18,
    broadcast=31,
)
C320_HEX = DriveVariant(
    name="c320-hex",
    model="c320",
    encoding="hex",
    baud=9600,
    gap_characters=5,
    min_timeout_s=0.0,
    min_timeout_characters=26,
    max_reply_lateness_s=0.18,
    broadcast=31,
)
DZB100 = DriveVariant(
    name="dzb100",
    model="dzb100",
    encoding="ascii",
    baud=4800,
    drive_options=_CODINGS,
    min_timeout_characters=11,
    maximum_hz=400.0,
)
VC660 = DriveVariant(
    name="vc660",
    model="vc660",
    encoding="rtu",
    baud=9600,
    gap_floor_s=0.00175,
    min_timeout_s=0.004,
    max_reply_lateness_s=0.204,
)
DF800 = DriveVariant(
    name="df800-rtu",
    model="df800",
    encoding="rtu",
    baud=9600,
    drive_options=_DIRECTION_CALIBRATED,
    gap_floor_s=0.00175,
    identical_probe_quarantine_s=5.0,
    reports_running=False,
    maximum_hz=400.0,
)
DF800_ASCII = DriveVariant(
    name="df800-ascii",
    model="df800",
    encoding="ascii",
    baud=9600,
    drive_options=_DIRECTION_CALIBRATED,
    options={"encoding": "ascii"},
    min_timeout_characters=15,
    reports_running=False,
    identical_probe_quarantine_s=5.0,
    maximum_hz=400.0,
)
DRIVE_VARIANTS = (C320, C320_HEX, DZB100, VC660, DF800, DF800_ASCII)
VARIANTS_BY_NAME = {kind.name: kind for kind in DRIVE_VARIANTS}


# --- bounds on the bus ------------------------------------------------------------------------------------------------

ADAPTER_DELAY_MAX_S = 0.02
TURNAROUND_S = 0.1
"""Turnaround after a broadcast, in seconds."""
FOREIGN_TRAFFIC_MAX_CHARACTERS = 64
"""Longest wait of a stop for a busy line, for example with a late reply, in characters."""


@dataclass(frozen=True, slots=True)
class FrameLengths:
    """Characters of one family's frames in one encoding, and when its stations reply."""

    request: int
    """The longest request that a master sends."""
    reply: int
    """The longest reply to any of them."""
    stop: int
    delay_s: float = 0.0
    """Longest time to the reply's first bit …"""
    delay_characters: float = 0.0
    """… plus so many characters; RTU: the 3.5 of silence by which a station knows that the request has ended."""


FRAME_LENGTHS: Mapping[str, FrameLengths] = {
    "c320-ascii": FrameLengths(18, 18, 15, 0.0, 8),
    "c320-hex": FrameLengths(18, 18, 15, 0.0, 8),
    "dzb100": FrameLengths(11, 11, 11, 0.1),
    "vc660": FrameLengths(8, 13, 8, 0.024, 3.5),
    "df800-rtu": FrameLengths(8, 9, 8, 0.1, 3.5),
    "df800-ascii": FrameLengths(17, 19, 17, 0.1),
}
"""C320 2.2.2: 14, with an operation 15, with a value 18; 8 characters to reply. VC660: FC03 of four registers, F06.06 =
4 ms and 20 ms of work. DF800: FC03 of two registers at most. A stop of DZB100 always carries 0000 (T11)."""


def character_s(line: SerialSettings) -> float:
    """Return the time of a character in seconds: start bit, data bits, parity bit where there is one, stop bits."""
    return (1 + line.data_bits + (line.parity != "N") + line.stop_bits) / line.baud


class TimingBounds:
    """Bounds of a model on a bus, in seconds."""

    def __init__(self, kind: DriveVariant, line: SerialSettings) -> None:
        self.kind, self.frames = kind, FRAME_LENGTHS[kind.name]
        self.character_s = character_s(line)
        self.gap_s = max(kind.gap_characters * self.character_s, kind.gap_floor_s)
        self.foreign_traffic_max_s = self.gap_s + FOREIGN_TRAFFIC_MAX_CHARACTERS * self.character_s

    def reply_timeout_s(self, address: int, data: bytes) -> float:
        """From the last bit of this request until its reply is whole or given up."""
        if address == self.kind.broadcast:
            return TURNAROUND_S
        return self._timeout_for_reply_s(self._longest_reply(data))

    def _timeout_for_reply_s(self, answer: int) -> float:
        frames = self.frames
        return frames.delay_s + (frames.delay_characters + answer) * self.character_s + ADAPTER_DELAY_MAX_S

    def _longest_reply(self, data: bytes) -> int:
        """Characters of the longest reply to this request."""
        if self.kind.model in ("c320", "dzb100"):
            return self.frames.reply
        ascii_ = self.kind.encoding == "ascii"
        words = bytes.fromhex(data[1:-2].decode()) if ascii_ else data
        payload = 1 + 2 * words[5] if words[1] == 3 else 4
        return 3 + 2 * (3 + payload) if ascii_ else 4 + payload

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
