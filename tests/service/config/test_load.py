"""Values of a ``plant.toml``; every default is documented in the reference."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivebus.errors import ConfigurationError
from drivebus.service import config
from drivebus.service.config.load import loads, state_directory_of
from drivebus.service.config.model import OnClientLost, OnRestart, OnServiceStop, title_of
from fixtures.service import SHOP_FILE

SAMPLES = sorted(Path(config.__file__).parent.glob("sample.*.toml"))
SMALL = """
format = 1
[plant]
id = "small"
[bus.a]
port = "sim://c320@1"
[drive.fan]
bus = "a"
address = 1
model = "c320"
"""


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.name)
def test_a_sample_plant_loads_with_its_drives_groups_and_limits(path: Path) -> None:
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


def test_a_title_may_be_in_any_languages(tmp_path: Path) -> None:
    """Titles of exactly en and zh: a third language was an unknown key, and one language a missing key."""
    path = tmp_path / "plant.toml"
    path.write_text(
        "format = 1\n[plant]\nid = 'p'\ntitle = { en = 'Mill', zh = '磨坊', de = 'Mühle' }\n"
        "[bus.a]\nport = 'sim://c320@1-3'\ntitle = { de = 'Sammelschiene' }\n"
        "[gateway.web]\nlogin_notice = { en = 'staff only', pt-BR = 'somente equipe' }\n",
        encoding="utf-8",
    )
    plant = config.load(path)
    assert plant.title.by_language() == {"en": "Mill", "zh": "磨坊", "de": "Mühle"}
    assert plant.buses[0].title.in_language("en") == "Sammelschiene"
    assert title_of(plant.buses[0]).in_language("de") == "Sammelschiene"
    notice = plant.gateway("web").settings.login_notice
    assert (notice.zh, notice.in_language("pt-BR")) == ("staff only", "somente equipe")


@pytest.mark.parametrize("title", ["{}", "{ English = 'x' }", "{ en = '' }", "{ en = 1 }", "1"])
def test_a_title_without_a_text_or_of_no_language_is_refused(tmp_path: Path, title: str) -> None:
    path = tmp_path / "plant.toml"
    path.write_text(f"format = 1\n[plant]\nid = 'p'\ntitle = {title}\n", encoding="utf-8")
    with pytest.raises(ConfigurationError):
        config.load(path)


def test_the_model_of_a_drive_is_taken_in_any_case(tmp_path: Path) -> None:
    plant = loads(SHOP_FILE.replace('"c320"', '"C320"'), "plant.toml", tmp_path)
    assert [drive.model for drive in plant.drives] == ["c320"] * len(plant.drives)
