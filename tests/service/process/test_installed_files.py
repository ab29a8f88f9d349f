"""Installed files that were changed: found by ``check`` in a real installation, and announced by the service."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from drivebus.service.process.installed_files import ChangedPackage, changed_packages
from drivebus.service.runtime import supervision
from fixtures.service import SHOP_FILE, running_service

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def installation(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with an installed drivebus, and a plant file beside it."""
    folder = tmp_path_factory.mktemp("installed")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    install = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "-q",
        "--no-deps",
        "--no-index",
        "--target",
        str(folder / "site"),
    ]
    subprocess.run([*install, str(wheel)], check=True, capture_output=True)
    (folder / "plant.toml").write_text(SHOP_FILE)
    return folder


def run_check(installation: Path, *options: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(installation / "site"), "DRIVEBUS_LANG": "en", "COLUMNS": "1000"}
    words = [sys.executable, "-m", "drivebus", "check", str(installation / "plant.toml"), *options]
    return subprocess.run(words, env=environment, capture_output=True, text=True, check=True, cwd=installation)


def changed_files(installation: Path) -> list[str]:
    found: list[str] = json.loads(run_check(installation, "--json").stdout)["changed_files"]
    return found


def test_check_names_an_installed_file_that_was_changed_or_is_missing(installation: Path) -> None:
    changed, removed = (installation / "site/drivebus" / name for name in ("clock.py", "profiles/data/weg/cfw11.toml"))
    assert changed_files(installation) == []
    assert "--force-reinstall" not in run_check(installation).stderr
    content, missing = changed.read_bytes(), removed.read_bytes()
    try:
        changed.write_bytes(content + b"\n")
        removed.unlink()
        assert changed_files(installation) == [str(changed), str(removed)]
        printed = run_check(installation).stderr
        assert f"number: 2, first: {changed}" in printed and "--force-reinstall" in printed
    finally:
        changed.write_bytes(content)
        removed.write_bytes(missing)
    assert changed_files(installation) == []


@pytest.mark.parametrize("damage", [b"\xff\xfe", b"drivebus/clock.py\n"])
def test_a_damaged_list_of_files_is_named_itself(installation: Path, damage: bytes) -> None:
    """Bytes that are no text, and a line that ends too early."""
    (record,) = (installation / "site").glob("*.dist-info/RECORD")
    content = record.read_bytes()
    try:
        record.write_bytes(damage)
        assert changed_files(installation) == [str(record)]
    finally:
        record.write_bytes(content)


def test_packages_of_another_installer_and_what_an_update_left_over_are_not_compared(installation: Path) -> None:
    """Debian lists the files of a package and changes some of them afterwards; pip renames a folder that it removes."""
    (record,) = (installation / "site").glob("*.dist-info/RECORD")
    for folder, installer in (("blinker-1.4.dist-info", "debian\n"), ("~rivebus-0.9.dist-info", "pip\n")):
        other = installation / "site" / folder
        other.mkdir()
        (other / "INSTALLER").write_text(installer)
        (other / "RECORD").write_text("absent.py,sha256=0,1\n")
    content = record.read_text(encoding="utf-8")
    record.write_text(content + "\n", encoding="utf-8")  # an empty line is no damage
    assert changed_files(installation) == []
    record.write_text(content, encoding="utf-8")


def test_an_editable_installation_has_no_changed_files() -> None:
    """Its files are meant to be changed."""
    assert list(changed_packages()) == []


async def test_the_service_announces_a_changed_package_once(monkeypatch: pytest.MonkeyPatch) -> None:
    changed = ChangedPackage(
        "uvicorn", (Path("/opt/drivebus/uvicorn/main.py"), Path("/opt/drivebus/uvicorn/config.py"))
    )
    monkeypatch.setattr(supervision, "changed_packages", lambda: [changed])
    async with running_service() as kit:
        for _ in range(2):
            await kit.service.supervision._check_disk()
        (text,) = [text for text in kit.event_texts() if "uvicorn" in text]
        assert "number: 2, first: /opt/drivebus/uvicorn/main.py" in text and "--force-reinstall" in text
        assert kit.service.plant.alarms.active() == []
