"""Words that a drive needs before a start, such as 6 and 7 of DRIVECOM: sent by its status, before the start word."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.bus.trace import TraceEvent
from drivebus.commissioning.profile_simulator import ProfileStation
from drivebus.drives.dialects.create import create_dialect
from drivebus.drives.drive import Drive
from drivebus.drives.operations import start
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.steps import DriveOperation
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.state import DriveState
from drivebus.errors import DrivebusError, ProfileError, StartInhibited, StopUnconfirmed, Superseded
from drivebus.protocols.codec import Effect
from drivebus.protocols.modbus import WriteRegister
from drivebus.simulator.bus import SimulatedBus
from drivebus.simulator.motor import Trip
from drivebus.simulator.port import SimPort
from drivebus.testing.virtual_time import run

DRIVECOM = """
format = 1
model = "drivecom"
family = "modbus"
grade = "draft"
maker = "Acme"
title = "Acme DRIVECOM"
encodings = ["rtu"]
addresses = [1, 247]
capabilities = ["run", "reverse", "stop", "coast", "set_frequency", "reset_fault", "read", "status"]
notation = { style = "register" }
serial = { baud = 19200, format = "8E1", bauds = [19200], formats = ["8E1"], evidence = "assumed" }
timing = { evidence = "assumed" }
limits = { minimum_hz = 0.0, maximum_hz = 50.0, evidence = "assumed" }
setpoint = { factor = 0.1, decimals = 1, evidence = "assumed" }
write = { ram = false, evidence = "assumed" }
modbus = { functions = [3, 6, 8], max_read = 4, loopback = true, evidence = "assumed" }

[commands]
register = 0x2135
setpoint_register = 0x2136
ready = { mask = 0x006F, value = 0x0023 }
reset_on_edge = true
evidence = "assumed"
values = { start_forward = 0x000F, start_reverse = 0x080F, stop = 0x0007, coast = 0x0000, reset = 0x0080 }

[[commands.preparation]]
when = { mask = 0x004F, value = 0x0040 }
word = 6
until = { mask = 0x006F, value = 0x0021 }

[[commands.preparation]]
when = { mask = 0x006F, value = 0x0021 }
word = 7
until = { mask = 0x006F, value = 0x0023 }

[status]
register = 0x0C81
mask = 0x006F
values = { 64 = "stopped", 33 = "stopped", 35 = "stopped", 39 = "running", 8 = "fault" }
evidence = "assumed"

