"""Transaction: a sent frame and the bytes received after it. ``now`` is an argument; nothing is sent here.

    sending ──last bit──▶ waiting ──complete reply─▶ settling ──gap of silence──▶ accepted
                            │  ▲                      │
                            │  └ another station's    └ a further byte ▶ invalid (TrailingError)
                            │    frame: dropped
                            ├ line error, collision, wrong reply ▶ invalid, ends when the bus is silent,
                            │                                     at the deadline at the latest
                            └ deadline (absolute) ▶ no reply (NoReply)

Received bytes never move the deadline; ``BusCore.on_data`` still adds bytes that a busy host reads up to 0.2 s after
it, because they may have come in time. Bytes received before our own last stop bit are no reply, where the port's
timing is that of the bus.
"""

from __future__ import annotations

from math import ceil

from drivebus.bus.messages import BusResult
from drivebus.bus.prepared_request import PreparedRequest
from drivebus.errors import (
    AddressError,
    AlphabetError,
    ChecksumError,
    LineError,
    NoReply,
    ProtocolError,
    TrailingError,
)
from drivebus.protocols.codec import CompleteIfSilent, DecodeResult, Incomplete

RECENT_REPLY_S = 1.0  # a station that replied so shortly before has the right address and serial settings


class EchoFilter:
    """Filter of the echo of one frame. ``tentative``: a mismatch only means that there is no echo."""

    __slots__ = ("collided", "matched", "sent", "tentative")

    def __init__(self, sent: bytes, *, tentative: bool) -> None:
        self.sent = sent
        self.tentative = tentative
        self.matched = 0
        """Number of bytes of the echo so far."""
        self.collided = False

    @property
    def is_complete(self) -> bool:
        return self.matched == len(self.sent)

    @property
    def was_received(self) -> bool:
        """Whether the whole echo was received; False where a tentative one turned out to be none."""
        return self.is_complete and bool(self.sent)

    def strip(self, data: bytes) -> bytes:
        """Return the bytes that do not belong to the echo."""
        if self.is_complete or self.collided:
            return data
        expected = self.sent[self.matched : self.matched + len(data)]
        if data.startswith(expected):
            self.matched += len(expected)
            return data[len(expected) :]
        if not self.tentative:
            self.matched += next(i for i, (a, b) in enumerate(zip(data, expected, strict=False)) if a != b)
            self.collided = True
            return data
        withheld, self.sent = self.sent[: self.matched], b""
        self.matched = 0
        return withheld + data


