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
from drivebus.bus.job import Job
from drivebus.errors import AddressError, LineFault, NoReply, ProtocolError, TrailingError
from drivebus.message import Complete, CompleteIfSilent, Incomplete


class Transaction:
    """Times are monotonic seconds. ``final_at`` is when ``woke`` will have the outcome if the line stays silent."""

    __slots__ = (
        "buffer", "character_s", "deadline", "early", "echo", "error", "final_at", "foreign", "glitched", "heard",
        "heard_at", "job", "message", "need", "paced", "sent_at", "sent_end", "size", "tentative",
    )  # fmt: skip

    def __init__(self, job: Job, now: float, character_s: float, *, paced: bool, echo: EchoFilter | None) -> None:
        self.job = job
        self.character_s = character_s
        self.paced = paced
        self.echo = echo
        self.sent_at = now
        self.sent_end = now + job.send_s
        self.deadline = self.final_at = self.sent_end + job.wait_s
        self.buffer = bytearray()
        self.heard = 0
        """Bytes that may belong to an answer, whatever became of them."""
        self.heard_at: float | None = None
        self.need = 1
        self.message: object = None
        self.size = 0
        self.tentative = False
        self.error: Exception | None = None
        self.early = b""
        self.glitched = False
        self.foreign: list[tuple[bytes, AddressError]] | None = None

    def received(self, data: bytes, now: float, marks: int = 0) -> None:
        """Bytes as they come. ``final_at`` may have changed afterwards."""
        if marks:
            self._void(LineFault("bus.marks", station=self.job.station.address, count=marks))
        if self.echo is not None:
            data = self._without_echo(data)
        if self.paced and now - len(data) * self.character_s < self.sent_end:
            data = self._without_early(data, now)
        if not data:
            return
        self.heard_at = now
        self.heard += len(data)
        if self.job.broadcast:
            return
        self.buffer += data
        if self.error is None and len(self.buffer) >= self.need:
            self._judge()
        self._settle(now)

    def outcome(self) -> Exception | None:
        """What is wrong now that the line has been silent up to ``final_at``; None: ``message`` is the answer."""
        if self.job.broadcast or self.error is not None:
            return self.error
        if self.message is not None and len(self.buffer) == self.size:
            return None
        return NoReply(
            "bus.truncated" if self.buffer else "bus.no_reply",
            station=self.job.station.address,
            attempt=self.job.attempts,
            bytes=len(self.buffer),
            milliseconds=round((self.deadline - self.sent_end) * 1000),
        )

    def useful_at(self) -> float | None:
        """Before this second no further byte can complete the reply on a line of this speed; None: listen now."""
        if self.error is not None or self.message is not None or self.job.broadcast or self.echo is not None:
            return None
        if self.heard_at is None:
            return self.sent_end + (self.job.reply_bytes - 1) * self.character_s
        return self.heard_at + (self.need - len(self.buffer) - 1) * self.character_s

    def _judge(self) -> None:
        """Ask the codec. Another station's whole frame is dropped and waiting goes on (F02)."""
        job = self.job
        while self.buffer:
            try:
                verdict = job.codec.decode_reply(job.request, bytes(self.buffer))
            except AddressError as error:
                if not 0 < error.size <= len(self.buffer):
                    if self._glitch():
                        continue
                    return self._void(error)
                self._drop(error)
                continue
            except ProtocolError as error:
                if self._glitch():
                    continue
                return self._void(error)
            return self._take(verdict)
        return None

    def _glitch(self) -> bool:
        """Where the profile allows it, one byte before the reply is junk (ruling 10): look behind it, once."""
        if self.glitched or not self.job.station.link.timing.leading_junk:
            return False
        self.glitched = True
        self.early += bytes(self.buffer[:1])
        self.heard -= 1
        del self.buffer[:1]
        self.need = 1
        return True

    def _take(self, verdict: Complete | CompleteIfSilent | Incomplete) -> None:
        if type(verdict) is Incomplete:
            self.message = None
            self.need = verdict.need
            return
        assert not isinstance(verdict, Incomplete)
        self.message, self.size = verdict.message, verdict.size
        self.tentative = isinstance(verdict, CompleteIfSilent)
        if isinstance(verdict, CompleteIfSilent):
            self.need = verdict.need
        elif len(self.buffer) > self.size:
            self._void(TrailingError("bus.trailing", expected=self.size, found=len(self.buffer)))

    def _settle(self, now: float) -> None:
        """When is this over, if nothing more comes? A reply counts after the gap; a void waits for its bytes to end."""
        job = self.job
        if self.error is not None:
            whole = self.heard >= job.reply_bytes
            self.final_at = min(self.deadline, now + job.gap_s) if whole else self.deadline
        elif self.message is None or len(self.buffer) != self.size:
            self.final_at = self.deadline
        else:
            self.final_at = now + (job.gap_s + job.adapter_s if self.tentative else job.gap_s)

    def _void(self, error: Exception) -> None:
        if self.error is None:
            self.error = error
            self.message = None
            self.final_at = self.deadline

    def _drop(self, error: AddressError) -> None:
        if self.foreign is None:
            self.foreign = []
        self.foreign.append((bytes(self.buffer[: error.size]), error))
        del self.buffer[: error.size]
        self.heard -= error.size
        self.need = 1

    def _without_echo(self, data: bytes) -> bytes:
        assert self.echo is not None
        rest = self.echo.strip(data)
        if self.echo.collided:
            self._void(LineFault("bus.collision", station=self.job.station.address, position=self.echo.matched + 1))
        return rest

    def _without_early(self, data: bytes, now: float) -> bytes:
        """Byte i of n came no later than (n-1-i) characters ago; an answer's first byte ends after ``sent_end``."""
        count = ceil((self.sent_end + 0.5 * self.character_s - now) / self.character_s) + len(data) - 1
        count = min(max(count, 0), len(data))
        self.early += data[:count]
        return data[count:]