[signals.output_frequency]
notation = "0C82H"
text = "output frequency"
unit = "Hz"
factor = 0.1
decimals = 1
evidence = "assumed"
"""
COMMAND = 0x2135
PREPARED = [6, 7]


@pytest.fixture(name="profile")
def load_drivecom(tmp_path: Path) -> profiles.DriveProfile:
    return load(tmp_path, DRIVECOM)


def load(tmp_path: Path, text: str) -> profiles.DriveProfile:
    path = tmp_path / "drivecom.toml"
    path.write_text(text, encoding="utf-8")
    return profiles.load(path)


@asynccontextmanager
async def bench(profile: profiles.DriveProfile, quality: str = "clean") -> AsyncIterator[tuple[Drive, Any, list[int]]]:
    """Yield the drive, its simulated station, and the command words that were sent."""
    station = ProfileStation(1, profile=profile)
    station.set_ramps(1.0, 1.0)
    words: list[int] = []

    def note(event: TraceEvent) -> None:
        if event.direction == "sent" and isinstance(event.message, WriteRegister) and event.message.register == COMMAND:
            words.append(event.message.value)

    simulated = SimulatedBus([station], line_quality=quality, seed=7)
    port: Any = SimPort(simulated, simulated.settings, "sim://bench", "off")
    async with Bus(port) as bus:
        bus.trace(note)
        yield Drive(bus, profile, 1), station, words


def test_the_words_go_in_order_and_the_start_comes_last(profile: profiles.DriveProfile) -> None:
    async def scenario() -> None:
        async with bench(profile) as (drive, station, words):
            assert (await drive.run(10.0)).status is OutcomeStatus.CONFIRMED
            assert words == [*PREPARED, 0x000F]
            await asyncio.sleep(2)
            assert station.motor.output_hz == pytest.approx(10.0, abs=0.1)
            assert (await drive.stop()).status is OutcomeStatus.CONFIRMED
            words.clear()
            assert (await drive.run(10.0)).status is OutcomeStatus.CONFIRMED
            assert words == [0x000F]  # the stop left the drive ready

    run(scenario())


def test_after_a_coast_the_words_are_sent_again(profile: profiles.DriveProfile) -> None:
    async def scenario() -> None:
        async with bench(profile) as (drive, station, words):
            await drive.run(10.0)
            await drive.coast()
            await asyncio.sleep(20)
            words.clear()
            assert (await drive.run(5.0)).status is OutcomeStatus.CONFIRMED
            assert words == [*PREPARED, 0x000F] and station.motor.energised

    run(scenario())


@pytest.mark.parametrize("stuck_after", [0, 1])
def test_a_drive_whose_status_does_not_follow_is_not_started(profile: profiles.DriveProfile, stuck_after: int) -> None:
    async def scenario() -> None:
        async with bench(profile) as (drive, station, words):
            take = station._take_step
            station._take_step = lambda word, names: take(word, names) if station.steps_taken < stuck_after else None
            with pytest.raises(
                StartInhibited, match="which it needs before a start, the drive still reports"
            ) as caught:
                await drive.run(10.0)
            assert caught.value.params["word"] == f"{PREPARED[stuck_after]:04X}H"
            assert words == PREPARED[: stuck_after + 1] and not station.motor.energised

    run(scenario())


def test_a_rejected_word_ends_the_start(profile: profiles.DriveProfile) -> None:
    async def scenario() -> None:
        async with bench(profile) as (drive, station, words):
            execute = station._execute
            station._execute = lambda word: 4 if word == 7 else execute(word)
            with pytest.raises(StartInhibited, match="code 4") as caught:
                await drive.run(10.0)
            assert caught.value.key == "drives.preparation_rejected"
            assert words == PREPARED and not station.motor.energised

    run(scenario())


def test_a_drive_in_fault_gets_no_word(profile: profiles.DriveProfile) -> None:
    async def scenario() -> None:
        async with bench(profile) as (drive, station, words):
            station.trip(Trip.OVERLOAD)
            with pytest.raises(StartInhibited, match="fault"):
                await drive.run(10.0)
            assert words == []

    run(scenario())


def test_a_status_that_fits_no_word_is_named_and_nothing_is_sent(tmp_path: Path) -> None:
    profile = load(tmp_path, DRIVECOM.replace("values = { 64", 'values = { 32 = "stopped", 64'))

    async def scenario() -> None:
        async with bench(profile) as (drive, station, words):
            station._prepared_status = lambda: 0x20
            with pytest.raises(StartInhibited, match="status 0020H") as caught:
                await drive.run(10.0)
            assert caught.value.key == "drives.status_unprepared"
            assert words == []

    run(scenario())


def test_a_stop_between_the_words_ends_the_start(profile: profiles.DriveProfile) -> None:
    """At each moment of the words: whatever was sent before, no start word follows the stop."""

    async def scenario(after_s: float) -> list[int]:
        async with bench(profile) as (drive, station, words):
            start = asyncio.ensure_future(drive.run(10.0))
            await asyncio.sleep(after_s)
            sent_before = list(words)
            stopped = await drive.stop()
            try:
                await start
            except DrivebusError as error:
                assert isinstance(error, Superseded | StartInhibited), error
            await asyncio.sleep(3)
            assert stopped.status is OutcomeStatus.CONFIRMED
            assert not station.motor.energised
            assert 0x000F in sent_before or 0x000F not in words, (after_s, words)
            return words

    seen = {tuple(run(scenario(step * 0.02))) for step in range(60)}
    assert any(0x000F not in words and 6 in words for words in seen)


def test_lost_replies_never_start_an_unprepared_drive(profile: profiles.DriveProfile) -> None:
    """On a lossy line the start is confirmed or withheld with its reason; 6 and 7 always come before the start word."""

    async def scenario() -> None:
        confirmed = 0
        async with bench(profile, "lossy") as (drive, _station, words):
            for _ in range(12):
                words.clear()
                with suppress(DrivebusError):
                    confirmed += (await drive.run(10.0)).status is OutcomeStatus.CONFIRMED
                with suppress(StopUnconfirmed):
                    await drive.coast()
                await asyncio.sleep(20)
                starts = [place for place, word in enumerate(words) if word == 0x000F]
                assert all(6 in words[:place] and 7 in words[:place] for place in starts), words
        assert 0 < confirmed < 12

    run(scenario())


def test_the_start_word_gets_no_permit_in_an_unprepared_status(
    profile: profiles.DriveProfile, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The gate itself refuses it, if an operation leaves out the words."""

    def leave_out(op: OperationContext) -> DriveOperation[None]:
        yield from op.check_deadline()

    monkeypatch.setattr(start, "prepare_start", leave_out)

    async def scenario() -> None:
        async with bench(profile) as (drive, station, words):
            with pytest.raises(StartInhibited, match="the status of the drive does not allow a start yet"):
                await drive.run(10.0)
            assert words == [] and station.setpoint_word == 0

    run(scenario())


