"""Models whose command and status words are numbers, on drives simulated from their profiles: one story for each."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.drives import Drive, create_dialect
from drivebus.drives.dialects.base import StopMode
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.state import Direction, DriveState
from drivebus.errors import ConfigurationError, LimitError, PreflightError, StartInhibited, TargetNotReached
from drivebus.ports import open_port
from drivebus.profiles.model import DriveProfile
from drivebus.protocols import modbus
from drivebus.protocols.codec import Effect
from drivebus.simulator.models.catalog import simulated_models
from drivebus.simulator.motor import Trip
from drivebus.testing.virtual_time import run

MODELS = [name for name in profiles.models() if name not in simulated_models()]
NUMBERED = {
    repr(commands): name for name in MODELS if (commands := profiles.load(name).commands) and commands.values
}.values()
"""One model of each set of commands that are numbers."""

STATELESS = [name for name in MODELS if profiles.load(name).commands and profiles.load(name).status is None]


@asynccontextmanager
async def simulated_drive(
    model: str | Path, quality: str = "clean", profile: DriveProfile | None = None
) -> AsyncIterator[tuple[Drive, Any]]:
    """Yield the drive at address 3 and its simulated station, whose ramps take 2 s."""
    profile = profile or profiles.load(model)
    port: Any = open_port(f"sim://{profile.model}@3?line_quality={quality}&ramp=2")
    bus = Bus(port)
    await bus.open()
    share = profile.setpoint_share
    stated = share.maximum_hz if share is not None and share.maximum is None else None
    drive = Drive(bus, profile, 3, options={"maximum_frequency": int(stated)} if stated else None)
    try:
        yield drive, port.simulated_bus.stations[0]
    finally:
        await bus.close()


async def settle(drive: Drive) -> None:
    """Let the ramp end; the simulated drive computes its motor when it is read."""
    await asyncio.sleep(3)
    await drive.status()


def story(tell: Callable[[], Coroutine[Any, Any, None]]) -> None:
    run(tell())


@pytest.mark.parametrize("model", NUMBERED)
def test_of_all_words_only_the_listed_commands_are_sent_and_only_stops_need_no_permit(model: str) -> None:
    profile = profiles.load(model)
    assert profile.commands is not None
    dialect: Any = create_dialect(profile, 3)
    by_word: dict[int, set[str]] = {}
    for name, value in profile.commands.values.items():
        by_word.setdefault(value, set()).add(name)
    for word in range(0x10000):
        names = by_word.get(word, set())
        prepares = not names and profile.commands.prepares(word)
        assert dialect.command_word.is_mapped(word) is (bool(names) or prepares)
        moves = not names or any(name.startswith(("start", "jog_forward", "jog_reverse")) for name in names)
        sets = prepares or names == {"reset"}
        expected = Effect.SETTING if sets else Effect.MOTION if moves else Effect.STOP
        assert dialect.command_word.effect(word) is expected, (word, names)


@pytest.mark.parametrize("model", STATELESS)
def test_a_model_that_reports_no_state_runs_and_stops_without_a_guess(model: str) -> None:
    """YL600: the manual names a register of the state, without its values."""

    async def tell() -> None:
        async with simulated_drive(model) as (drive, station):
            hertz = min(10.0, drive.profile.limits.maximum_hz)
            assert (await drive.status()).state is DriveState.UNKNOWN
            assert (await drive.run(hertz)).status is OutcomeStatus.ACKNOWLEDGED
            await settle(drive)
            assert station.motor.output_hz == pytest.approx(hertz, abs=0.1)
            stopped = await drive.stop()
            await settle(drive)
            assert stopped.status is not OutcomeStatus.FAILED and not station.motor.energised

    story(tell)


def test_the_maximum_frequency_is_read_before_each_frequency() -> None:
    """Set to 100 Hz at the keypad between two starts, the same word would be twice the speed."""

    async def tell() -> None:
        async with simulated_drive("skf8000") as (drive, station):
            await drive.run(20.0)
            await drive.stop()
            await asyncio.sleep(3)
            station.keypad_set(0xF00A, 10000)  # P0-10 = 100.00 Hz
            assert (await drive.run(20.0)).status is OutcomeStatus.CONFIRMED
            assert station.setpoint_word == 2000
            station.keypad_set(0xF00A, 20000)  # while it runs
            assert (await drive.set_frequency(20.0)).status is OutcomeStatus.CONFIRMED
            assert station.setpoint_word == 1000

    story(tell)


@pytest.mark.parametrize("word", [0, 500, 40000])
def test_nothing_is_sent_while_the_maximum_frequency_is_unknown(word: int) -> None:
    """500 reads 5.00 Hz, which P0-10 can't be: a drive that counts 0.1 Hz means 50 Hz, and ten times the speed."""

    async def tell() -> None:
        async with simulated_drive("skf8000") as (drive, station):
            station.keypad_set(0xF00A, word)
            with pytest.raises(PreflightError, match="P0-10") as caught:
                await drive.run(5.0)
            assert caught.value.key == "drives.maximum_unknown"
            assert station.setpoint_word == station.command == 0

    story(tell)


