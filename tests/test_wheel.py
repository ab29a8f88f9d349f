"""Content of the wheel: the package and its metadata, no data of version control and no other hidden file."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).resolve().parents[1]


def test_the_wheel_has_the_package_and_nothing_of_version_control(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    names = [PurePosixPath(name) for name in zipfile.ZipFile(wheel).namelist()]
    version = wheel.name.split("-")[1]
    assert {name.parts[0] for name in names} == {"drivebus", f"drivebus-{version}.dist-info"}
    assert [str(name) for name in names if any(part.startswith(".") for part in name.parts)] == []
    package = [name for name in names if name.parts[0] == "drivebus"]
    suffixes = {".py", ".typed", ".toml", ".json", ".js", ".css", ".txt", ".svg", ".html", ".service"}
    assert {name.suffix or name.name for name in package} == suffixes
    assert len(package) > 800