def test_only_the_words_that_the_status_asks_for_are_sent(profile: profiles.DriveProfile) -> None:
    async def scenario() -> None:
        async with bench(profile) as (drive, station, words):
            station.steps_taken = 1
            assert (await drive.run(10.0)).status is OutcomeStatus.CONFIRMED
            assert words == [7, 0x000F]

    run(scenario())


SAME_WORD = """
[[commands.preparation]]
when = { mask = 0x000F, value = 0x0000 }
word = 6
until = { mask = 0x006F, value = 0x0021 }

[[commands.preparation]]
when = { mask = 0x006F, value = 0x0021 }
word = 7
"""


def test_a_word_that_answers_two_states_is_sent_once(tmp_path: Path) -> None:
    """Two states may inhibit a start, each with a step of its own; the stop word, 6 here, leads behind both."""
    second_step = DRIVECOM[DRIVECOM.rindex("[[commands.preparation]]") : DRIVECOM.rindex("until")]
    text = DRIVECOM.replace(second_step, SAME_WORD).replace("stop = 0x0007", "stop = 0x0006")
    profile = load(tmp_path, text)
    assert profile.commands is not None
    assert [step.word for step in profile.commands.preparation] == [6, 6, 7]

    async def scenario() -> None:
        async with bench(profile) as (drive, station, words):
            assert (await drive.run(10.0)).status is OutcomeStatus.CONFIRMED
            assert words == [*PREPARED, 0x000F] and station.motor.energised
            assert (await drive.stop()).status is OutcomeStatus.CONFIRMED
            words.clear()
            assert (await drive.run(10.0)).status is OutcomeStatus.CONFIRMED
            assert words == [7, 0x000F]

    run(scenario())


def test_a_reset_on_an_edge_is_sent_after_the_stop_word(profile: profiles.DriveProfile) -> None:
    """Two resets in a row would else leave the bit set: the second would do nothing."""

    async def scenario() -> None:
        async with bench(profile) as (drive, station, words):
            for _ in range(2):
                station.trip(Trip.OVERLOAD)
                await asyncio.sleep(0.1)
                words.clear()
                assert (await drive.reset_fault()).status is OutcomeStatus.CONFIRMED
                assert words == [0x0007, 0x0080]
                assert (await drive.status()).state is DriveState.STOPPED

    run(scenario())


def test_the_word_before_a_reset_waits_until_the_station_answers_as_its_model(tmp_path: Path) -> None:
    """It may be the start of another model, as any stop word."""
    identity = '\n[identity]\nregister = 0x0D00\nevidence = "assumed"\n'
    identity += '[signals.output_current]\nnotation = "0D00H"\ntext = "current"\nevidence = "assumed"\n'
    profile = load(tmp_path, DRIVECOM + identity)

    async def scenario() -> None:
        async with bench(profile) as (drive, station, words):
            station.trip(Trip.OVERLOAD)
            del station._signals[("holding", 0x0D00)]
            with pytest.raises(StartInhibited, match="does not answer as a drivecom"):
                await drive.reset_fault()
            assert words == []

    run(scenario())


def test_of_all_words_only_the_listed_ones_are_sent_and_only_the_starts_may_move(
    profile: profiles.DriveProfile,
) -> None:
    dialect: Any = create_dialect(profile, 1)
    effects = {word: dialect.command_word.effect(word) for word in range(0x10000)}
    assert {word for word in effects if dialect.command_word.is_mapped(word)} == {0, 6, 7, 0x80, 0x000F, 0x080F}
    assert {word for word, effect in effects.items() if effect is not Effect.MOTION} == {0, 6, 7, 0x80}
    assert effects[6] is Effect.SETTING and effects[7] is Effect.STOP


@pytest.mark.parametrize(
    ("old", "new", "kind"),
    [
        ("word = 6", "word = 15", "preparation_moves"),
        ("word = 6", "word = 2063", "preparation_moves"),
        ("word = 6", "word = 31", "preparation_moves"),
        ("until = { mask = 0x006F, value = 0x0021 }", "until = { mask = 0x004F, value = 0x0040 }", "preparation_idle"),
        ("ready = { mask = 0x006F, value = 0x0023 }\n", "", "preparation_parts"),
        ("mask = 0x004F, value = 0x0040", "mask = 0x004F, value = 0x0080", "outside_mask"),
    ],
)
def test_a_profile_whose_preparation_could_start_is_rejected(tmp_path: Path, old: str, new: str, kind: str) -> None:
    with pytest.raises(ProfileError) as caught:
        load(tmp_path, DRIVECOM.replace(old, new, 1))
    assert kind in [diagnostic.kind for diagnostic in caught.value.params["diagnostics"]]
