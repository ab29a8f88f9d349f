"""Cases on disk: a folder each, there whole or not at all, of bounded number and size. No clock lives here."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from threading import Lock
from typing import Final

from drivebus.atomic_write import fsync_directory
from drivebus.capture.dbcap import CaptureError, CaptureHeader, CaptureWriter
from drivebus.errors import NotFound
from drivebus.service.api.paging import page
from drivebus.service.live.views import Json
from drivebus.service.storage.append_log import write_durably

INCIDENT_ID: Final = re.compile(r"(\d{6,12})-[a-z0-9][a-z0-9_-]{0,63}")
MAX_INCIDENTS: Final = 200
MAX_INCIDENT_BYTES: Final = 200 * 1024 * 1024
"""Octets of all cases together; the oldest go first (I12)."""
CAPTURE_FILE: Final = "line.dbcap"
WireFrames = Sequence[tuple[float, bool, bytes]]
"""Monotonic second, did we send it, its bytes."""


class IncidentStore:
    """The cases in ``folder``. Every function takes as long as a disk does."""

    def __init__(self, folder: Path, max_incidents: int = MAX_INCIDENTS, max_bytes: int = MAX_INCIDENT_BYTES) -> None:
        self.folder, self._max_incidents, self._max_bytes = folder, max_incidents, max_bytes
        self._lock = Lock()

    def write(self, drive: str, summary: Json, whole: Json, header: CaptureHeader, frames: WireFrames) -> str:
        """The new case's id; durable when it returns. Raises OSError, and then there is no such case."""
        with self._lock:
            return self._write(drive, summary, whole, header, frames)

    def _write(self, drive: str, summary: Json, whole: Json, header: CaptureHeader, frames: WireFrames) -> str:
        self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        self._remove_partial()
        id = f"{1 + max((_incident_number(one) for one in self._ids()), default=0):06}-{drive or 'plant'}"
        part = self.folder / f".{id}"
        part.mkdir(mode=0o700)
        _write_capture(part / CAPTURE_FILE, header, frames)
        write_durably(part / "case.json", _encode({"id": id, **summary, **whole}))
        write_durably(part / "summary.json", _encode({"id": id, **summary}))
        part.rename(self.folder / id)
        fsync_directory(self.folder)
        self._limit_size()
        return id

    def add_parameters(self, id: str, parameters: Mapping[str, Json]) -> None:
        """What was read of the drive afterwards. Raises NotFound, OSError."""
        write_durably(self._path(id) / "parameters.json", _encode(dict(parameters)))

    def get(self, id: str) -> Json:
        """The whole case, with ``parameters`` (None: not read) and the recorded line as ``capture``.

        Raises NotFound.
        """
        path = self._path(id)
        found = _read_json(path / "case.json")
        if found is None:
            raise NotFound("alarms.no_case", case=id)
        capture = {"name": f"{id}.dbcap", "text": (path / CAPTURE_FILE).read_text(encoding="utf-8")}
        return found | {"parameters": _read_json(path / "parameters.json"), "capture": capture}

    def list(
        self, from_ms: int, to_ms: int, drive: str | None = None, cursor: str | None = None, limit: int = 100
    ) -> Json:
        """Summaries, the newest first. Raises InvalidParameters for a cursor of somebody else's."""
        found = ((_incident_number(id), _read_json(self.folder / id / "summary.json")) for id in reversed(self._ids()))
        wanted = (
            (number, one)
            for number, one in found
            if one is not None and from_ms <= one["time_ms"] < to_ms and drive in (None, one["drive"])
        )
        return page(((number, lambda one=one: one) for number, one in wanted), cursor, limit)  # type: ignore[misc]

    def _path(self, id: str) -> Path:
        """Nobody reaches out of the folder by a name (S19)."""
        if not INCIDENT_ID.fullmatch(id) or not (self.folder / id).is_dir():
            raise NotFound("alarms.no_case", case=id)
        return self.folder / id

    def _ids(self) -> Sequence[str]:
        if not self.folder.is_dir():
            return []
        return sorted(
            (one.name for one in self.folder.iterdir() if INCIDENT_ID.fullmatch(one.name)), key=_incident_number
        )

    def _remove_partial(self) -> None:
        """What a killed writer left half."""
        for one in self.folder.iterdir():
            if one.name.startswith("."):
                shutil.rmtree(one, ignore_errors=True)

    def _limit_size(self) -> None:
        ids = list(self._ids())
        sizes = [sum(file.stat().st_size for file in (self.folder / id).iterdir()) for id in ids]
        while len(ids) > 1 and (len(ids) > self._max_incidents or sum(sizes) > self._max_bytes):
            sizes.pop(0)
            self._remove(ids.pop(0))

    def _remove(self, id: str) -> None:
        """Out of the list at once, then from the disk."""
        with suppress(OSError):
            gone = (self.folder / id).rename(self.folder / f".{id}")
            shutil.rmtree(gone, ignore_errors=True)


def _incident_number(id: str) -> int:
    return int(id.partition("-")[0])


def _encode(value: Json) -> bytes:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":")).encode("utf-8", "backslashreplace")


def _read_json(path: Path) -> Json | None:
    """None where it is not there, or was spoilt."""
    try:
        found = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def _write_capture(path: Path, header: CaptureHeader, frames: WireFrames) -> None:
    """As the port would have recorded it: ``drivebus capture`` and ``monitor`` open it. Raises OSError."""
    ordered = sorted(frames, key=lambda frame: frame[0])
    try:
        writer = CaptureWriter(path, header, now=ordered[0][0] if ordered else 0.0)
    except CaptureError as error:
        raise OSError(str(error)) from error
    for at, sent, data in ordered:
        if data:
            writer.write_bytes(at, "tx" if sent else "rx", data)
    writer.close()
    if writer.error is not None:
        raise writer.error
