"""Step of the setpoint that a profile only assumes: 5 Hz at most under every usual step until it is calibrated."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus.statistics import DAMAGED
from drivebus.drives import Drive
from drivebus.drives.dialects.create import create_dialect
from drivebus.drives.operations.calibration import calibration_steps
from drivebus.errors import ConfigurationError, LimitError, StartInhibited, TargetNotReached
from drivebus.profiles.load import included_models
from drivebus.profiles.model import DriveProfile
from drivebus.profiles.schema import SetpointTable
from drivebus.testing.virtual_time import run
from fixtures.profile_bench import Write, profile_bench

SETPOINT = 40
ASSUMED = {"smd", "tmd", "e350", "a1000", "v1000", "t13"}
"""Included models whose step no source gives, or only for a setting that is not read."""
Scenario = Callable[[Drive, Any, list[Write]], Awaitable[None]]


def with_drive(scenario: Scenario, profile: DriveProfile | None = None) -> None:
    """Run a scenario with a drive whose step is not determined."""

    async def play() -> None:
        async with profile_bench(profile or profiles.load("smd"), setpoint_step="unknown") as parts:
            await scenario(*parts)

    run(play())


def edited(tmp_path: Path, setpoint: str, base: str = "smd") -> DriveProfile:
    file = tmp_path / "mine.toml"
    file.write_text(f'format = 1\nextends = "{base}"\nmodel = "mine"\n{setpoint}', encoding="utf-8")
    return profiles.load(file)


@pytest.mark.parametrize("hz", [5.1, 20.0, 50.0])
def test_a_start_above_5_hz_is_refused_before_anything_is_written(hz: float) -> None:
    async def scenario(drive: Drive, station: Any, writes: list[Write]) -> None:
        for command in (drive.run, drive.set_frequency):
            with pytest.raises(LimitError) as refused:
                await command(hz)
            assert refused.value.key == "drives.step_cap" and refused.value.params["cap_hz"] == 5.0
            assert refused.value.params["steps_hz"] == ("0.01", "0.1")
        assert writes == [] and not station.motor.energised

    with_drive(scenario)


def test_a_profile_of_hundredths_is_capped_under_tenths_too(tmp_path: Path) -> None:
    """50.00 Hz in hundredths is 500 Hz in a drive that counts tenths."""
    profile = edited(tmp_path, 'setpoint = { factor = 0.01, decimals = 2, evidence = "assumed" }')

    async def scenario(drive: Drive, station: Any, writes: list[Write]) -> None:
        with pytest.raises(LimitError):
            await drive.run(0.51)
        assert (await drive.run(0.5)).succeeded
        assert (SETPOINT, 50) in writes
        await drive.stop()

    with_drive(scenario, profile)


def test_a_setpoint_without_any_evidence_counts_as_assumed() -> None:
    """Evidence that is left out was no cap."""
    assert SetpointTable(factor=0.1).is_assumed


def test_the_models_whose_step_no_source_gives_are_these_and_no_other() -> None:
    open_models = {
        name
        for name in included_models()
        if profiles.load(name).evidence["setpoint"].kind == "assumed" and name != "dzb100"
    }
    assert open_models == ASSUMED
    for name in ASSUMED:
        profile = profiles.load(name)
        assert profile.options["setpoint_step"] == "unknown"
        assert profile.question("setpoint_step").choices == ("unknown", "0.01", "0.1")


def test_a_model_with_codings_of_its_own_is_not_asked_for_a_step_as_well() -> None:
    assert "setpoint_step" not in profiles.load("dzb100").options


@pytest.mark.parametrize("step", ["0.05", "0", "abc", 0.1])
def test_only_a_step_that_was_asked_for_is_taken(step: Any) -> None:
    with pytest.raises(ConfigurationError):
        create_dialect(profiles.load("smd"), 1, options={"setpoint_step": step})


def test_an_open_question_of_an_older_file_does_not_widen_the_choice(tmp_path: Path) -> None:
    """``profile new`` wrote an open question of this name before the step was an option."""
    more = '[open_questions.setpoint_step]\nassumed = "0.1"\nwhere = "-"\ntext = "?"\nreason = "?"\nprocedure = "?"\n'
    profile = edited(tmp_path, more)
    assert [question.name for question in profile.open_questions].count("setpoint_step") == 1
    assert profile.question("setpoint_step").choices == ("unknown", "0.01", "0.1")


def test_the_calibration_writes_the_safe_word_after_the_unlock_and_stops() -> None:
    async def scenario(drive: Drive, station: Any, writes: list[Write]) -> None:
        fastest = 0.0
        elapse = station.elapse

        def watch(dt: float) -> None:
            nonlocal fastest
            elapse(dt)
            fastest = max(fastest, station.motor.output_hz)

        station.elapse = watch
        assert [step.name for step in drive.open_calibrations()] == ["setpoint_step"]

        async def observe() -> str:
            assert not station.motor.energised
            return "0.1"

        found = await drive.calibrate("setpoint_step", observe)
        assert found.options == {"setpoint_step": "0.1"} and found.words == (50,)
        assert writes[:4] == [(48, 0), (1, 0x80), (SETPOINT, 50), (1, 8)] and writes[-1] == (1, 4)
        assert 4.9 <= fastest <= 5.1
        assert drive.open_calibrations() == ()
        assert (await drive.run(20.0)).succeeded
        await drive.stop()

    with_drive(scenario)


def test_a_drive_of_another_step_than_the_profile_gets_no_frequency_after_its_calibration() -> None:
    async def scenario(drive: Drive, station: Any, writes: list[Write]) -> None:
        async def observe() -> str:
            return "0.01"

        await drive.calibrate("setpoint_step", observe)
        writes.clear()
        with pytest.raises(LimitError) as refused:
            await drive.run(2.0)
        assert refused.value.key == "drives.step_differs" and writes == []

    with_drive(scenario)


def test_a_calibration_whose_word_the_drive_rejects_never_starts_the_motor() -> None:
    """It may still have the frequency of an earlier run."""

    async def scenario(drive: Drive, station: Any, writes: list[Write]) -> None:
        store = station._store
        station._store = lambda changes: 3 if changes[0][1] == SETPOINT else store(changes)
        with pytest.raises(TargetNotReached):
            await drive.calibrate("setpoint_step")
        assert (1, 8) not in writes and not station.motor.energised

    with_drive(scenario)


WITHOUT_UNLOCK = '[setpoint]\nevidence = "assumed"\n[modbus]\nfunctions = [3, 6, 8]\n'
"""Makes a V1000 whose step is assumed and whose writes the bench records. It needs no unlock before the word."""


@pytest.mark.parametrize("preparation", ["", "[[commands.preparation]]\nword = 0\n"], ids=["no word", "stop word"])
def test_a_calibration_leaves_a_running_drive_alone(tmp_path: Path, preparation: str) -> None:
    """The words before a start and the frequency were written before the start was refused."""
    profile = edited(tmp_path, WITHOUT_UNLOCK + preparation, "v1000")

    async def scenario(drive: Drive, station: Any, writes: list[Write]) -> None:
        station.run_towards(20.0)
        await asyncio.sleep(2)
        with pytest.raises(StartInhibited):
            await drive.calibrate("setpoint_step")
        assert writes == [] and station.motor.output_hz == pytest.approx(20.0)

    with_drive(scenario, profile)


def test_a_calibration_whose_start_gets_no_permit_writes_nothing(tmp_path: Path) -> None:
    """A high error rate inhibits a start, not a setpoint."""
    profile = edited(tmp_path, WITHOUT_UNLOCK, "v1000")

    async def scenario(drive: Drive, station: Any, writes: list[Write]) -> None:
        for _ in range(100):
            drive.bus.core.stations[1].counters.error_window.add(drive.bus.now(), DAMAGED)
        with pytest.raises(StartInhibited) as refused:
            await drive.calibrate("setpoint_step")
        assert refused.value.key == "drives.high_error_rate"
        assert writes == [] and not station.motor.energised

    with_drive(scenario, profile)


def test_the_plan_of_the_calibration_shows_the_word_before_the_start() -> None:
    dialect = create_dialect(profiles.load("smd"), 1)
    (step,) = calibration_steps(dialect)
    planned = dict(step.plan(dialect))
    assert [*planned] == ["state", "set_frequency", "start"]
    assert [(write.register, write.value) for write in planned["set_frequency"]] == [(SETPOINT, 50)]


def test_no_model_has_a_look_alike_of_its_maker_that_turns_faster_at_the_same_frames_and_no_cap() -> None:
    """Set and read in a wrong step, a frequency confirms itself: a PowerFlex 40 as a 400 turns ten times faster."""

    def frames(profile: DriveProfile) -> tuple[Any, ...]:
        commands, output = profile.commands, profile.signals["output_frequency"]
        start = commands.values.get("start_forward")
        ratio = round(output.scale.factor / profile.setpoint_scale.factor, 6)
        return str(profile.maker), commands.register, commands.setpoint_register, start, output.notation, ratio

    all_profiles = [profiles.load(model) for model in included_models()]
    plain = [
        profile
        for profile in all_profiles
        if profile.family == "modbus"
        and "output_frequency" in profile.signals
        and profile.identity_codes is None
        and profile.setpoint_share is None
        and profile.setpoint_rpm is None
    ]
    faster = [
        (model.model, other.model)
        for model in plain
        for other in plain
        if frames(model) == frames(other)
        and other.setpoint_scale.factor > model.setpoint_scale.factor
        and "setpoint_step" not in model.options
    ]
    assert faster == []


def test_a_powerflex_40_that_is_driven_as_its_look_alikes_exceeds_5_hz_under_none_of_them() -> None:
    for model in ("powerflex_400", "powerflex_525"):
        profile = profiles.load(model)
        dialect = create_dialect(profile, 1)
        with pytest.raises(LimitError) as refused:
            dialect.setpoint_word(5.0)
        assert refused.value.key == "drives.step_cap" and refused.value.params["cap_hz"] == 0.5
