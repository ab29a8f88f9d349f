"""Capture files (``.dbcap``): format of recorded traffic, writer and reader.

A capture is UTF-8 text, one JSON object a line. The first line is the header; each further line is one record:
``{"t": 1.250000, "rx": "0103"}`` for received bytes, ``"tx"`` for sent bytes, ``"event"`` for anything else. ``t`` is
seconds of a monotonic clock since the capture began. The format is described in docs/reference/capture-format.md.
"""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from drivebus.control_characters import without_control_characters
from drivebus.errors import ConfigurationError, SystemReason
from drivebus.serial_settings import SerialSettings
from drivebus.types import Json

RECORD_KINDS = ("rx", "tx", "event")
"""Keys of which each record has one."""
VERSION = 1  # raised only when an older reader would misunderstand the file; new keys and events do not raise it

ByteDirection = Literal["rx", "tx"]


class CaptureError(ConfigurationError):
    """Invalid capture file; names file, line, what was found and expected."""


@dataclass(frozen=True, slots=True)
class CaptureHeader:
    """First line of a capture."""

    settings: SerialSettings
    port: str = ""
    """URL of the port."""
    started: str = ""
    """Wall-clock label (ISO 8601) of ``t`` = 0; never used for arithmetic."""
    writer: str = ""


@dataclass(frozen=True, slots=True)
class BytesRecord:
    """Bytes sent or delivered together, with the time."""

    time_s: float
    direction: ByteDirection
    data: bytes
    line_errors: int = 0
    """Number of bytes with a parity or framing error."""
    line_number: int = 0
    """Line of the file from which it was read, from 2; 0 otherwise."""


@dataclass(frozen=True, slots=True)
class EventRecord:
    """Event: ``opened`` (with the settings in force), ``closed``, ``lost``, or a name of a later version."""

    time_s: float
    name: str
    details: Mapping[str, Any] = field(default_factory=dict)
    line_number: int = 0


Record = BytesRecord | EventRecord


@dataclass(frozen=True, slots=True)
class Capture:
    """Content of a capture file."""

    header: CaptureHeader
    records: tuple[Record, ...]
    truncated: bool = False
    """The last line was cut (the writer was killed) and is left out; everything before it is valid."""


class CaptureWriter:
    """Writer of a capture, line by line; each record is with the operating system when the call returns.

    A disk failure never disturbs the bus: the first error is in ``error`` and writing ends.
    """

    def __init__(self, path: str | Path, header: CaptureHeader, *, now: float) -> None:
        """Create the file at monotonic second ``now``. Raises CaptureError where it exists or can't be created."""
        self.path = Path(path)
        self.error: OSError | None = None
        self._started_at = now
        try:
            self._fd = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o644)
        except FileExistsError as error:
            raise CaptureError("capture.exists", file=str(path)) from error
        except OSError as error:
            raise CaptureError("capture.create", file=str(path), reason=SystemReason(error)) from error
        self._write_line(_header_line(header))

    def write_bytes(self, now: float, direction: ByteDirection, data: bytes, line_errors: int = 0) -> None:
        """Record bytes at monotonic second ``now``."""
        errors = f',"line_errors":{line_errors}' if line_errors else ""
        self._write_line(f'{{"t":{now - self._started_at:.6f},"{direction}":"{data.hex()}"{errors}}}\n')

    def write_event(self, now: float, name: str, **details: Any) -> None:
        """Record an event; ``details`` are JSON values."""
        self._write_line(
            json.dumps({"t": round(now - self._started_at, 6), "event": name, **details}, ensure_ascii=False) + "\n"
        )

    def close(self) -> None:
        """End the capture; a failure of the disk that shows only now is in ``error`` too. Idempotent."""
        fd, self._fd = self._fd, -1
        if fd < 0:
            return
        try:
            os.close(fd)
        except OSError as error:
            self.error = self.error or error

    def _write_line(self, line: str) -> None:
        if self._fd < 0 or self.error is not None:
            return
        data = line.encode()
        try:
            if os.write(self._fd, data) != len(data):
                raise OSError(errno.ENOSPC, "short write")
        except OSError as error:
            self.error = error


