"""Incidents on disk: one folder each, written atomically, bounded in number and size.

Every function blocks for as long as the disk takes.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Lock
from typing import Final

from drivebus.atomic_write import atomic_write_private, fsync_directory
from drivebus.capture.dbcap import CaptureError, CaptureHeader, CaptureWriter
from drivebus.errors import NotFound, ServiceError, ServiceUnavailable, SystemReason
from drivebus.service.api.errors import localized
from drivebus.service.api.paging import page
from drivebus.service.api.strict_json import parse_json
from drivebus.service.ids import ID_CHARACTERS
from drivebus.types import Json

INCIDENT_ID: Final = re.compile(rf"(\d{{6,12}})-{ID_CHARACTERS}")  # number and drive
MAX_INCIDENTS: Final = 200
MAX_INCIDENT_BYTES: Final = 200 * 1024 * 1024
"""All incidents together; beyond it the oldest are deleted."""
INCIDENT_FILE: Final = "incident.json"
SUMMARY_FILE: Final = "summary.json"
PARAMETERS_FILE: Final = "parameters.json"
CAPTURE_FILE: Final = "frames.dbcap"
NOTES_FILE: Final = "notes.json"
ALARM_TEXTS: Final = ("title", "text")
"""Texts of an incident that its alarm may change later."""
MAX_NOTES: Final = 100
"""Notes of one incident."""
WireFrames = Sequence[tuple[float, bool, bytes]]
"""Monotonic second, whether drivebus sent it, its bytes."""


class IncidentStore:
    """Incidents in ``folder``."""

    def __init__(self, folder: Path, max_incidents: int = MAX_INCIDENTS, max_bytes: int = MAX_INCIDENT_BYTES) -> None:
        self.folder, self._max_incidents, self._max_bytes = folder, max_incidents, max_bytes
        self._lock = Lock()

    def write(self, drive: str, summary: Json, incident: Json, header: CaptureHeader, frames: WireFrames) -> str:
        """Write an incident durably and return its id. Raises OSError; then nothing was written."""
        with self._lock:
            return self._write(drive, summary, incident, header, frames)

    def _write(self, drive: str, summary: Json, incident: Json, header: CaptureHeader, frames: WireFrames) -> str:
        self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        self._remove_partial()
        number = 1 + max(map(_incident_number, self._ids()), default=0)
        id = f"{number:06}-{drive or 'plant'}"
        part = self.folder / f".{id}"
        part.mkdir(mode=0o700)
        _write_capture(part / CAPTURE_FILE, header, frames)
        atomic_write_private(part / INCIDENT_FILE, _encode({"id": id, **summary, **incident}))
        atomic_write_private(part / SUMMARY_FILE, _encode({"id": id, **summary}))
        part.rename(self.folder / id)
        fsync_directory(self.folder)
        self._limit_size()
        return id

    def add_parameters(self, id: str, parameters: Mapping[str, Json]) -> None:
        """Add parameters read from the drive afterwards. Raises NotFound, OSError."""
        atomic_write_private(self._path(id) / PARAMETERS_FILE, _encode(dict(parameters)))

    def rename(self, id: str, alarm: Json) -> None:
        """Replace title and text of an incident by those of its alarm. Raises NotFound, OSError."""
        with self._lock:
            path = self._path(id) / SUMMARY_FILE
            summary = _read_json(path)
            if summary is not None:
                atomic_write_private(path, _encode(summary | {name: alarm[name] for name in ALARM_TEXTS}))

    def add_note(self, id: str, note: Json) -> list[Json]:
        """Add a note and return all, oldest first; beyond ``MAX_NOTES`` the oldest is dropped.

        Raises NotFound, ServiceUnavailable.
        """
        with self._lock, self._disk_errors():
            path = self._path(id) / NOTES_FILE
            notes = [*_read_notes(path), note][-MAX_NOTES:]
            atomic_write_private(path, _encode({"notes": notes}))
            return notes

    def get(self, id: str) -> Json:
        """Return an incident, with ``parameters`` (None if not read), ``notes`` and the bus's frames as ``capture``.

        Damaged bytes of the capture become escapes; it is None where its file can't be read, with the reason as
        ``capture_problem``. Raises NotFound, ServiceUnavailable, and ServiceError where the incident's own file is
        missing or damaged.
        """
        with self._disk_errors():
            path = self._path(id)
        incident = _read_json(path / INCIDENT_FILE)
        if incident is None or not _is_summary(incident):
            raise ServiceError("alarms.incident_damaged", incident=id, file=str(path / INCIDENT_FILE))
        summary = _read_json(path / SUMMARY_FILE) or incident
        return {
            **incident,
            **{name: summary[name] for name in ALARM_TEXTS if name in summary},
            "parameters": _read_json(path / PARAMETERS_FILE),
            "notes": _read_notes(path / NOTES_FILE),
            **_read_capture(path / CAPTURE_FILE, f"{id}.dbcap"),
        }

    def query(
        self, from_ms: int, to_ms: int, drive: str | None = None, cursor: str | None = None, limit: int = 100
    ) -> Json:
        """Return a page of summaries, newest first. Raises InvalidParameters (cursor), ServiceUnavailable."""
        with self._disk_errors():
            ids = self._ids()
        summaries = ((_incident_number(id), _read_json(self.folder / id / SUMMARY_FILE)) for id in reversed(ids))
        wanted = (
            (number, summary)
            for number, summary in summaries
            if summary is not None
            and _is_summary(summary)
            and from_ms <= summary["time_ms"] < to_ms
            and drive in (None, summary["drive"])
        )
        return page(((number, lambda summary=summary: summary) for number, summary in wanted), cursor, limit)  # type: ignore[misc]

    @contextmanager
    def _disk_errors(self) -> Iterator[None]:
        """Raise ServiceUnavailable for an error of the disk."""
        try:
            yield
        except OSError as error:
            folder, reason = str(self.folder), SystemReason(error)
            raise ServiceUnavailable("alarms.incidents_inaccessible", folder=folder, reason=reason) from error

    def _path(self, id: str) -> Path:
        """Return an incident's folder. Only ids of the strict form are accepted, so that none leads elsewhere."""
        if not INCIDENT_ID.fullmatch(id) or not (self.folder / id).is_dir():
            raise NotFound("alarms.no_incident", incident=id)
        return self.folder / id

    def _ids(self) -> list[str]:
        if not self.folder.is_dir():
            return []
        ids = [path.name for path in self.folder.iterdir() if INCIDENT_ID.fullmatch(path.name) and path.is_dir()]
        return sorted(ids, key=_incident_number)

    def _remove_partial(self) -> None:
        """Delete folders that an interrupted write left."""
        for path in self.folder.iterdir():
            if path.name.startswith("."):
                shutil.rmtree(path, ignore_errors=True)

    def _limit_size(self) -> None:
        ids = self._ids()
        sizes = [sum(file.stat().st_size for file in (self.folder / id).iterdir()) for id in ids]
        while len(ids) > 1 and (len(ids) > self._max_incidents or sum(sizes) > self._max_bytes):
            sizes.pop(0)
            self._remove(ids.pop(0))

    def _remove(self, id: str) -> None:
        """Hide the incident at once, then delete it."""
        with suppress(OSError):
            hidden = (self.folder / id).rename(self.folder / f".{id}")
            shutil.rmtree(hidden, ignore_errors=True)


