"""Drives that answer in a way that is not accepted: the error names what was received, never that nothing was."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from drivebus import i18n
from drivebus.cli.errors import error_hint
from drivebus.drives import DriveStatus
from drivebus.drives.state import DriveState
from drivebus.errors import DrivebusError, PreflightError, StartInhibited
from drivebus.protocols.checksum import sum16
from drivebus.protocols.modbus.rtu import build_frame
from drivebus.simulator.port import simulated_bus_of
from drivebus.simulator.wire import Transmission
from fixtures.drives import MODELS, SAFE_HZ, SimulatedDrives, run_virtual

Replies = tuple[tuple[float, bytes], ...]
"""Frames in place of one reply, each with its delay after the end of the frame before, in seconds."""


def stray_before(reply: bytes) -> Replies:
    return ((0.0, b"\x00" + reply),)


def stray_after(reply: bytes) -> Replies:
    return ((0.0, reply + b"\x00"),)


def doubled(reply: bytes) -> Replies:
    return ((0.0, reply + reply),)


def doubled_later(reply: bytes) -> Replies:
    """The second reply comes while the next transaction waits."""
    return (0.0, reply), (0.03, reply)


def in_reserved_state(reply: bytes) -> Replies:
    """Set the state of a C320 reply to 06H, which the manual reserves, with a valid checksum."""
    fields = reply[1:4] + b"06" + reply[6:13]
    return ((0.0, reply[:1] + fields + b"%04X" % sum16(fields) + reply[17:]),)


def replace_replies(bench: SimulatedDrives, replies: Callable[[bytes], Replies]) -> None:
    wire = simulated_bus_of(bench.port).wire
    transmit = wire.transmit_reply

    def transmit_replaced(source: object, data: bytes, now: float, at: float) -> Any:
        for delay_s, frame in replies(data):
            sent = transmit(source, frame, now, at + delay_s)
            at = sent.end
        return sent

    wire.transmit_reply = transmit_replaced  # type: ignore[method-assign]


def errors_of(
    model: str, misbehave: Callable[[SimulatedDrives], None], *, foreign_master: bool = False
) -> list[DrivebusError]:
    """Return the errors of the first status, of a start, and of a status of a drive that answered before."""

    async def scenario() -> list[DrivebusError]:
        errors: list[DrivebusError] = []
        for seen_before in (False, True):
            async with SimulatedDrives(model) as bench:
                drive = bench.drive()
                if seen_before:
                    await drive.status()
                misbehave(bench)
                for operation in (drive.status, lambda drive=drive: drive.run(SAFE_HZ[model])):
                    with pytest.raises(DrivebusError) as caught:
                        await operation()
                    errors.append(caught.value)
                assert bench.bus.foreign_master == foreign_master
                assert not bench.station().motor.energised
        return errors

    return run_virtual(scenario())


def assert_named(errors: list[DrivebusError], key: str) -> None:
    for error in errors:
        cause = error.__cause__ if isinstance(error, PreflightError) else error
        assert isinstance(cause, DrivebusError) and cause.key == key, f"{error.key}: {error}"
        assert error_hint(error) == i18n.text(f"hint.{key}"), "with the remedy of this cause"
        assert all(cause.text(language) and cause.text(language) != key for language in ("en", "zh"))


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    ("replies", "key"),
    [(stray_before, "bus.stray_before"), (stray_after, "bus.trailing"), (doubled, "bus.second_reply")],
)
def test_a_reply_that_is_not_accepted_is_named_and_not_called_silence(
    model: str, replies: Callable[[bytes], Replies], key: str
) -> None:
    assert_named(errors_of(model, lambda bench: replace_replies(bench, replies)), key)


@pytest.mark.parametrize("model", ["c320", "vc660", "dzb100"])
def test_a_second_reply_during_the_next_request_is_named_and_no_foreign_master(model: str) -> None:
    assert_named(errors_of(model, lambda bench: replace_replies(bench, doubled_later)), "bus.second_reply")


@pytest.mark.parametrize("model", ["c320", "vc660", "dzb100"])
def test_a_request_that_an_unseen_second_reply_destroys_is_not_answered_with_check_the_address(model: str) -> None:
    """An adapter that is deaf while it sends shows nothing of a second reply that begins with the next request.

    From a VC660 that never answered otherwise, only replies came that equal their requests: maybe the adapter's echo.
    """

    def deafen(bench: SimulatedDrives) -> None:
        wire = simulated_bus_of(bench.port).wire
        station, collide = bench.station(), wire._collide
        replace_replies(bench, lambda reply: ((0.0, reply), (0.008, reply)))

        def collide_unseen(transmission: Transmission) -> None:
            collide(transmission)
            for recent in wire._recent:
                for reply, request in ((recent, transmission), (transmission, recent)):
                    overlaps = reply.start < request.end and request.start < reply.end
                    if reply.source is station and request.source is not station and overlaps:
                        reply.dropped.update(range(len(reply.data)))

        wire._collide = collide_unseen  # type: ignore[method-assign]

    errors = errors_of(model, deafen)[2 if model == "vc660" else 0 :]
    assert_named(errors, "bus.no_reply_to_next")
    for error in errors:
        assert 0 <= error.params["since_ms"] < 20
        assert f"its last reply had come {error.params['since_ms']} ms before this request" in error.text("en")
        hint = error_hint(error) or ""
        assert "address, baud rate and format are right" in hint and "sends each frame twice" in hint


@pytest.mark.parametrize("echo", ["detect", "off"])
def test_a_doubled_reply_that_passes_for_an_echo_is_named_after_the_next_read(echo: str) -> None:
    """The loop-back of a VC660 is equal to its request, so its doubled reply looks like an echo and a reply."""

    async def scenario() -> DrivebusError:
        async with SimulatedDrives("vc660", query=f"echo={echo}") as bench:
            replace_replies(bench, doubled)
            with pytest.raises(DrivebusError) as caught:
                await bench.drive().status()
            return caught.value

    assert_named([run_virtual(scenario())], "bus.second_reply")


def test_the_end_of_a_late_reply_is_no_reply_from_the_station_of_its_first_byte() -> None:
    """A serial server splits a reply: its end is read in place of the next one, and begins with any byte."""

    async def scenario() -> DrivebusError:
        async with SimulatedDrives("vc660") as bench:
            drive = bench.drive()
            await drive.status()
            replace_replies(bench, lambda reply: ((0.0, b"\x56\x78\x01\x02\x03\x04\x05\x06"),))
            with pytest.raises(DrivebusError) as caught:
                await drive.status()
            return caught.value

    error = run_virtual(scenario())
    assert error.key == "modbus.first_byte" and error_hint(error) == i18n.text("hint.damaged_reply")
    assert error.text("en").startswith("the received bytes begin with 56H, not with address 1")
    assert "86" not in error.text("en") + error.text("zh")


@pytest.mark.parametrize("model", MODELS)
def test_a_reply_from_another_address_is_named_and_starts_stay_refused(model: str) -> None:
    """Another master that asks that address is the other possible cause."""

    def misaddress(bench: SimulatedDrives) -> None:
        bench.station().faults.wrong_address = 2

    errors = errors_of(model, misaddress, foreign_master=True)
    assert_named(errors, "bus.other_station_replied")
    assert "address 2" in errors[0].text() and "station 1" in errors[0].text()


@pytest.mark.parametrize("model", MODELS)
def test_a_start_after_replies_from_another_address_is_not_refused_because_of_another_master_alone(model: str) -> None:
    """ "Another master is active on this bus" sent its reader to search for one, where a drive changed its address."""

    async def scenario() -> StartInhibited:
        async with SimulatedDrives(model) as bench:
            drive = bench.drive()
            await drive.status()
            bench.station().faults.wrong_address = 2
            for _ in range(2):
                with pytest.raises(DrivebusError):
                    await drive.status()
            bench.station().faults.wrong_address = None
            await asyncio.sleep(2.0)
            await drive.status()
            with pytest.raises(StartInhibited) as caught:
                await drive.run(SAFE_HZ[model])
            return caught.value

    error = run_virtual(scenario())
    assert error.key == "drives.foreign_master"
    assert "or a drive replies under" in error.text("en") and "或有变频器" in error.text("zh")


def test_a_rejection_from_another_address_is_named_and_not_called_silence() -> None:
    """A rejection is shorter than the reply that it stands for."""

    def foreign_rejection(reply: bytes) -> Replies:
        return ((0.0, build_frame(bytes((2, reply[1] | 0x80, 2)))),)

    errors = errors_of("vc660", lambda bench: replace_replies(bench, foreign_rejection), foreign_master=True)
    assert_named(errors, "bus.other_station_replied")


def test_a_reserved_state_is_named() -> None:
    errors = errors_of("c320", lambda bench: replace_replies(bench, in_reserved_state))
    assert_named(errors, "protocols.sunfar.state")


@pytest.mark.parametrize("model", ["c320", "vc660"])
def test_a_late_reply_is_named_with_its_time(model: str) -> None:
    def delay(bench: SimulatedDrives) -> None:
        bench.station().faults.added_delay_s = 0.1

    errors = errors_of(model, delay)
    assert_named(errors, "bus.late_reply")
    assert all(100 <= error.params["milliseconds"] <= 140 for error in errors)


def keys_of_repeated_status(model: str, misbehave: Callable[[SimulatedDrives], None]) -> list[str]:
    """Return the error of each of four reads of the status, a second apart."""

    async def scenario() -> list[str]:
        async with SimulatedDrives(model) as bench:
            drive, keys = bench.drive(), []
            misbehave(bench)
            for _ in range(4):
                with pytest.raises(DrivebusError) as caught:
                    await drive.status()
                keys.append(caught.value.key)
                await asyncio.sleep(1)
        return keys

    return run_virtual(scenario())


@pytest.mark.parametrize(("model", "delay_s"), [("c320", 0.3), ("c320", 1.5), ("vc660", 0.6), ("vc660", 1.5)])
def test_a_reply_later_than_the_quarantine_and_the_next_requests_is_named(model: str, delay_s: float) -> None:
    """Only the first read can't know it: nothing has come yet."""

    def delay(bench: SimulatedDrives) -> None:
        bench.station().faults.added_delay_s = delay_s

    assert keys_of_repeated_status(model, delay) == ["bus.offline", *["bus.late_reply"] * 3]


