"""Taking a plant out of use: the commands of the page remove everything that the service wrote."""

from __future__ import annotations

import configparser
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import drivebus.service
from fixtures.child_process import CHILD_TIMEOUT_S
from fixtures.service import SHOP_FILE

PAGES = Path(__file__).resolve().parents[3] / "docs" / "how-to"
UNIT = Path(drivebus.service.__file__).parent / "systemd" / "drivebus.service"
DRIVEBUS = [sys.executable, "-m", "drivebus"]
FOREIGN_PROGRAMS = ("systemctl", "userdel")


def removal(language: str) -> str:
    """Return the commands of the page that take a service out of use."""
    text = (PAGES / ("run-as-a-service.md" if language == "en" else "run-as-a-service.zh.md")).read_text()
    (commands,) = re.findall(r"^```\n(systemctl disable .+?)^```", text, re.DOTALL | re.MULTILINE)
    return str(commands)


def files_below(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if not path.is_dir() or path.is_symlink()}


def use_service(plant: str, environment: dict[str, str]) -> None:
    """Run the service as the unit does, add a user, stop everything, and end it in order."""
    words = [*DRIVEBUS, "user", "add", plant, "anna", "--role", "administrator"]
    subprocess.run(words, env=environment, input="a long enough pass phrase\n" * 2, text=True, check=True)
    with subprocess.Popen([*DRIVEBUS, "serve", plant], env=environment, stdout=subprocess.PIPE, text=True) as serving:
        try:
            assert serving.stdout is not None and "running" in serving.stdout.readline()
            subprocess.run([*DRIVEBUS, "stop", "--all", plant], env=environment, check=True)
            serving.send_signal(signal.SIGTERM)
            assert serving.wait(CHILD_TIMEOUT_S) == 0
        finally:
            serving.kill()


@pytest.mark.parametrize("language", ["en", "zh"])
def test_after_the_commands_of_the_page_nothing_is_left_of_a_service(language: str, tmp_path: Path) -> None:
    root, programs = tmp_path / "root", tmp_path / "programs"
    for folder in ("etc/drivebus", "etc/systemd/system/drivebus.service.d", "opt/drivebus/bin", "usr/local/bin", "tmp"):
        (root / folder).mkdir(parents=True)
    state = root / "var/lib/drivebus/plants/hall"
    plant = SHOP_FILE.replace('"state"', f'"{state}"') + "[gateway.web]\nport = 0\n"
    (root / "etc/drivebus/plant.toml").write_text(plant)
    shutil.copy(UNIT, root / "etc/systemd/system")
    (root / "etc/systemd/system/drivebus.service.d/override.conf").write_text("[Service]\n")
    (root / "opt/drivebus/bin/drivebus").touch()
    (root / "usr/local/bin/drivebus").symlink_to(root / "opt/drivebus/bin/drivebus")
    before = files_below(root)
    user = {"HOME": str(root / "home"), "XDG_STATE_HOME": str(root / "var/lib"), "TMPDIR": str(root / "tmp")}
    use_service(
        str(root / "etc/drivebus/plant.toml"), {**os.environ, **user, "DRIVEBUS_LANG": "en", "PYTHONUNBUFFERED": "1"}
    )
    written = files_below(root) - before
    assert {"var/lib/drivebus/plants/hall/audit.jsonl", "var/lib/drivebus/plants/hall.audit.key"} < written
    assert {path for path in written if not path.startswith("var/lib/drivebus/")} == set()

    programs.mkdir()
    for name in FOREIGN_PROGRAMS:
        (programs / name).write_text("#!/bin/sh\n")
        (programs / name).chmod(0o755)
    commands = re.sub(r"(?<= )/", f"{root}/", removal(language))
    subprocess.run(["sh", "-e", "-c", commands], env={"PATH": f"{programs}:/usr/bin:/bin"}, check=True)
    assert files_below(root) == set()


def test_a_service_logs_to_standard_error_and_its_audit_trail_alone(tmp_path: Path) -> None:
    """Its other files keep values, alarms and settings; no library and no gateway writes a log elsewhere."""
    state, plant = tmp_path / "state", tmp_path / "plant.toml"
    plant.write_text(SHOP_FILE + "[gateway.web]\nport = 0\n")
    program = """
import logging, sys
from drivebus.service.process import main
from drivebus.service.process.logging_setup import configure_logging
import drivebus.web.server
configure_logging("text")
loggers = [logging.root, *logging.root.manager.loggerDict.values()]
handlers = {type(handler).__name__ for logger in loggers for handler in getattr(logger, "handlers", [])}
print(handlers - {"NullHandler"})
logging.getLogger("drivebus.service").warning("a sentence of the log")
logging.getLogger("uvicorn.error").warning("a sentence of a library")
"""
    home = {**os.environ, "HOME": str(tmp_path), "XDG_STATE_HOME": str(tmp_path / "xdg"), "PYTHONUNBUFFERED": "1"}
    options = {"env": home, "cwd": tmp_path, "capture_output": True, "text": True}
    found = subprocess.run([sys.executable, "-c", program], check=True, **options)  # type: ignore[call-overload]
    assert found.stdout == "{'NonBlockingQueueHandler'}\n"
    assert "a sentence of the log" in found.stderr and "a sentence of a library" in found.stderr
    assert files_below(tmp_path) == {"plant.toml"}
    use_service(str(plant), home | {"DRIVEBUS_LANG": "en"})
    assert {path for path in files_below(state) if b"plant.stop" in (state / path).read_bytes()} == {"audit.jsonl"}


def test_the_commands_remove_the_directories_that_systemd_makes_for_the_unit() -> None:
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.read(UNIT)
    removed = removal("en").split()
    assert f"/var/lib/{unit['Service']['StateDirectory']}" in removed
    assert f"/run/{unit['Service']['RuntimeDirectory']}" in removed
    assert removal("zh") == removal("en")
