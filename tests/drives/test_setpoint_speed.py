"""A setpoint in revolutions per minute, which the pole pairs of the motor make a frequency."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.commissioning.profile_simulator import ProfileStation
from drivebus.drives import Drive, create_dialect
from drivebus.errors import ConfigurationError, LimitError
from drivebus.ports import open_port
from drivebus.profiles.model import DriveProfile
from drivebus.testing.virtual_time import run


def speed_profile(folder: Path) -> DriveProfile:
    """Return a Goodrive as if it took its setpoint in steps of 1 rpm."""
    text = (Path(profiles.load("gd10").source).parent / "_goodrive.toml").read_text(encoding="utf-8")
    hertz = "[setpoint]\nfactor = 0.01\ndecimals = 2\n"
    assert hertz in text
    speed = text.replace(hertz, "[setpoint]\nrpm = 1.0\n", 1)
    file = folder / "speed.toml"
    head = 'format = 1\nmodel = "speed"\ntitle = { en = "Speed", zh = "转速" }'
    file.write_text(speed.replace("format = 1", head, 1), encoding="utf-8")
    return profiles.load(file)


@pytest.mark.parametrize(("pairs", "word"), [(1, 1500), (2, 750), (3, 500)])
def test_a_frequency_is_written_as_a_speed(tmp_path: Path, pairs: int, word: int) -> None:
    dialect: Any = create_dialect(speed_profile(tmp_path), 3, options={"pole_pairs": pairs})
    assert dialect.setpoint_word(25.0) == word
    assert dialect.setpoint_frequency(word) == 25.0


@pytest.mark.parametrize("frequency_hz", [0.01, 7.14, 33.33, 49.99])
def test_a_speed_is_never_more_than_the_frequency_that_was_asked_for(tmp_path: Path, frequency_hz: float) -> None:
    dialect: Any = create_dialect(speed_profile(tmp_path), 3, options={"pole_pairs": 4})
    step_hz = 4 / 60
    assert frequency_hz - step_hz < dialect.setpoint_word(frequency_hz) * step_hz <= frequency_hz


def test_nothing_is_written_before_the_pole_pairs_are_given(tmp_path: Path) -> None:
    """With one pole pair for two the motor would turn twice as fast as the limits allow."""
    profile = speed_profile(tmp_path)
    with pytest.raises(LimitError, match="pole_pairs=N") as caught:
        create_dialect(profile, 3).setpoint_word(10.0)
    assert caught.value.key == "drives.pole_pairs_unknown"
    assert create_dialect(profile, 3, options={"pole_pairs": 2}).setpoint_word(10.0)

    async def tell() -> None:
        port: Any = open_port("sim://gd10@3?line_quality=clean")
        async with Bus(port) as bus:
            with pytest.raises(LimitError, match="pole_pairs=N"):
                await Drive(bus, profile, 3).run(10.0)
            assert port.simulated_bus.stations[0].setpoint_word == 0

    run(tell())


@pytest.mark.parametrize(("pairs", "allowed"), [(0, True), (1, True), (24, True), (25, False), (-1, False)])
def test_the_pole_pairs_are_those_of_a_motor(tmp_path: Path, pairs: int, allowed: bool) -> None:
    profile = speed_profile(tmp_path)
    assert profile.question("pole_pairs").allows(pairs) is allowed
    if not allowed:
        with pytest.raises(ConfigurationError, match="1 … 24"):
            create_dialect(profile, 3, options={"pole_pairs": pairs})


def test_a_simulated_motor_of_two_pole_pairs_turns_at_the_speed_that_was_written(tmp_path: Path) -> None:
    station = ProfileStation(3, profile=replace(speed_profile(tmp_path), model="speed"))
    assert station.setpoint_scale.value(750) == 25.0
