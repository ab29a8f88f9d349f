"""Values of a ``plant.toml``; every default is documented in the reference."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivebus.service import config
from drivebus.service.config.load import state_directory_of
from drivebus.service.config.model import OnClientLost, OnRestart, OnServiceStop

SAMPLES = sorted(Path(config.__file__).parent.glob("sample.*.toml"))
SMALL = """
format = 1
[plant]
id = "small"
[bus.a]
link = "sim://c320@1"
[drive.fan]
bus = "a"
address = 1
model = "c320"
"""


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.name)
def test_the_sample_loads(path: Path) -> None:
    plant = config.load(path)
    assert (plant.id, plant.source) == ("boiler-house", str(path))
    assert [drive.id for drive in plant.drives] == ["fan-1", "fan-2", "pump-1"]
    assert plant.groups[0].ratios == {"fan-2": 0.9}
    assert plant.drive("fan-1").limits.maximum_hz == 45.0


def test_a_byte_order_mark_is_skipped(tmp_path: Path) -> None:
    """Windows editors write one."""
    path = tmp_path / "plant.toml"
    path.write_text(SMALL.lstrip(), encoding="utf-8-sig")
    assert config.load(path).id == "small"
    path.write_text('[plant]\nid = "small"\ndirectory = "here"\n[bus', encoding="utf-8-sig")
    assert state_directory_of(str(path)) == tmp_path / "here", "a stop finds the service"


def test_by_default_a_restart_adopts_a_running_drive_and_the_end_of_the_service_stops_it() -> None:
    drive = config.loads(SMALL).drive("fan")
    policies = (drive.on_client_lost, drive.on_service_stop, drive.on_restart)
    assert policies == (OnClientLost.HOLD, OnServiceStop.STOP, OnRestart.ADOPT)


def test_the_default_state_directory_is_below_the_users_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert config.loads(SMALL).directory == tmp_path / "drivebus" / "plants" / "small"
    named = SMALL.replace('id = "small"', 'id = "small"\ndirectory = "state"')
    assert config.loads(named, base=tmp_path).directory == tmp_path / "state"


def test_a_title_may_be_one_name_for_both_languages() -> None:
    plant = config.loads(SMALL.replace('id = "small"', 'id = "small"\ntitle = "Line 3"'))
    assert (plant.title.en, plant.title.zh) == ("Line 3", "Line 3")
    assert plant.drive("fan").title.zh == "fan"
