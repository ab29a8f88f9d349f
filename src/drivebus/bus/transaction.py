"""One frame of ours on the wire and all that can come of it. Pure: ``now`` is an argument, nothing is sent here.

    sending ──last bit──▶ waiting ──reply whole──▶ settling ──gap of silence──▶ accepted
                            │  ▲                      │
                            │  └ another station's    └ a byte more ▶ void (TrailingError)
                            │    frame: dropped (F02)
                            ├ marks, collision, not the reply ▶ void, ends when the line is quiet or at the deadline
                            └ deadline (absolute, F05) ▶ silence (NoReply)

Bytes never move the deadline. What is heard before our own last stop bit can be no answer (F03).
"""

from __future__ import annotations

from math import ceil

from drivebus.bus.echo import EchoFilter
from drivebus.bus.prepared_request import PreparedRequest
from drivebus.errors import AddressError, LineError, NoReply, ProtocolError, TrailingError
from drivebus.protocols.codec import Complete, CompleteIfSilent, Incomplete


class Transaction:
    """Times are monotonic seconds. ``final_at`` is when ``woke`` will have the outcome if the line stays silent."""

    __slots__ = (
        "buffer",
        "bytes_before_tx_end",
        "bytes_needed",
        "character_s",
        "deadline",
        "echo",
        "ends_at",
        "error",
        "foreign_frames",
        "has_line_timing",
        "last_byte_at",
        "message",
        "message_size",
        "needs_silence",
        "noise_skipped",
        "prepared",
        "received_count",
        "sent_at",
        "tx_end_at",
    )

    def __init__(
        self,
        prepared: PreparedRequest,
        now: float,
        character_s: float,
        *,
        has_line_timing: bool,
        echo: EchoFilter | None,
    ) -> None:
        self.prepared = prepared
        self.character_s = character_s
        self.has_line_timing = has_line_timing
        self.echo = echo
        self.sent_at = now
        self.tx_end_at = now + prepared.send_s
        self.deadline = self.ends_at = self.tx_end_at + prepared.reply_timeout_s
        self.buffer = bytearray()
        self.received_count = 0
        """Bytes that may belong to an answer, whatever became of them."""
        self.last_byte_at: float | None = None
        self.bytes_needed = 1
        self.message: object = None
        self.message_size = 0
        self.needs_silence = False
        self.error: Exception | None = None
        self.bytes_before_tx_end = b""
        self.noise_skipped = False
        self.foreign_frames: list[tuple[bytes, AddressError]] | None = None

    def on_data(self, data: bytes, now: float, line_errors: int = 0) -> None:
        """Bytes as they come. ``final_at`` may have changed afterwards."""
        if line_errors:
            self._invalidate(LineError("bus.marks", station=self.prepared.station.address, count=line_errors))
        if self.echo is not None:
            data = self._strip_echo(data)
        if self.has_line_timing and now - len(data) * self.character_s < self.tx_end_at:
            data = self._strip_before_tx_end(data, now)
        if not data:
            return
        self.last_byte_at = now
        self.received_count += len(data)
        if self.prepared.is_broadcast:
            return
        self.buffer += data
        if self.error is None and len(self.buffer) >= self.bytes_needed:
            self._decode()
        self._update_end(now)

    def final_error(self) -> Exception | None:
        """What is wrong now that the line has been silent up to ``final_at``; None: ``message`` is the answer."""
        if self.prepared.is_broadcast or self.error is not None:
            return self.error
        if self.message is not None and len(self.buffer) == self.message_size:
            return None
        return NoReply(
            "bus.truncated" if self.buffer else "bus.no_reply",
            station=self.prepared.station.address,
            attempt=self.prepared.attempts,
            bytes=len(self.buffer),
            milliseconds=round((self.deadline - self.tx_end_at) * 1000),
        )

    def earliest_useful_at(self) -> float | None:
        """Before this second no further byte can complete the reply on a line of this speed; None: listen now."""
        if self.error is not None or self.message is not None or self.prepared.is_broadcast or self.echo is not None:
            return None
        if self.last_byte_at is None:
            return self.tx_end_at + (self.prepared.reply_bytes - 1) * self.character_s
        return self.last_byte_at + (self.bytes_needed - len(self.buffer) - 1) * self.character_s

    def _decode(self) -> None:
        """Ask the codec. Another station's whole frame is dropped and waiting goes on (F02)."""
        job = self.prepared
        while self.buffer:
            try:
                verdict = job.codec.decode_reply(job.request, bytes(self.buffer))
            except AddressError as error:
                if not 0 < error.size <= len(self.buffer):
                    if self._skip_leading_noise():
                        continue
                    return self._invalidate(error)
                self._drop_foreign_frame(error)
                continue
            except ProtocolError as error:
                if self._skip_leading_noise():
                    continue
                return self._invalidate(error)
            return self._apply_result(verdict)
        return None

    def _skip_leading_noise(self) -> bool:
        """Where the profile allows it, one byte before the reply is junk (ruling 10): look behind it, once."""
        if self.noise_skipped or not self.prepared.station.config.timing.tolerate_leading_noise:
            return False
        self.noise_skipped = True
        self.bytes_before_tx_end += bytes(self.buffer[:1])
        self.received_count -= 1
        del self.buffer[:1]
        self.bytes_needed = 1
        return True

    def _apply_result(self, verdict: Complete | CompleteIfSilent | Incomplete) -> None:
        if type(verdict) is Incomplete:
            self.message = None
            self.bytes_needed = verdict.need
            return
        assert not isinstance(verdict, Incomplete)
        self.message, self.message_size = verdict.message, verdict.size
        self.needs_silence = isinstance(verdict, CompleteIfSilent)
        if isinstance(verdict, CompleteIfSilent):
            self.bytes_needed = verdict.need
        elif len(self.buffer) > self.message_size:
            self._invalidate(TrailingError("bus.trailing", expected=self.message_size, found=len(self.buffer)))

    def _update_end(self, now: float) -> None:
        """When is this over, if nothing more comes? A reply counts after the gap; a void waits for its bytes to end."""
        job = self.prepared
        if self.error is not None:
            whole = self.received_count >= job.reply_bytes
            self.ends_at = min(self.deadline, now + job.gap_s) if whole else self.deadline
        elif self.message is None or len(self.buffer) != self.message_size:
            self.ends_at = self.deadline
        else:
            self.ends_at = now + (job.gap_s + job.adapter_latency_s if self.needs_silence else job.gap_s)

    def _invalidate(self, error: Exception) -> None:
        if self.error is None:
            self.error = error
            self.message = None
            self.ends_at = self.deadline

    def _drop_foreign_frame(self, error: AddressError) -> None:
        if self.foreign_frames is None:
            self.foreign_frames = []
        self.foreign_frames.append((bytes(self.buffer[: error.size]), error))
        del self.buffer[: error.size]
        self.received_count -= error.size
        self.bytes_needed = 1

    def _strip_echo(self, data: bytes) -> bytes:
        assert self.echo is not None
        rest = self.echo.strip(data)
        if self.echo.collided:
            self._invalidate(
                LineError("bus.collision", station=self.prepared.station.address, position=self.echo.matched + 1)
            )
        return rest

    def _strip_before_tx_end(self, data: bytes, now: float) -> bytes:
        """Byte i of n came no later than (n-1-i) characters ago; an answer's first byte ends after ``sent_end``."""
        count = ceil((self.tx_end_at + 0.5 * self.character_s - now) / self.character_s) + len(data) - 1
        count = min(max(count, 0), len(data))
        self.bytes_before_tx_end += data[:count]
        return data[count:]
