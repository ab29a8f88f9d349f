"""A drive's own timing beats its profile's: gap, reply timeout, broadcast turnaround. Exact, virtual time."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import pytest

from drivebus import profiles, stop_bus
from drivebus.bus.messages import BusRequest
from drivebus.bus.silence_timeout import SILENCE_TIMEOUT_S
from drivebus.bus.trace import TraceEvent, TraceKind
from drivebus.errors import NoReply
from drivebus.profiles.schema import MAX_GAP_S, MAX_WAIT_S
from drivebus.serial_settings import StationTiming
from fixtures.drives import SimulatedDrives, run_virtual

FACTORY = profiles.load("c320").timing
CHARACTER_S = 11 / 9600


def watched(bench: SimulatedDrives) -> list[TraceEvent]:
    seen: list[TraceEvent] = []
    bench.bus.trace(seen.append)
    return seen


def ask(drive: Any) -> BusRequest:
    return BusRequest(station=drive.address, request=drive.dialect.echo_test_read())


def test_each_drive_has_the_silence_before_its_frames_that_it_was_given() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("c320", "1-2") as bench:
            plain, slow = bench.drive(1), bench.drive(2, timing=replace(FACTORY, gap_characters=40))
            for drive in (plain, slow):
                await bench.bus.transact(ask(drive))
            seen = watched(bench)
            for drive in (plain, plain, slow, plain):
                assert (await bench.bus.transact(ask(drive))).error is None
            sent = [event for event in seen if event.kind is TraceKind.SENT]
            received = [event for event in seen if event.kind is TraceKind.REPLY]
            gaps = [later.time - before.time for before, later in zip(received, sent[1:], strict=False)]
            assert gaps == pytest.approx([5 * CHARACTER_S, 40 * CHARACTER_S, 40 * CHARACTER_S]), (
                "its reply needs it too"
            )

    run_virtual(scenario())


def test_each_drive_is_waited_for_as_long_as_it_was_given() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("c320", "1-2") as bench:
            patient = replace(FACTORY, reply_delay_s=0.3, reply_delay_characters=0.0, adapter_latency_s=0.05)
            for address, timing in ((1, FACTORY), (2, patient)):
                drive = bench.drive(address, timing=timing)
                bench.station(address).faults.silent = True
                begun = bench.bus.now()
                answer = await bench.bus.transact(ask(drive))
                assert isinstance(answer.error, NoReply) and answer.sent_at is not None
                waited = bench.bus.now() - answer.sent_at - len(answer.sent) * CHARACTER_S
                assert waited == pytest.approx(timing.timeout_s(bench.bus.settings, 18))
                assert begun <= answer.sent_at
                await asyncio.sleep(1)

    run_virtual(scenario())


def test_a_broadcast_leaves_the_turnaround_that_was_given() -> None:
    async def scenario(timing: StationTiming) -> float:
        async with SimulatedDrives("c320", "1") as bench:
            drive = bench.drive(timing=timing)
            await drive.status()
            seen = watched(bench)
            await stop_bus(bench.bus, [drive])
            sent = [event for event in seen if event.kind is TraceKind.SENT]
            first = next(n for n, event in enumerate(sent) if event.data[1:3] == b"1F")
            end = sent[first].time + len(sent[first].data) * CHARACTER_S
            return sent[first + 1].time - end

    assert run_virtual(scenario(replace(FACTORY, turnaround_s=0.1))) == pytest.approx(0.1)
    assert run_virtual(scenario(replace(FACTORY, turnaround_s=0.7))) == pytest.approx(0.7)


def test_a_profile_file_overrides_what_it_names_and_keeps_the_rest(tmp_path: Any) -> None:
    path = tmp_path / "slow.toml"
    path.write_text('format = 1\nextends = "c320"\n[timing]\ngap_characters = 12.0\nturnaround_s = 0.25\n')
    assert profiles.load(path).timing == replace(FACTORY, gap_characters=12.0, turnaround_s=0.25)


@pytest.mark.parametrize(
    "name", ["gap_characters", "reply_delay_s", "adapter_latency_s", "turnaround_s", "max_reply_lateness_s"]
)
@pytest.mark.parametrize("value", [-0.001, float("inf"), float("nan")])
def test_a_time_that_is_none_or_never_ends_is_refused(name: str, value: float) -> None:
    """The override of one drive must not delay the stops of all."""
    with pytest.raises(ValueError, match=name):
        replace(FACTORY, **{name: value})


def test_the_longest_waits_of_a_profile_are_far_below_the_time_after_which_a_bus_is_never_silent(tmp_path: Any) -> None:
    slowest = [profiles.load(name) for name in profiles.models()]
    assert max(profile.timing.gap_floor_s for profile in slowest) <= MAX_GAP_S <= SILENCE_TIMEOUT_S / 4
    assert max(profile.timing.reply_delay_s for profile in slowest) <= MAX_WAIT_S
    path = tmp_path / "slowest.toml"
    path.write_text(
        'format = 1\nextends = "c320"\n[timing]\n'
        f"gap_floor_s = {MAX_GAP_S}\ngap_characters = 27.2\nreply_delay_s = 0.5\nreply_delay_characters = 54.5\n"
    )
    assert profiles.load(path).timing.gap_floor_s == MAX_GAP_S


def test_a_silent_drive_with_the_longest_reply_delay_holds_back_the_stop_of_another_for_little_more_than_that() -> None:
    async def scenario() -> float:
        async with SimulatedDrives("c320", "1-2") as bench:
            slow = replace(FACTORY, reply_delay_s=MAX_WAIT_S, reply_delay_characters=0.0, gap_floor_s=MAX_GAP_S)
            silent, other = bench.drive(1, timing=slow), bench.drive(2)
            bench.station(1).faults.silent = True
            waiting = asyncio.ensure_future(bench.bus.transact(ask(silent)))
            await asyncio.sleep(0.05)
            begun = bench.bus.now()
            sent = watched(bench)
            await other.stop()
            await waiting
            return next(event.time for event in sent if event.kind is TraceKind.SENT and event.time > begun) - begun

    assert run_virtual(scenario()) < MAX_WAIT_S + 0.1
