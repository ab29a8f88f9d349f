"""Rows from a capture: what a recorded line said, at the pace at which it was said. Opens no port and sends nothing."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from drivebus.capture import Bytes, Capture
from drivebus.cli import voice
from drivebus.cli.live.model import DriveRow, LineRow
from drivebus.cli.live.watch import Judged
from drivebus.errors import ProtocolError
from drivebus.message import Incomplete

if TYPE_CHECKING:
    from drivebus.drives.dialect import Dialect
    from drivebus.message import Codec
    from drivebus.profiles import DriveProfile

WINDOW_S = 10.0
"""Load and rate look back so far."""


@dataclass(slots=True)
class Exchanges:
    """What happened on the line lately."""

    spans: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=4096))
    """When, and how long the wire was busy."""
    replies: deque[float] = field(default_factory=lambda: deque(maxlen=4096))
    errors: Counter[str] = field(default_factory=Counter)

    def load(self, now: float) -> float:
        since = max(0.0, now - WINDOW_S)
        return min(1.0, sum(busy for at, busy in self.spans if at >= since) / max(1e-9, now - since))

    def rate(self, now: float) -> float:
        since = max(0.0, now - WINDOW_S)
        return sum(1 for at in self.replies if at >= since) / max(1e-9, now - since)


class Player:
    """Turns records into drives. Pure: time is the capture's own."""

    def __init__(self, capture: Capture, candidates: Sequence[tuple[DriveProfile, str]]) -> None:
        self.capture = capture
        self.drives: dict[int, Judged] = {}
        self.line = Exchanges()
        self._candidates = [_open(profile, encoding) for profile, encoding in candidates]
        self._asked: tuple[Judged, Any] | None = None
        self._buffer = b""

    def take(self, record: Bytes) -> None:
        """One record, in order."""
        self.line.spans.append((record.time_s, self.capture.header.settings.seconds(len(record.data))))
        if record.marks:
            self.line.errors["marks"] += record.marks
        if record.direction == "tx":
            self._end_of_reply()
            self._request(record.data)
        elif self._asked is None:
            self._request(record.data)
        else:
            self._buffer += record.data
            self._reply(record.time_s)

    def _request(self, data: bytes) -> None:
        """A frame of the master: who is asked, and what."""
        for profile, encoding, codec in self._candidates:
            try:
                verdict = codec.decode_request(data)
            except ProtocolError:
                continue
            if isinstance(verdict, Incomplete) or verdict.size != len(data):
                continue
            request = getattr(verdict.message, "request", verdict.message)
            address = codec.address_of(request)
            if address != codec.broadcast_address:
                self._asked = (self._drive(profile, encoding, address), request)
                self._buffer = b""
            return
        self.line.errors["unsolicited"] += 1

    def _reply(self, at: float) -> None:
        assert self._asked is not None
        judged, request = self._asked
        try:
            verdict = judged.dialect.codec.decode_reply(request, self._buffer)
        except ProtocolError as error:
            self.line.errors[type(error).__name__] += 1
            self._asked = None
            return
        if isinstance(verdict, Incomplete) or verdict.size != len(self._buffer):
            return
        self.line.replies.append(at)
        judged.note(request, verdict.message, at)
        self._asked = None

    def _end_of_reply(self) -> None:
        """The master speaks again: what was asked before was not answered."""
        if self._asked is not None:
            self.line.errors["NoReply"] += 1
        self._asked = None

    def _drive(self, profile: DriveProfile, encoding: str, address: int) -> Judged:
        if address not in self.drives:
            from drivebus.drives.make import make_dialect

            dialect = make_dialect(profile, address, encoding=encoding)
            name = f"{profile.model} {address}"
            self.drives[address] = Judged(dialect, name, name, self.capture.header.port)
        return self.drives[address]


def _open(profile: DriveProfile, encoding: str) -> tuple[DriveProfile, str, Codec]:
    from drivebus.drives.make import make_dialect

    dialect: Dialect = make_dialect(profile, max(1, profile.addresses[0]), encoding=encoding)
    return profile, encoding, dialect.codec


class CaptureFeed:
    """A ``Feed`` over a capture."""

    def __init__(
        self, capture: Capture, candidates: Sequence[tuple[DriveProfile, str]], title: str, speed: float
    ) -> None:
        self.title = title
        self._player = Player(capture, candidates)
        self._records = [record for record in capture.records if isinstance(record, Bytes)]
        self._speed = speed
        self._task: asyncio.Task[None] | None = None
        self._time = 0.0
        self._over = not self._records
        self._news: list[str] = [voice.say("monitor.truncated")] if capture.truncated else []

    async def start(self) -> None:
        self._task = asyncio.create_task(self._play())

    async def close(self) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def _play(self) -> None:
        loop = asyncio.get_running_loop()
        begun, first = loop.time(), self._records[0].time_s if self._records else 0.0
        for record in self._records:
            await asyncio.sleep(max(0.0, begun + (record.time_s - first) / self._speed - loop.time()))
            self._time = record.time_s
            self._player.take(record)
        self._news.append(voice.say("monitor.end", seconds=f"{self._time:.1f}"))
        self._over = True

    def now(self) -> float:
        return self._time

    def drives(self) -> list[DriveRow]:
        return [self._player.drives[address].row("online") for address in sorted(self._player.drives)]

    def lines(self) -> list[LineRow]:
        capture, line = self._player.capture, self._player.line
        name = capture.header.port.rpartition(":")[2].removeprefix("//") or "capture"
        return [
            LineRow(
                name,
                str(capture.header.settings),
                True,
                line.load(self._time),
                line.rate(self._time),
                dict(line.errors),
            )
        ]

    def news(self) -> list[str]:
        return self._news

    @property
    def over(self) -> bool:
        return self._over
