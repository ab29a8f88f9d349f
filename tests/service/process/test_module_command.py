"""Child processes that run a module: which code they import."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from drivebus.service.process.module_command import module_command
from drivebus.service.runtime.configuration_check import ConfigurationCheck
from fixtures.service import plant_config

SOURCE = Path(__file__).resolve().parents[3] / "src" / "drivebus"


def test_a_module_in_the_working_directory_is_not_executed(tmp_path: Path) -> None:
    """A service that is started in /tmp must not execute what another user of the machine put there."""
    for name in ("drivebus", "json", "pydantic"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'executed')!r}, 'w')")
    command = module_command("drivebus.service.audit", *(str(tmp_path / name) for name in "abcd"))
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert '"problems"' in ended.stdout, ended.stderr
    assert not (tmp_path / "executed").exists()


async def test_a_configuration_is_checked_without_code_of_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pydantic.py").write_text(f"open({str(tmp_path / 'executed')!r}, 'w')")
    monkeypatch.chdir(tmp_path)
    found = await ConfigurationCheck().check("", plant_config(directory=tmp_path, source=str(tmp_path / "plant.toml")))
    assert found["diagnostics"] and not (tmp_path / "executed").exists()


def test_no_child_process_runs_a_module_in_another_way() -> None:
    having = [path.name for path in SOURCE.rglob("*.py") if '"-m"' in path.read_text(encoding="utf-8")]
    assert having == ["module_command.py"]