def stated_profile(folder: Path) -> DriveProfile:
    """Return a profile whose maximum can't be read and is only stated."""
    own = Path(profiles.load("skf8000").source)
    for base in (own.parent.parent / "inovance").glob("_md380_*.toml"):
        (folder / base.name).write_text(base.read_text().replace('maximum = "P0-10"', "maximum_hz = 50.0"))
    file = folder / own.name
    file.write_text(own.read_text().replace("../inovance/", "./"))
    return profiles.load(file)


def test_a_stated_maximum_caps_the_frequency_until_it_is_confirmed(tmp_path: Path) -> None:
    """At most 5 Hz under 320 Hz, the largest maximum of the model: word 156."""
    dialect: Any = create_dialect(stated_profile(tmp_path), 3)
    assert dialect.setpoint_word(0.78) == 156 and dialect.setpoint_cap_hz == pytest.approx(0.78)
    with pytest.raises(LimitError, match="maximum_frequency") as capped:
        dialect.setpoint_word(0.79)
    assert capped.value.key == "drives.share_cap"
    confirmed: Any = create_dialect(stated_profile(tmp_path), 3, options={"maximum_frequency": 50})
    assert (confirmed.setpoint_word(25.0), confirmed.setpoint_word(50.0)) == (5000, 10000)
    assert confirmed.setpoint_cap_hz is None
    with pytest.raises(LimitError) as above:
        confirmed.setpoint_word(50.1)
    assert (above.value.key, above.value.params["limit_hz"]) == ("drives.above_drive_maximum", 50)


@pytest.mark.parametrize(("value", "allowed"), [(0, True), (50, True), (24, False), (1, False), (321, False)])
def test_a_confirmed_maximum_is_one_that_the_drive_can_be_set_to(tmp_path: Path, value: int, allowed: bool) -> None:
    """With a maximum of 1 Hz a command of 1 Hz would be full scale: the drive's real maximum."""
    profile = stated_profile(tmp_path)
    assert profile.question("maximum_frequency").allows(value) is allowed
    if allowed:
        create_dialect(profile, 3, options={"maximum_frequency": value})
        return
    with pytest.raises(ConfigurationError, match="25 … 320") as caught:
        create_dialect(profile, 3, options={"maximum_frequency": value})
    assert caught.value.key == "drives.option_value"


@pytest.mark.parametrize("frequency_hz", [0.03, 7.14, 33.33, 49.99])
def test_a_share_is_never_more_than_the_frequency_that_was_asked_for(tmp_path: Path, frequency_hz: float) -> None:
    """With a coarse full scale the nearest word may be above: 100 steps of 0.5 Hz."""
    profile = stated_profile(tmp_path)
    assert profile.setpoint_share is not None
    coarse = replace(profile, setpoint_share=replace(profile.setpoint_share, full_scale=100))
    dialect: Any = create_dialect(coarse, 3, options={"maximum_frequency": 50})
    word = dialect.setpoint_word(frequency_hz)
    assert frequency_hz - 0.5 < word * 0.5 <= frequency_hz


