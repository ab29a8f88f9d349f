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

from drivebus.capture import CaptureError, CaptureWriter, Header
from drivebus.errors import NotFound
from drivebus.files import sync_folder
from drivebus.plant.journal import write_whole
from drivebus.plant.paging import page
from drivebus.plant.view import Json

ID: Final = re.compile(r"(\d{6,12})-[a-z0-9][a-z0-9_-]{0,63}")
KEPT: Final = 200
LARGEST: Final = 200 * 1024 * 1024
"""Octets of all cases together; the oldest go first (I12)."""
CAPTURE: Final = "line.dbcap"
Frames = Sequence[tuple[float, bool, bytes]]
"""Monotonic second, did we send it, its bytes."""


class CaseStore:
    """The cases in ``folder``. Every function takes as long as a disk does."""

    def __init__(self, folder: Path, kept: int = KEPT, largest: int = LARGEST) -> None:
        self.folder, self._kept, self._largest = folder, kept, largest
        self._one_at_a_time = Lock()

    def write(self, drive: str, summary: Json, whole: Json, header: Header, frames: Frames) -> str:
        """The new case's id; durable when it returns. Raises OSError, and then there is no such case."""
        with self._one_at_a_time:
            return self._write(drive, summary, whole, header, frames)

    def _write(self, drive: str, summary: Json, whole: Json, header: Header, frames: Frames) -> str:
        self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        self._sweep()
        id = f"{1 + max((_number(one) for one in self._ids()), default=0):06}-{drive or 'plant'}"
        part = self.folder / f".{id}"
        part.mkdir(mode=0o700)
        _capture(part / CAPTURE, header, frames)
        write_whole(part / "case.json", _json({"id": id, **summary, **whole}))
        write_whole(part / "summary.json", _json({"id": id, **summary}))
        part.rename(self.folder / id)
        sync_folder(self.folder)
        self._make_room()
        return id

    def add(self, id: str, parameters: Mapping[str, Json]) -> None:
        """What was read of the drive afterwards. Raises NotFound, OSError."""
        write_whole(self._path(id) / "parameters.json", _json(dict(parameters)))

    def get(self, id: str) -> Json:
        """The whole case, with ``parameters`` (None: not read) and the recorded line as ``capture``.

        Raises NotFound.
        """
        path = self._path(id)
        found = _read(path / "case.json")
        if found is None:
            raise NotFound("alarms.no_case", case=id)
        capture = {"name": f"{id}.dbcap", "text": (path / CAPTURE).read_text(encoding="utf-8")}
        return found | {"parameters": _read(path / "parameters.json"), "capture": capture}

    def list(
        self, from_ms: int, to_ms: int, drive: str | None = None, cursor: str | None = None, limit: int = 100
    ) -> Json:
        """Summaries, the newest first. Raises ParamsError for a cursor of somebody else's."""
        found = ((_number(id), _read(self.folder / id / "summary.json")) for id in reversed(self._ids()))
        wanted = (
            (number, one) for number, one in found
            if one is not None and from_ms <= one["time_ms"] < to_ms and drive in (None, one["drive"])
        )  # fmt: skip
        return page(((number, lambda one=one: one) for number, one in wanted), cursor, limit)  # type: ignore[misc]

    def _path(self, id: str) -> Path:
        """Nobody reaches out of the folder by a name (S19)."""
        if not ID.fullmatch(id) or not (self.folder / id).is_dir():
            raise NotFound("alarms.no_case", case=id)
        return self.folder / id

    def _ids(self) -> Sequence[str]:
        if not self.folder.is_dir():
            return []
        return sorted((one.name for one in self.folder.iterdir() if ID.fullmatch(one.name)), key=_number)

    def _sweep(self) -> None:
        """What a killed writer left half."""
        for one in self.folder.iterdir():
            if one.name.startswith("."):
                shutil.rmtree(one, ignore_errors=True)

    def _make_room(self) -> None:
        ids = list(self._ids())
        sizes = [sum(file.stat().st_size for file in (self.folder / id).iterdir()) for id in ids]
        while len(ids) > 1 and (len(ids) > self._kept or sum(sizes) > self._largest):
            sizes.pop(0)
            self._remove(ids.pop(0))

    def _remove(self, id: str) -> None:
        """Out of the list at once, then from the disk."""
        with suppress(OSError):
            gone = (self.folder / id).rename(self.folder / f".{id}")
            shutil.rmtree(gone, ignore_errors=True)


def _number(id: str) -> int:
    return int(id.partition("-")[0])


def _json(value: Json) -> bytes:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":")).encode("utf-8", "backslashreplace")


def _read(path: Path) -> Json | None:
    """None where it is not there, or was spoilt."""
    try:
        found = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def _capture(path: Path, header: Header, frames: Frames) -> None:
    """As the port would have recorded it: ``drivebus capture`` and ``monitor`` open it. Raises OSError."""
    ordered = sorted(frames, key=lambda frame: frame[0])
    try:
        writer = CaptureWriter(path, header, now=ordered[0][0] if ordered else 0.0)
    except CaptureError as error:
        raise OSError(str(error)) from error
    for at, sent, data in ordered:
        if data:
            writer.bytes(at, "tx" if sent else "rx", data)
    writer.close()
    if writer.error is not None:
        raise writer.error