class Transaction:
    """A frame sent at ``now`` and the bytes received since then. Times are monotonic seconds."""

    __slots__ = (
        "buffer",
        "bytes_before_tx_end",
        "bytes_needed",
        "character_s",
        "deadline",
        "echo",
        "ends_at",
        "error",
        "expected_result",
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
        """End of the last stop bit of our own frame."""
        self.deadline = self.ends_at = self.tx_end_at + prepared.reply_timeout_s
        """``ends_at``: time at which the result is known if the bus is silent until then."""
        self.buffer = b""
        """Received bytes that may belong to the reply."""
        self.received_count = 0
        """Bytes that may belong to a reply, valid or not."""
        self.last_byte_at: float | None = None
        self.bytes_needed = 1
        """Bytes until the next decoding; 1 before the first read, and after it where it was the whole reply."""
        self.message: object = None
        self.message_size = 0
        self.needs_silence = False
        """The reply is complete only if no byte follows."""
        self.expected_result: BusResult | None = None
        """Result if silence follows the reply, made while that gap passes: nothing else can be done then."""
        self.error: Exception | None = None
        self.bytes_before_tx_end = b""
        self.noise_skipped = False
        self.foreign_frames: list[tuple[bytes, AddressError]] | None = None

    def on_data(self, data: bytes, now: float, line_errors: int = 0) -> None:
        """Add received bytes. ``ends_at`` may have changed afterwards."""
        if line_errors:
            self._invalidate(LineError("bus.line_errors", station=self.prepared.station.address, count=line_errors))
        if self.echo is not None:
            data = self._strip_echo(self.echo, data)
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
        """Return the error after silence until ``ends_at``; None: ``message`` is the reply."""
        if self.prepared.is_broadcast or self.error is not None:
            return self.error
        if self.message is not None and len(self.buffer) == self.message_size:
            return None
        withheld = 0 if self.echo is None or self.echo.is_complete else self.echo.matched
        count = len(self.buffer) + withheld  # a cut reply may begin like our own frame
        params = {
            "station": self.prepared.station.address,
            "attempt": self.prepared.attempts,
            "bytes": count,
            "milliseconds": round((self.deadline - self.tx_end_at) * 1000),
        }
        if count:
            return NoReply("bus.truncated", **params)
        echoed = self.echo is not None and self.echo.was_received
        if echoed and self.prepared.is_mirrorable():  # the echo may have been a reply that equals the request
            return NoReply("bus.only_own_frame", **params)
        last_reply_at = self.prepared.station.last_reply_at
        if last_reply_at is None or self.sent_at - last_reply_at > RECENT_REPLY_S:
            return NoReply("bus.no_reply", **params)
        return NoReply("bus.no_reply_to_next", **params, since_ms=round((self.sent_at - last_reply_at) * 1000))

    def result(self, error: Exception | None) -> BusResult:
        """Return the result for the caller; ``error`` None: the accepted reply, or the end of a broadcast."""
        if error is None and self.expected_result is not None:
            return self.expected_result
        return self._make_result(error)

    def _make_result(self, error: Exception | None) -> BusResult:
        prepared = self.prepared
        return BusResult(
            bus_request=prepared.bus_request,
            reply=self.message if error is None else None,
            error=error,
            sent=prepared.data,
            received=self.buffer,
            sent_at=self.sent_at,
            received_at=self.last_byte_at,
            gap_s=prepared.gap_s,
            attempts=prepared.attempts,
        )

    def earliest_useful_at(self) -> float | None:
        """Return the time before which the reply is probably not complete; None: any byte may matter.

        It is the time of its bytes on the wire after the usual delay.
        """
        if self.error is not None or self.message is not None or self.prepared.is_broadcast or self.echo is not None:
            return None
        if self.last_byte_at is None:
            return (
                self.tx_end_at + self.prepared.usual_delay.seconds + (self.prepared.reply_bytes - 1) * self.character_s
            )
        return self.last_byte_at + (self.bytes_needed - len(self.buffer) - 1) * self.character_s

    def learn_delay(self) -> None:
        """Add the delay of the accepted reply to the usual delay of its poll or station."""
        prepared = self.prepared
        if self.received_count == prepared.reply_bytes:
            assert self.last_byte_at is not None
            delay_s = self.last_byte_at - self.tx_end_at - (prepared.reply_bytes - 1) * self.character_s
            prepared.usual_delay.add(delay_s, read_at_once=self.bytes_needed == 1)

    def is_damaged_reply(self, error: Exception) -> bool:
        """Return whether ``error`` is damage of exactly the bytes of a reply: the reply has come and is damaged."""
        damage = isinstance(error, ChecksumError | AlphabetError | LineError)
        return damage and self.received_count == self.prepared.reply_bytes

    def ends_with_second_reply(self, error: TrailingError) -> bool:
        """Return whether the bytes after the reply are another reply, as of two drives at one address."""
        rest = self.buffer[error.expected :] if isinstance(error.expected, int) else b""
        return bool(rest) and self.prepared.station.decode_reply_to(self.prepared.request, rest) is not None

    def _decode(self) -> None:
        """Decode the buffer. A complete frame of another station is dropped, and the wait continues."""
        prepared = self.prepared
        while self.buffer:
            try:
                result = prepared.decode_reply(self.buffer)
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
            return self._apply_result(result)
        return None

    def _skip_leading_noise(self) -> bool:
        """Drop one byte before the reply, once, where the profile of the station allows it."""
        if self.noise_skipped or not self.prepared.station.config.timing.tolerate_leading_noise:
            return False
        self.noise_skipped = True
        self.bytes_before_tx_end += self.buffer[:1]
        self.received_count -= 1
        self.buffer = self.buffer[1:]
        self.bytes_needed = 1
        return True

    def _apply_result(self, result: DecodeResult) -> None:
        self.expected_result, self.needs_silence = None, False
        if isinstance(result, Incomplete):
            self.message = None
            self.bytes_needed = result.need
            return
        self.message, self.message_size = result.message, result.size
        if type(result) is CompleteIfSilent:
            self.needs_silence, self.bytes_needed = True, result.need
        elif len(self.buffer) > result.size:
            station, size = self.prepared.station.address, result.size
            self._invalidate(TrailingError("bus.trailing", station=station, expected=size, found=len(self.buffer)))
        else:
            self.expected_result = self._make_result(None)

    def _update_end(self, now: float) -> None:
        """Set ``ends_at``: after the gap for a valid reply, when the bytes end for an invalid one."""
        prepared = self.prepared
        if self.error is not None:
            complete = self.received_count >= prepared.reply_bytes
            self.ends_at = min(self.deadline, now + prepared.gap_s) if complete else self.deadline
        elif self.message is None or len(self.buffer) != self.message_size:
            self.ends_at = self.deadline
        else:
            self.ends_at = now + (
                prepared.gap_s + prepared.station.config.timing.adapter_latency_s
                if self.needs_silence
                else prepared.gap_s
            )

    def _invalidate(self, error: Exception) -> None:
        if self.error is None:
            self.error = error
            self.message = None
            self.ends_at = self.deadline

    def _drop_foreign_frame(self, error: AddressError) -> None:
        if self.foreign_frames is None:
            self.foreign_frames = []
        self.foreign_frames.append((self.buffer[: error.size], error))
        self.buffer = self.buffer[error.size :]
        self.received_count -= error.size
        self.bytes_needed = 1

    def _strip_echo(self, echo: EchoFilter, data: bytes) -> bytes:
        rest = echo.strip(data)
        if echo.collided:
            station = self.prepared.station.address
            self._invalidate(LineError("bus.collision", station=station, position=echo.matched + 1))
        return rest

    def _strip_before_tx_end(self, data: bytes, now: float) -> bytes:
        """Remove bytes older than ``tx_end_at``: byte i of n was received at least (n-1-i) characters ago."""
        count = ceil((self.tx_end_at + 0.5 * self.character_s - now) / self.character_s) + len(data) - 1
        count = min(max(count, 0), len(data))
        self.bytes_before_tx_end += data[:count]
        return data[count:]