def test_a_whole_step_of_a_share_is_not_lost_to_binary_fractions(tmp_path: Path) -> None:
    dialect: Any = create_dialect(stated_profile(tmp_path), 3, options={"maximum_frequency": 50})
    assert [dialect.setpoint_word(word * 0.005) for word in range(10001)] == list(range(10001))


def test_a_fault_number_is_counted_from_the_lowest_bit_of_its_field() -> None:
    status = profiles.load("ms300").status
    assert status is not None
    assert replace(status, fault_mask=0xFF00).fault_number(0x2507) == 0x25
    assert status.fault_number(0x2507) == 0x07


def change_the_maximum_with_the_next_setpoint(station: Any, word: int) -> None:
    """Set P0-10 at the keypad in the moment in which the setpoint arrives, once."""
    handle = station.handle_request

    def changed(message: Any, codec: Any) -> Any:
        if isinstance(message, modbus.WriteRegister) and message.register == 0x1000:
            station.handle_request = handle
            station.keypad_set(0xF00A, word)
        return handle(message, codec)

    station.handle_request = changed


def without_set_frequency(model: str) -> DriveProfile:
    profile = profiles.load(model)
    return replace(profile, signals={n: signal for n, signal in profile.signals.items() if n != "set_frequency"})


def test_a_start_is_withheld_where_the_maximum_was_changed_after_its_read() -> None:
    """Without a readable set frequency nothing else shows that the word means twice the speed."""

    async def tell() -> None:
        async with simulated_drive("skf8000", profile=without_set_frequency("skf8000")) as (drive, station):
            change_the_maximum_with_the_next_setpoint(station, 10000)
            with pytest.raises(TargetNotReached, match="from 50 to 100 Hz"):
                await drive.run(20.0)
            assert station.command == 0 and not station.motor.energised
            assert (await drive.run(20.0)).status is OutcomeStatus.CONFIRMED
            assert station.setpoint_word == 2000

    story(tell)


def test_a_running_drive_gets_a_corrected_word_at_once_where_its_maximum_was_changed() -> None:
    async def tell() -> None:
        async with simulated_drive("skf8000", profile=without_set_frequency("skf8000")) as (drive, station):
            await drive.run(10.0)
            change_the_maximum_with_the_next_setpoint(station, 10000)
            assert (await drive.set_frequency(20.0)).succeeded
            assert station.setpoint_word == 2000

    story(tell)