def read_capture(path: str | Path) -> Capture:
    """Read and check a whole capture. Raises CaptureError with file, line, found and expected."""
    name = str(path)
    try:
        text = Path(path).read_bytes()
    except OSError as error:
        raise CaptureError("capture.open", file=name, reason=SystemReason(error)) from error
    lines = text.split(b"\n")
    truncated = lines.pop() != b""
    if not lines:
        raise CaptureError("capture.empty", file=name)
    header = _parse_header(name, _parse_object(name, 1, lines[0]))
    return Capture(header, tuple(_parse_records(name, lines)), truncated)


def _parse_records(file: str, lines: list[bytes]) -> Iterator[Record]:
    last = 0.0
    for number, line in enumerate(lines[1:], 2):
        record = _parse_record(file, number, _parse_object(file, number, line))
        if record.time_s < last:
            raise _invalid_value(file, number, "t", record.time_s, f">= {last}")
        last = record.time_s
        yield record


def _parse_object(file: str, number: int, line: bytes) -> Json:
    try:
        value = json.loads(line.decode("utf-8"))
    except (ValueError, RecursionError):
        value = None
    if not isinstance(value, dict):
        raise CaptureError("capture.line", file=file, line=number, found=line[:60].decode("utf-8", "replace"))
    return value


def _parse_header(file: str, value: Json) -> CaptureHeader:
    version = value.get("dbcap")
    if type(version) is not int or version < 1:
        raise CaptureError("capture.header", file=file, line=1, found=version)
    if version > VERSION:
        raise CaptureError("capture.version", file=file, line=1, found=version, expected=VERSION)
    return CaptureHeader(
        settings=_parse_settings(file, value),
        port=without_control_characters(str(value.get("port", ""))),
        started=without_control_characters(str(value.get("started", ""))),
        writer=without_control_characters(str(value.get("writer", ""))),
    )


def _parse_settings(file: str, value: Mapping[str, Any]) -> SerialSettings:
    baud, format = value.get("baud"), value.get("format")
    try:
        if type(baud) is not int or not isinstance(format, str):
            raise ValueError
        return SerialSettings.parse(baud, format)
    except ValueError:
        raise _invalid_value(file, 1, ("baud", "format"), (baud, format), ("9600", "8E1")) from None


def _parse_record(file: str, number: int, value: Json) -> Record:
    time_s = value.pop("t", None)
    if type(time_s) not in (int, float) or not 0 <= time_s < float("inf"):
        raise _invalid_value(file, number, "t", time_s, ">= 0")
    kinds = [kind for kind in RECORD_KINDS if kind in value]
    if len(kinds) != 1:
        raise _invalid_value(file, number, RECORD_KINDS, kinds or "-", "1")
    content = value.pop(kinds[0])
    if kinds[0] == "event":
        return EventRecord(time_s, str(content), value, number)
    line_errors = value.get("line_errors", 0)
    data = _parse_hex(file, number, kinds[0], content)
    if type(line_errors) is not int or line_errors < 0:
        raise _invalid_value(file, number, "line_errors", line_errors, ">= 0")
    return BytesRecord(time_s, "rx" if kinds[0] == "rx" else "tx", data, line_errors, number)


def _parse_hex(file: str, number: int, kind: str, content: Any) -> bytes:
    """Parse pairs of lower-case hex digits only, as the writer writes them (``bytes.fromhex`` alone skips blanks)."""
    try:
        data = bytes.fromhex(content)
    except (TypeError, ValueError):
        data = None
    if data is None or data.hex() != content:
        raise _invalid_value(file, number, kind, content, "00…ff")
    return data


def _invalid_value(
    file: str, line: int, key: str | Sequence[str], found: Any, expected: str | Sequence[str]
) -> CaptureError:
    return CaptureError("capture.value", file=file, line=line, name=key, found=found, expected=expected)


def _header_line(header: CaptureHeader) -> str:
    value = {
        "dbcap": VERSION,
        "baud": header.settings.baud,
        "format": header.settings.format,
        "port": header.port,
        "started": header.started,
        "writer": header.writer,
    }
    return json.dumps(value, ensure_ascii=False) + "\n"
