"""A stop at every address where a drive may be: those that are there are stopped, the others are named."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from drivebus import blocking, profiles
from drivebus.bus import Bus
from drivebus.bus.messages import BusRequest, BusResult
from drivebus.bus.trace import TraceEvent, TraceKind
from drivebus.drives import Drive, StopReport, stop_all_addresses
from drivebus.drives.bus_stop import MAX_SWEEPS
from drivebus.errors import StartInhibited
from drivebus.simulator.port import simulated_bus_of
from fixtures.drives import SAFE_HZ, SimulatedDrives, repeated, run_virtual

ADDRESSES = range(1, 9)


async def stop_at_every_address(bench: SimulatedDrives, *progress: Callable[[Drive, float], None]) -> StopReport:
    drives = [bench.drive(address) for address in ADDRESSES]
    return await stop_all_addresses(bench.bus, drives, *progress)


@pytest.mark.parametrize("model", ["c320", "dzb100", "vc660", "ms300"])
def test_running_drives_at_unknown_addresses_are_stopped_and_the_empty_addresses_are_named(model: str) -> None:
    async def scenario() -> None:
        async with SimulatedDrives(model, "3,7") as bench:
            starter = bench.drive(3)
            await starter.run(SAFE_HZ.get(model, 20.0))
            starter.close()
            assert bench.station(3).running
            report = await stop_at_every_address(bench)
            assert not bench.station(3).running
            assert [address for address, _ in report.outcomes] == [3, 7]
            assert report.confirmed and report.lost == ()
            assert report.absent == (1, 2, 4, 5, 6, 8)

    run_virtual(scenario())


def test_the_reads_for_which_the_stop_of_each_address_waits_go_before_other_reads() -> None:
    """A GD200 is read before it is stopped: reads of other drives without a pause made its stop three times as late."""

    async def scenario() -> float:
        async with SimulatedDrives("gd200", "1-10") as bench:
            read, others = (
                [bench.drive(address) for address in addresses] for addresses in (range(1, 6), range(6, 31))
            )
            async with repeated(Drive.status, read * 4):
                began = bench.bus.now()
                await stop_all_addresses(bench.bus, others)
                return bench.bus.now() - began

    assert run_virtual(scenario()) < 5  # 4.1 s


@pytest.mark.parametrize("model", ["c320", "dzb100", "vc660", "df800"])
def test_a_drive_whose_first_stop_is_lost_is_stopped_and_not_called_absent(model: str) -> None:
    """A single frame lost on a disturbed bus: the drive was counted among the empty addresses, with exit code 0."""

    async def scenario() -> StopReport:
        async with SimulatedDrives(model, "3,7") as bench:
            station, sent = bench.station(3), list[TraceEvent]()

            def lose_first_stop(event: TraceEvent) -> None:
                if event.kind is TraceKind.SENT and event.message.address == 3:
                    sent.append(event)
                station.faults.silent = len(sent) == 1 and event is sent[0]

            starter = bench.drive(3)
            await starter.run(SAFE_HZ[model])
            starter.close()
            bench.bus.trace(lose_first_stop)
            report = await stop_at_every_address(bench)
            await asyncio.sleep(20.0)  # a DF800 only acknowledges the stop, and then decelerates
            station.advance(bench.bus.now())
            assert len(sent) > 1 and not station.running
            return report

    report = run_virtual(scenario())
    assert [address for address, _ in report.outcomes] == [3, 7]
    assert report.absent == (1, 2, 4, 5, 6, 8) and report.unconfirmed == ()


@pytest.mark.parametrize("returns_after_s", [None, 1.0])
def test_a_drive_whose_repeated_stop_the_port_lost_is_lost_until_the_port_is_back(
    returns_after_s: float | None,
) -> None:
    """It was counted among the empty addresses while its motor ran: what the second round lost was dropped."""

    async def scenario() -> tuple[StopReport, bool]:
        async with SimulatedDrives("vc660", "1,7") as bench:
            station, simulated_bus = bench.station(7), simulated_bus_of(bench.port)
            starter = bench.drive(7)
            await starter.run(SAFE_HZ["vc660"])
            starter.close()
            station.faults.silent = True
            reached = list[int]()

            def unplug_in_second_round(drive: Drive, _share: float) -> None:
                reached.append(drive.address)
                if reached.count(3) == 2 and drive.address == 3:
                    station.faults.silent = False
                    simulated_bus.unplug()
                    if returns_after_s is not None:
                        asyncio.get_running_loop().call_later(returns_after_s, simulated_bus.replug)

            report = await stop_at_every_address(bench, unplug_in_second_round)
            station.advance(bench.bus.now())
            return report, station.running

    report, running = run_virtual(scenario())
    stopped = [address for address, _ in report.outcomes]
    if returns_after_s is None:
        assert running and not report.confirmed
        assert (stopped, report.lost, report.absent) == ([1], (4, 5, 6, 7, 8), (2, 3))
    else:
        assert not running and report.confirmed
        assert (stopped, report.lost, report.absent) == ([1, 7], (), (2, 3, 4, 5, 6, 8))


def test_a_drive_that_replies_late_is_stopped_before_the_silent_addresses_are_sent_their_second_stop() -> None:
    """With 247 addresses the stop of a running drive was repeated only half a minute after its first frame."""
    swept = list[int]()

    async def scenario() -> tuple[StopReport, list[int]]:
        async with SimulatedDrives("vc660", "3") as bench:
            wire = simulated_bus_of(bench.port).wire
            transmit = wire.transmit_reply
            wire.transmit_reply = lambda source, data, now, at: transmit(source, data, now, at + 0.3)  # type: ignore[method-assign]
            swept_before = list[int]()

            def on_frame(event: TraceEvent) -> None:
                if event.kind is TraceKind.SENT and event.message.address == 3:
                    swept_before.append(len(swept))

            bench.bus.trace(on_frame)
            return await stop_at_every_address(bench, lambda drive, _: swept.append(drive.address)), swept_before

    report, swept_before = run_virtual(scenario())
    assert [address for address, _ in report.outcomes] == [3]
    assert swept == [*ADDRESSES, *(address for address in ADDRESSES if address != 3)]
    assert swept_before[0] == 2 and swept_before.count(len(ADDRESSES)) > 2  # repeated between the rounds


def test_starts_are_inhibited_from_the_first_frame_on() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("vc660", "1") as bench:
            drive = bench.drive(1)
            await stop_all_addresses(bench.bus, [drive])
            with pytest.raises(StartInhibited):
                await drive.run(20.0)
            assert not bench.station(1).running

    run_virtual(scenario())


def test_the_progress_names_each_address_and_ends_at_the_whole() -> None:
    seen: list[tuple[int, float]] = []

    async def scenario() -> None:
        async with SimulatedDrives("vc660", "2") as bench:
            await stop_at_every_address(bench, lambda drive, share: seen.append((drive.address, share)))

    run_virtual(scenario())
    silent = [address for address in ADDRESSES if address != 2]
    assert seen == [
        *[(address, address / 8) for address in ADDRESSES],
        *[(address, number / 7) for number, address in enumerate(silent, 1)],
    ]


@pytest.mark.parametrize("returns_after_s", [None, 1.0])
def test_addresses_that_a_lost_port_left_out_are_no_confirmed_stop_until_the_port_is_back(
    monkeypatch: pytest.MonkeyPatch, returns_after_s: float | None
) -> None:
    """A drive may run at each of them."""
    transact, asked = Bus.transact, list[int]()

    async def lose_the_port(bus: Bus, request: BusRequest) -> BusResult:
        asked.append(request.station)
        if len(asked) == 6:
            simulated_bus = simulated_bus_of(bus.port)
            simulated_bus.unplug()
            if returns_after_s is not None:
                asyncio.get_running_loop().call_later(returns_after_s, simulated_bus.replug)
        return await transact(bus, request)

    async def scenario() -> StopReport:
        async with SimulatedDrives("vc660", "2,8") as bench:
            return await stop_at_every_address(bench)

    monkeypatch.setattr(Bus, "transact", lose_the_port)
    report = run_virtual(scenario())
    stopped = [address for address, _ in report.outcomes]
    assert report.confirmed is (returns_after_s is not None)
    if returns_after_s is None:
        assert report.lost and 8 in report.lost and 8 not in report.absent
    else:
        assert (stopped, report.lost, report.absent) == ([2, 8], (), (1, 3, 4, 5, 6, 7))


def test_a_port_that_is_lost_again_and_again_ends_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    turns: list[float] = []

    async def scenario() -> StopReport:
        async with SimulatedDrives("vc660", "1") as bench:

            def lose_the_port(_drive: Drive, share: float) -> None:
                if share < 0.9:
                    return
                turns.append(share)
                simulated_bus_of(bench.port).unplug()
                asyncio.get_running_loop().call_later(0.2, simulated_bus_of(bench.port).replug)

            return await stop_at_every_address(bench, lose_the_port)

    report = run_virtual(scenario())
    assert len(turns) <= MAX_SWEEPS
    assert {address for address, _ in report.outcomes} | {*report.absent, *report.lost} == set(ADDRESSES)


def test_an_empty_line_is_no_confirmed_stop() -> None:
    """The cable may be broken, and every drive of the bus may run."""

    async def scenario() -> StopReport:
        async with SimulatedDrives("vc660", "1") as bench:
            bench.station(1).faults.silent = True
            return await stop_at_every_address(bench)

    report = run_virtual(scenario())
    assert (report.outcomes, report.confirmed, report.absent) == ((), False, tuple(ADDRESSES))


def test_the_report_begins_with_the_first_frame_and_has_every_broadcast() -> None:
    async def scenario() -> None:
        async with SimulatedDrives("c320", "3") as bench:
            broadcasts = list[float]()

            def on_frame(event: TraceEvent) -> None:
                if event.kind is TraceKind.SENT and event.message.address == profiles.load("c320").broadcast:
                    broadcasts.append(event.time)

            bench.bus.trace(on_frame)
            began = bench.bus.now()
            report = await stop_at_every_address(bench)
            assert report.started_at == began
            assert broadcasts and [each.sent_at for each in report.broadcasts] == broadcasts

    run_virtual(scenario())


def test_no_address_is_an_empty_report() -> None:
    async def scenario() -> StopReport:
        async with SimulatedDrives("vc660", "1") as bench:
            return await stop_all_addresses(bench.bus, [])

    report = run_virtual(scenario())
    assert (report.outcomes, report.absent, report.lost) == ((), (), ())


def test_a_blocking_program_stops_every_address() -> None:
    with blocking.open_bus("sim://vc660@2?baud=38400") as bus:
        drives = [blocking.Drive(bus, "vc660", address) for address in (1, 2)]
        report = blocking.stop_all_addresses(bus, drives)
        assert (report.confirmed, report.absent) == (True, (1,))