def test_a_run_whose_corrected_word_is_withheld_says_that_the_motor_may_be_running(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Elsewhere nothing is sent before a start is inhibited: no stop followed, and the motor ran on at 40 Hz."""

    async def tell() -> None:
        async with simulated_drive("skf8000", profile=without_set_frequency("skf8000")) as (drive, station):
            await drive.run(10.0)
            change_the_maximum_with_the_next_setpoint(station, 10000)
            monkeypatch.setattr(drive.bus, "start_inhibited", lambda _: station.setpoint_word == 4000)
            with pytest.raises(StartInhibited) as caught:
                await drive.run(20.0)
            assert caught.value.may_be_running is True and station.running

    story(tell)


def test_a_running_drive_whose_maximum_changes_with_each_word_gets_no_third_one() -> None:
    async def tell() -> None:
        async with simulated_drive("skf8000", profile=without_set_frequency("skf8000")) as (drive, station):
            await drive.run(10.0)
            words = [8000, 10000]
            handle = station.handle_request

            def changed(message: Any, codec: Any) -> Any:
                if isinstance(message, modbus.WriteRegister) and message.register == 0x1000:
                    station.keypad_set(0xF00A, words.pop())
                return handle(message, codec)

            station.handle_request = changed
            with pytest.raises(TargetNotReached) as caught:
                await drive.set_frequency(20.0)
            assert caught.value.key == "drives.maximum_changed" and words == []
            assert (caught.value.params["before_hz"], caught.value.params["now_hz"]) == (100, 80)

    story(tell)


def test_a_drive_whose_direction_is_not_reported_is_not_turned_round_while_it_runs() -> None:
    async def tell() -> None:
        async with simulated_drive("vf51") as (drive, station):
            await drive.run(10.0, Direction.REVERSE)
            await settle(drive)
            word = station.setpoint_word
            for direction in Direction:
                with pytest.raises(StartInhibited) as caught:
                    await drive.run(20.0, direction)
                assert caught.value.key == "drives.turning_unknown_direction"
            assert station.setpoint_word == word
            assert (await drive.run(20.0)).succeeded, "without a direction it is a new frequency only"
            assert station.setpoint_word == 2 * word
            await drive.stop()
            await settle(drive)
            assert (await drive.run(10.0, Direction.FORWARD)).succeeded

    story(tell)


def test_an_unmet_precondition_is_named_before_the_maximum_frequency_is_read() -> None:
    """P0-22 = 1 makes the maximum read ten times too small: the keypad step is the useful message."""

    async def tell() -> None:
        async with simulated_drive("skf8000") as (drive, station):
            station.keypad_set(0xF016, 1)
            station.keypad_set(0xF00A, 500)
            with pytest.raises(PreflightError, match="P0-22"):
                await drive.run(5.0)

    story(tell)


@pytest.mark.parametrize(
    ("model", "register", "speed", "parameter"),
    [("shihlin_sl3", 10008, 3600, "00-08"), ("fr_d700_modbus", 0x040C, 1800, r"Pr\.37")],
)
def test_a_drive_whose_frequencies_are_a_speed_is_not_started(
    model: str, register: int, speed: int, parameter: str
) -> None:
    """SL3: the word has one decimal, ten times the speed. FR-D700: set and shown value agree at another speed."""

    async def tell() -> None:
        async with simulated_drive(model) as (drive, station):
            station.keypad_set(register, speed)
            with pytest.raises(PreflightError, match=parameter):
                await drive.run(5.0)
            assert station.setpoint_word == station.command == 0

    story(tell)


def test_a_goodrive_20_shows_its_ramp_times() -> None:
    async def tell() -> None:
        async with simulated_drive("gd20") as (drive, _):
            await drive.preflight()
            assert drive.acceleration_s == 2.0
            shown = await drive.read(["P00.11", "P00.12"])
            assert [reading.value for reading in shown.values()] == [2.0, 2.0]

    story(tell)


@pytest.mark.parametrize("raw", [0, 4, 0xFFFF])
def test_a_status_value_that_no_manual_lists_is_no_state(raw: int) -> None:
    dialect: Any = create_dialect(profiles.load("skf8000"), 3)
    reading = dialect.decode_readings(modbus.ReadRegisters(3, 0x3000, 1), modbus.RegisterValues(3, 3, (raw,)), 1.0)
    assert reading["state"].reason == "drives.unlisted_state"  # no bit of it is reserved


def test_the_state_is_unknown_until_the_fault_register_was_read() -> None:
    """The status word of this map has no value for a fault: a tripped drive reports "stopped"."""

    async def tell() -> None:
        async with simulated_drive("skf8000") as (drive, station):
            station.trip(Trip.OVERCURRENT_RUNNING)
            status = await drive.status()
            assert status.state is DriveState.FAULT
            assert status.fault is not None and status.fault.code == station.trip_code(Trip.OVERCURRENT_RUNNING)
            dialect: Any = drive.dialect
            names = dialect.state_names
            assert names == ("state", "fault_0")

    story(tell)


def test_a_jog_without_a_stop_of_its_own_ends_with_the_ordinary_stop() -> None:
    dialect: Any = create_dialect(profiles.load("skf8000"), 3)
    assert [write.value for write in dialect.stop(StopMode.JOG_STOP)] == [6]
    assert [write.value for write in dialect.stop(StopMode.COAST)] == [5]