def _incident_number(id: str) -> int:
    return int(id.partition("-")[0])


def _encode(value: Json) -> bytes:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":")).encode("utf-8", "backslashreplace")


def _read_json(path: Path) -> Json | None:
    """Return the object in a file; None if it is missing or damaged."""
    try:
        document = parse_json(path.read_bytes())
    except (OSError, ValueError):
        return None
    return document if isinstance(document, dict) else None


def _read_capture(path: Path, name: str) -> Json:
    """Return a capture file as text, or why there is none."""
    try:
        text = path.read_text(encoding="utf-8", errors="backslashreplace")
    except OSError as error:
        problem = localized("alarms.capture_unread", {"file": str(path), "reason": SystemReason(error)})
        return {"capture": None, "capture_problem": problem}
    return {"capture": {"name": name, "text": text}, "capture_problem": None}


def _is_summary(stored: Json) -> bool:
    """Return whether a stored object is a summary; a damaged one would keep all others from being listed."""
    return type(stored.get("time_ms")) is int and type(stored.get("drive")) is str


def _read_notes(path: Path) -> list[Json]:
    notes = (_read_json(path) or {}).get("notes")
    return [note for note in notes if isinstance(note, dict)] if isinstance(notes, list) else []


def _write_capture(path: Path, header: CaptureHeader, frames: WireFrames) -> None:
    """Write the frames as a capture file, as a recording port would. Raises OSError."""
    ordered = sorted(frames, key=lambda frame: frame[0])
    try:
        writer = CaptureWriter(path, header, now=ordered[0][0] if ordered else 0.0)
    except CaptureError as error:
        raise error.__cause__ or error from None
    for at, sent, data in ordered:
        if data:
            writer.write_bytes(at, "tx" if sent else "rx", data)
    writer.close()
    if writer.error is not None:
        raise writer.error
