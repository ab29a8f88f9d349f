"""Installed files that differ from those that were installed: each package lists the hashes of its files (RECORD)."""

from __future__ import annotations

import csv
import json
from base64 import urlsafe_b64encode
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import Distribution, distribution
from pathlib import Path

from drivebus.types import Json

HASH = "sha256="  # written by pip and uv; a file with another hash is not compared
INSTALLERS = ("pip", "uv")
READ_BLOCK_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class ChangedPackage:
    """Installed package of which files are missing or have another content than when it was installed."""

    package: str
    """Name and version."""
    files: tuple[Path, ...]

    def text_params(self) -> Json:
        """Return the parameters of the sentence ``plant.package_changed``."""
        return {"package": self.package, "count": len(self.files), "file": str(self.files[0])}


def changed_packages() -> Iterator[ChangedPackage]:
    """Yield each changed package of the folder in which drivebus is installed; none for an editable installation.

    A damaged disk and a change by hand are found; a person who changes a file can change its hash as well. Packages of
    another installer than pip and uv are left out: that of a Linux distribution changes files after it has listed them.
    """
    own = distribution("drivebus")
    if _is_editable(own):
        return
    for folder in sorted(Path(str(own.locate_file(""))).glob("[!~]*.dist-info")):  # ~: left over by an update of pip
        files = tuple(_changed_files(folder / "RECORD")) if _installer(folder) in INSTALLERS else ()
        if files:
            yield ChangedPackage(folder.name.removesuffix(".dist-info"), files)


def _is_editable(package: Distribution) -> bool:
    with suppress(OSError, ValueError, AttributeError):  # a damaged file or disk
        return bool(json.loads(package.read_text("direct_url.json") or "{}").get("dir_info", {}).get("editable"))
    return False


def _installer(folder: Path) -> str:
    with suppress(OSError, ValueError):
        return (folder / "INSTALLER").read_text(encoding="utf-8").strip()
    return ""


def _changed_files(record: Path) -> Iterator[Path]:
    try:
        for name, recorded, _ in filter(None, csv.reader(record.read_text(encoding="utf-8").splitlines())):
            path = record.parent.parent / name
            is_outside = name.startswith("..")  # a command in bin, which `pip install --target` puts elsewhere
            if recorded.startswith(HASH) and not is_outside and _recorded_form(path) != recorded:
                yield path
    except (OSError, ValueError, csv.Error):
        yield record  # it is damaged itself


def _recorded_form(path: Path) -> str | None:
    """Return the hash of a file as RECORD has it; None where the file cannot be read."""
    digest = sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(READ_BLOCK_BYTES):
                digest.update(block)
    except OSError:
        return None
    return HASH + urlsafe_b64encode(digest.digest()).rstrip(b"=").decode()
