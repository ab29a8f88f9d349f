"""How long things may take, from the manuals' characters and milliseconds: the observer's own arithmetic.

Nothing of the bus is used here. Where a manual is silent (DZB100, DF800) the reply may begin within 100 ms; an adapter
and its operating system may take 20 ms more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from drivebus.serial_settings import SerialSettings
from verification.drive_variants import DriveVariant

ADAPTER_DELAY_MAX_S = 0.02
TURNAROUND_S = 0.1
"""After a broadcast, which nobody answers."""
FOREIGN_TRAFFIC_MAX_CHARACTERS = 64
"""A stop waits no longer than this for a line on which somebody else is heard, a late reply for instance."""


@dataclass(frozen=True, slots=True)
class FrameLengths:
    """Characters of one family's frames in one encoding, and when its stations reply."""

    request: int
    """The longest request that a host sends."""
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
    """One start bit, the data bits, the parity bit where there is one, and the stop bits."""
    return (1 + line.data_bits + (line.parity != "N") + line.stop_bits) / line.baud


class TimingBounds:
    """One family on one line. All in seconds."""

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
        """What it costs the bus at most to ask a silent station in vain."""
        frames = self.frames
        return self.gap_s + frames.request * self.character_s + self._timeout_for_reply_s(frames.reply)
