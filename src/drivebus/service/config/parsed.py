"""A file on its way to a ``PlantConfig``: what of it is well-formed, and what else it names."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivebus import profiles
from drivebus.drives.dialects.base import Dialect
from drivebus.errors import ProfileError
from drivebus.ports.url import PortUrl
from drivebus.profiles.model import DriveProfile
from drivebus.service.config.schema import DriveTable, PlantFile


@dataclass(slots=True)
class ParsedPlant:
    """The well-formed part of a file; checks fill in what they find out."""

    file: PlantFile
    raw: Mapping[str, Any]
    """The whole of it: a table with a fault in it is still known by name."""
    base: Path
    """Folder from which relative paths count."""
    profiles: dict[str, DriveProfile] = field(default_factory=dict)
    """Drive → profile, where it could be read."""
    profile_errors: dict[str, ProfileError] = field(default_factory=dict)
    """Drive → why its profile could not."""
    links: dict[str, PortUrl] = field(default_factory=dict)
    dialects: dict[str, Dialect] = field(default_factory=dict)

    def known_ids(self, table: str) -> list[str]:
        """The ids of ``[bus.…]``, ``[drive.…]``, with faults in them or not."""
        found = self.raw.get(table)
        return [str(name) for name in found] if isinstance(found, Mapping) else []

    def drives_on(self, bus: str) -> Iterator[tuple[str, DriveTable]]:
        """The drives of a bus, in the order of the file, which is the order of the cable."""
        return ((name, drive) for name, drive in self.file.drive.items() if drive.bus == bus)

    def model_of(self, drive: DriveTable) -> str:
        """A model's name, or the absolute path of a file."""
        if not is_model_path(drive.model):
            return drive.model
        return str((self.base / Path(drive.model).expanduser()).resolve())

    def resolve_path(self, text: str) -> Path:
        return (self.base / Path(text).expanduser()).resolve()

    def read_profiles(self) -> None:
        """Load every drive's profile; one model is read once."""
        read: dict[str, DriveProfile | ProfileError] = {}
        for name, drive in self.file.drive.items():
            model = self.model_of(drive)
            if model not in read:
                try:
                    read[model] = profiles.load(model)
                except ProfileError as error:
                    read[model] = error
            found = read[model]
            if isinstance(found, DriveProfile):
                self.profiles[name] = found
            else:
                self.profile_errors[name] = found


def is_model_path(model: str) -> bool:
    return model.endswith(".toml") or "/" in model or "\\" in model
