"""Rows from a capture, replayed at the recorded pace. Opens no port and sends nothing."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from drivebus.capture.dbcap import BytesRecord, Capture
from drivebus.cli import output
from drivebus.cli.tui.rows import BusRow, DriveRow, drive_row
from drivebus.drives.dialects.base import reported_fault
from drivebus.drives.readings import ReadingPairs
from drivebus.drives.state import STATE_NOT_READ, DerivedState, DriveStatus
from drivebus.errors import ProtocolError
from drivebus.protocols.codec import Incomplete

if TYPE_CHECKING:
    from drivebus.drives.dialects.base import Dialect
    from drivebus.profiles import DriveProfile
    from drivebus.protocols.codec import Codec

STATISTICS_WINDOW_S = 10.0  # load and rate are means over this time


@dataclass(slots=True)
class BusActivity:
    """Recent frames and all errors of the recorded bus."""

    busy_periods: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=4096))
    """Start and duration of each record, in seconds."""
    reply_times: deque[float] = field(default_factory=lambda: deque(maxlen=4096))
    errors: Counter[str] = field(default_factory=Counter)

    def load(self, now: float) -> float:
        since = max(0.0, now - STATISTICS_WINDOW_S)
        return min(1.0, sum(busy for at, busy in self.busy_periods if at >= since) / max(1e-9, now - since))

    def rate(self, now: float) -> float:
        since = max(0.0, now - STATISTICS_WINDOW_S)
        return sum(1 for at in self.reply_times if at >= since) / max(1e-9, now - since)


class RecordedDrive:
    """Drive of a capture: its state, derived from recorded replies by the library's own dialect."""

    def __init__(self, dialect: Dialect, key: str, name: str, bus_name: str) -> None:
        self.dialect = dialect
        self.key, self.name, self.bus_name = key, name, bus_name
        self._readings = ReadingPairs()
        self._state: DerivedState = STATE_NOT_READ
        self._received_at: float | None = None

    def on_reply(self, request: Any, reply: Any, at: float | None) -> None:
        """Add the values of one reply; a rejection contains none."""
        if self.dialect.rejection(reply) is not None:
            return
        self._received_at = at
        self._readings.add(self.dialect.decode_readings(request, reply, at))
        if self.dialect.reports_run_state:
            self._state = self.dialect.derive_state(self._readings) or self._state

    def row(self, presence: str) -> DriveRow:
        """Return the row of the latest values."""
        profile, state = self.dialect.profile, self._state
        fault = reported_fault(profile, state)
        readings = {name: reading for name, reading in self._readings.latest.items() if name in profile.signals}
        status = DriveStatus(
            state=state.state,
            direction=state.direction,
            fault=fault,
            readings=readings,
            reason=state.reason,
            at=self._received_at,
        )
        return drive_row(
            status,
            key=self.key,
            name=self.name,
            bus=self.bus_name,
            model=profile.model,
            address=self.dialect.address,
            presence=presence,
        )