@pytest.mark.parametrize("model", ["c320", "vc660"])
def test_bytes_between_the_requests_are_not_passed_over_in_silence(model: str) -> None:
    def garble_late(bench: SimulatedDrives) -> None:
        replace_replies(bench, lambda reply: ((0.7, bytes(byte ^ 0x55 for byte in reply)),))

    keys = keys_of_repeated_status(model, garble_late)
    assert keys == ["bus.offline", *["bus.offline_bytes"] * 3]
    hint = i18n.text("hint.bus.offline_bytes")
    assert "reply delay" in hint and "wiring" in hint


def test_a_drive_that_sends_nothing_any_more_is_offline_and_no_longer_called_late() -> None:
    async def scenario() -> list[str]:
        async with SimulatedDrives("c320") as bench:
            drive, faults = bench.drive(), bench.station().faults
            keys = []
            faults.added_delay_s = 0.1
            for _ in range(2):
                with pytest.raises(DrivebusError) as caught:
                    await drive.status()
                keys.append(caught.value.key)
                faults.silent = True
            with pytest.raises(DrivebusError) as caught:
                await drive.status()
            return [*keys, caught.value.key]

    assert run_virtual(scenario())[::2] == ["bus.late_reply", "bus.offline"]


def test_a_drive_that_answers_properly_again_is_accepted() -> None:
    async def scenario() -> DriveStatus:
        async with SimulatedDrives("c320") as bench:
            drive, wire = bench.drive(), simulated_bus_of(bench.port).wire
            transmit = wire.transmit_reply
            replace_replies(bench, stray_before)
            with pytest.raises(DrivebusError):
                await drive.status()
            wire.transmit_reply = transmit  # type: ignore[method-assign]
            return await drive.status()

    assert run_virtual(scenario()).state is DriveState.STOPPED