class CapturePlayer:
    """Builder of drives from records. Pure: the time is that of the capture."""

    def __init__(self, capture: Capture, candidates: Sequence[tuple[DriveProfile, str]]) -> None:
        self.capture = capture
        self.drives: dict[int, RecordedDrive] = {}
        self.activity = BusActivity()
        self._candidates = [_candidate(profile, encoding) for profile, encoding in candidates]
        self._pending: tuple[RecordedDrive, Any] | None = None
        self._buffer = b""

    def on_record(self, record: BytesRecord) -> None:
        """Process the next record."""
        self.activity.busy_periods.append((record.time_s, self.capture.header.settings.seconds(len(record.data))))
        if record.line_errors:
            self.activity.errors["line_errors"] += record.line_errors
        if record.direction == "tx":
            self._end_pending()
            self._on_request(record.data)
        elif self._pending is None:
            self._on_request(record.data)
        else:
            self._buffer += record.data
            self._on_reply(record.time_s)

    def _on_request(self, data: bytes) -> None:
        """Decode a frame of the master: the drive and the expected reply."""
        for profile, encoding, codec in self._candidates:
            try:
                decoded = codec.decode_request(data)
            except ProtocolError:
                continue
            if isinstance(decoded, Incomplete) or decoded.size != len(data):
                continue
            request = getattr(decoded.message, "request", decoded.message)
            address = codec.address_of(request)
            if address != codec.broadcast_address:
                self._pending = (self._drive_at(profile, encoding, address), request)
                self._buffer = b""
            return
        self.activity.errors["unsolicited"] += 1

    def _on_reply(self, at: float) -> None:
        assert self._pending is not None
        drive, request = self._pending
        try:
            decoded = drive.dialect.codec.decode_reply(request, self._buffer)
        except ProtocolError as error:
            self.activity.errors[type(error).__name__] += 1
            self._pending = None
            return
        if isinstance(decoded, Incomplete) or decoded.size != len(self._buffer):
            return
        self.activity.reply_times.append(at)
        drive.on_reply(request, decoded.message, at)
        self._pending = None

    def _end_pending(self) -> None:
        """Count the pending request as unanswered: the master has sent the next one."""
        if self._pending is not None:
            self.activity.errors["NoReply"] += 1
        self._pending = None

    def _drive_at(self, profile: DriveProfile, encoding: str, address: int) -> RecordedDrive:
        if address not in self.drives:
            from drivebus.drives.dialects.create import create_dialect

            dialect = create_dialect(profile, address, encoding=encoding)
            name = f"{profile.model} {address}"
            self.drives[address] = RecordedDrive(dialect, name, name, self.capture.header.port)
        return self.drives[address]


def _candidate(profile: DriveProfile, encoding: str) -> tuple[DriveProfile, str, Codec]:
    from drivebus.drives.dialects.create import create_dialect

    dialect: Dialect = create_dialect(profile, max(1, profile.addresses[0]), encoding=encoding)
    return profile, encoding, dialect.codec


class CaptureRowSource:
    """Row source of a capture."""

    def __init__(
        self, capture: Capture, candidates: Sequence[tuple[DriveProfile, str]], title: str, speed: float
    ) -> None:
        self.title = title
        self._player = CapturePlayer(capture, candidates)
        self._records = [record for record in capture.records if isinstance(record, BytesRecord)]
        self._speed = speed
        self._task: asyncio.Task[None] | None = None
        self._position_s = 0.0
        self._finished = not self._records
        self._messages: list[str] = [output.text("monitor.truncated")] if capture.truncated else []

    async def start(self) -> None:
        self._task = asyncio.create_task(self._play())

    async def close(self) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def _play(self) -> None:
        loop = asyncio.get_running_loop()
        started_at, first_s = loop.time(), self._records[0].time_s if self._records else 0.0
        for record in self._records:
            await asyncio.sleep(max(0.0, started_at + (record.time_s - first_s) / self._speed - loop.time()))
            self._position_s = record.time_s
            self._player.on_record(record)
        self._messages.append(output.text("monitor.end", seconds=f"{self._position_s:.1f}"))
        self._finished = True

    def now(self) -> float:
        return self._position_s

    def drives(self) -> list[DriveRow]:
        return [self._player.drives[address].row("online") for address in sorted(self._player.drives)]

    def buses(self) -> list[BusRow]:
        capture, activity = self._player.capture, self._player.activity
        name = capture.header.port.rpartition(":")[2].removeprefix("//") or "capture"
        return [
            BusRow(
                name=name,
                settings=str(capture.header.settings),
                load=activity.load(self._position_s),
                transactions_per_s=activity.rate(self._position_s),
                errors=dict(activity.errors),
            )
        ]

    def messages(self) -> list[str]:
        return self._messages

    @property
    def finished(self) -> bool:
        return self._finished
