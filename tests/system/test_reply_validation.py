"""Replies that must not be accepted: late replies (I5), echoes, second drives at one address, other masters.

Each read of a simulated station returns a number that no other read returns, recorded with the time of its request.
"""

from __future__ import annotations

import asyncio
import itertools
from typing import Any

import pytest

from drivebus.bus import Bus, Poll
from drivebus.bus.messages import BusRequest, BusResult, Permit, RequestPriority, RetryPolicy
from drivebus.drives import Drive, MemoryStore
from drivebus.errors import AddressError, NoReply, StartInhibited
from drivebus.ports import open_port
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.protocols.codec import Effect
from drivebus.simulator.models.catalog import make_station
from drivebus.simulator.port import clear_simulated_buses
from fixtures.receiver import FakeReceiver
from fixtures.system_bench import (
    C320,
    DF800,
    VC660,
    SystemBench,
    SystemVariant,
    every_drive,
    every_family,
    outcome_or_error,
    run_virtual,
    system_bench,
    wait_until,
)

TRANSACTIONS = 2000


def similar_reads(variant: SystemVariant, address: int) -> list[Any]:
    """Return up to four reads whose replies have the same shape."""
    if variant.model == "c320":
        return [sunfar.ReadMonitor(address, item) for item in (0, 2, 4, 5)]
    if variant.model == "dzb100":
        return [dzb100.Dzb100Query(address, item) for item in (0, 1, 2)]
    base = 0x3001 if variant.model == "vc660" else 0
    return [modbus.ReadRegisters(address, base + n, 1) for n in range(4)]


class ReplyLedger:
    """Unique values for every read of the stations, each with the end time of its request."""

    def __init__(self, bench: SystemBench) -> None:
        self.replies: dict[tuple[int, int], float] = {}
        """(station, value) → second at which the request had ended."""
        for station in bench.simulated_bus.stations:
            self._number(station)

    def _number(self, station: Any) -> None:
        count = itertools.count(1)

        def next_value(*_: object) -> int:
            value = next(count) % 0xFFFF
            self.replies[station.address, value] = station.now
            return value

        for name in ("monitor", "query_word", "_monitor"):
            if hasattr(station, name):
                setattr(station, name, next_value)


def value_of(reply: Any) -> int:
    """Return the number in a reply."""
    return reply.values[0] if isinstance(reply, modbus.RegisterValues) else reply.data


@pytest.mark.parametrize(
    "line_quality", ["late=0.05:0.4,bytes", "late=0.2:5", "late=0.1:5,loss=0.05,flip=0.001,duplicate=0.05"]
)
@every_family
def test_none_of_2000_transactions_gets_the_reply_of_another(variant: SystemVariant, line_quality: str) -> None:
    """Replies are up to 5 s late; those of one station keep their order."""

    async def scenario() -> None:
        async with system_bench(variant, "1-4", line_quality, seed=7) as bench:
            ledger = ReplyLedger(bench)
            results: list[BusResult] = []
            for address in bench.drives:
                bench.bus.start_polling(
                    address, [Poll(request, 0.0) for request in similar_reads(variant, address)], results.append
                )
            await wait_until(lambda: bench.bus.statistics().transactions >= TRANSACTIONS, 5.0)
            accepted = [result for result in results if result.error is None]
            assert len(accepted) >= 100
            replies = {round(frame.end, 6): frame for frame in bench.tap.replies_sent}
            for result in accepted:
                assert result.sent_at is not None and result.received_at is not None
                source = replies[round(result.received_at, 6)]
                if bytes(source.transmission.data) != source.data:
                    assert variant.model == "dzb100", "a check value detects the damage of a collision"
                    continue
                made_at = ledger.replies[result.bus_request.station, value_of(result.reply)]
                assert result.sent_at < made_at <= result.received_at, "this reply belongs to another request"
            bench.tap.check(variant)

    run_virtual(scenario())


def permitted_write(bench: SystemBench, address: int, request: Any) -> BusRequest:
    """Return a write with a valid permit."""
    config = bench.station_config(address)
    effect = config.effect_of(config.codec.encode_request(request))
    assert effect in (Effect.SETTING, Effect.MOTION)
    until = bench.bus.now() + 60.0
    permit = Permit(
        station=address,
        effect=effect,
        retry_policy=RetryPolicy.EDGE_TRIGGERED,
        expires_at=until,
        stop_epoch=bench.bus.stop_epoch(address),
        command_id="test",
    )
    return BusRequest(
        station=address,
        request=request,
        priority=RequestPriority.COMMAND,
        permit=permit,
        expires_at=until,
    )


@pytest.mark.parametrize("setting", ["on", "off", "detect"])
@pytest.mark.parametrize("echoes", [True, False], ids=["echo", "no echo"])
@every_family
def test_a_wrong_echo_setting_never_forges_an_acknowledgement(
    variant: SystemVariant, echoes: bool, setting: str
) -> None:
    """Writes to an absent drive alternate with reads of one that is present."""

    async def scenario() -> None:
        async with system_bench(variant, "1-2", "echo,bytes" if echoes else "bytes", echo=setting) as bench:
            dialect = bench.drives[2].dialect
            bench.station(2).faults.silent = True
            word = dialect.setpoint_word(10.0)
            writes = [dialect.start(None, word)[0].request, dialect.reset()[0].request]
            if not dialect.start_includes_setpoint:
                writes.append(dialect.set_frequency(word, None)[0].request)
            if variant.model == "c320":
                writes.append(sunfar.SunfarWriteParameter(2, 6, 12, 0))
            for number in range(120):
                if number % 3 == 0:
                    await bench.bus.transact(
                        BusRequest(
                            station=1,
                            request=bench.drives[1].dialect.echo_test_read(),
                            priority=RequestPriority.COMMAND,
                        )
                    )
                result = await bench.bus.transact(permitted_write(bench, 2, writes[number % len(writes)]))
                assert result.error is not None and result.reply is None
            if setting == "detect" or (setting == "on") is echoes:
                accepted = await bench.bus.transact(
                    BusRequest(
                        station=1, request=bench.drives[1].dialect.echo_test_read(), priority=RequestPriority.COMMAND
                    )
                )
                assert accepted.error is None, "the replies of the other drive are received"

    run_virtual(scenario())


@pytest.mark.parametrize("setting", ["on", "off", "detect"])
@pytest.mark.parametrize("echoes", [True, False], ids=["echo", "no echo"])
@every_drive
def test_a_stopped_drive_behind_an_echo_is_never_reported_started(
    variant: SystemVariant, echoes: bool, setting: str
) -> None:
    async def scenario() -> None:
        async with system_bench(variant, "1", "echo" if echoes else "clean", echo=setting) as bench:
            outcome = await outcome_or_error(bench.drive.run(20.0))
            if getattr(outcome, "succeeded", False):
                assert bench.motor.energised
            await outcome_or_error(bench.drive.stop())
            bench.station().faults.silent = True
            starts = bench.motor.starts
            outcome = await outcome_or_error(bench.drive.run(20.0))
            assert not getattr(outcome, "succeeded", False) and bench.motor.starts == starts

    run_virtual(scenario())


@every_drive
def test_another_master_is_detected_and_inhibits_every_start(variant: SystemVariant) -> None:
    """It is detected within two of its frames; a stop is still sent."""

    async def scenario() -> None:
        clear_simulated_buses()
        async with system_bench(variant, "1-2", name="shared") as bench:
            assert (await outcome_or_error(bench.drives[1].run(10.0))).succeeded
            other: Any = open_port(variant.url("1-2", name="shared"))

            await other.open(FakeReceiver())
            frame = bench.station_config(2).codec.encode_request(bench.drives[2].dialect.echo_test_read())
            for _ in range(2):
                other.write(frame)
                await asyncio.sleep(1.0)
            assert bench.bus.health(2).foreign_master
            starts = bench.station(2).motor.starts
            with pytest.raises(StartInhibited) as caught:
                await bench.drives[2].run(10.0)
            assert caught.value.key == "drives.foreign_master"
            assert bench.station(2).motor.starts == starts
            stopped = await outcome_or_error(bench.drives[1].stop())
            assert stopped.succeeded and (not variant.reports_running or not bench.station(1).motor.energised)
            await other.close()
            await asyncio.sleep(61.0)
            assert not bench.bus.health(2).foreign_master, "it ends after a minute without its frames"
            assert (await outcome_or_error(bench.drives[2].run(10.0))).succeeded
        clear_simulated_buses()

    run_virtual(scenario())


async def duplicate_drive(variant: SystemVariant, bench: SystemBench, skew_s: float) -> None:
    """Add a second drive at the first one's address that replies ``skew_s`` later, and poll for twenty seconds."""
    second = make_station(variant.model, 1, dict(variant.options))
    second.faults.added_delay_s = skew_s
    bench.simulated_bus.add(second)
    bench.bus.start_polling(1, [Poll(bench.drive.dialect.echo_test_read(), 0.5)], lambda result: None)
    await asyncio.sleep(20.0)


@every_drive
def test_two_drives_at_one_address_are_detected_and_stopped_but_not_started(variant: SystemVariant) -> None:
    """Two replies to one request inhibit the start but not the stop."""

    async def scenario() -> None:
        async with system_bench(variant) as bench:
            # After the first reply: a second one within the next transaction would look like noise.
            await duplicate_drive(variant, bench, 0.12)
            assert bench.bus.health(1).duplicate_address
            outcome = await outcome_or_error(bench.drive.run(10.0))
            assert not getattr(outcome, "succeeded", False)
            bench.simulated_bus.advance()
            assert all(station.motor.starts == 0 for station in bench.simulated_bus.stations)
            for station in bench.simulated_bus.stations:
                station.keypad_run(10.0)
            await asyncio.sleep(2.0)
            await outcome_or_error(bench.drive.stop())
            await asyncio.sleep(5.0)
            bench.simulated_bus.advance()
            assert not any(station.motor.energised for station in bench.simulated_bus.stations)

    run_virtual(scenario())


@pytest.mark.parametrize("skew_s", [0.0, 0.003, 0.01, 0.02, 0.035, 0.06, 0.15])
@every_family
def test_a_duplicate_address_is_never_started_whenever_the_second_drive_replies(
    variant: SystemVariant, skew_s: float
) -> None:
    """The replies overlap, follow each other without a gap, or arrive one after the other."""

    async def scenario() -> None:
        async with system_bench(variant) as bench:
            await duplicate_drive(variant, bench, skew_s)
            outcome = await outcome_or_error(bench.drive.run(10.0))
            assert not getattr(outcome, "succeeded", False)
            bench.simulated_bus.advance()
            assert all(station.motor.starts == 0 for station in bench.simulated_bus.stations)

    run_virtual(scenario())


@pytest.mark.parametrize("variant", [C320, VC660, DF800], ids=lambda variant: variant.name)
def test_a_reply_under_a_wrong_address_belongs_to_no_station(variant: SystemVariant) -> None:
    """It is dropped, and the transaction waits until its deadline."""

    async def scenario() -> None:
        async with system_bench(variant, "1-2") as bench:
            bench.station(1).faults.wrong_address = 2
            for _ in range(20):
                rejected = await bench.bus.transact(
                    BusRequest(
                        station=1, request=bench.drives[1].dialect.echo_test_read(), priority=RequestPriority.COMMAND
                    )
                )
                assert isinstance(rejected.error, NoReply | AddressError)
                accepted = await bench.bus.transact(
                    BusRequest(
                        station=2, request=bench.drives[2].dialect.echo_test_read(), priority=RequestPriority.COMMAND
                    )
                )
                assert accepted.error is None or isinstance(accepted.error, NoReply)
            outcome = await outcome_or_error(bench.drives[1].run(10.0))
            assert not getattr(outcome, "succeeded", False)
            assert bench.station(1).motor.starts == 0 and bench.station(2).motor.starts == 0

    run_virtual(scenario())


@pytest.mark.parametrize("variant", [C320, VC660], ids=lambda variant: variant.name)
def test_a_drive_with_frozen_monitors_is_not_reported_stopped(variant: SystemVariant) -> None:
    """A stop stays unconfirmed while the state is "running"; each reply of a C320 has the present state."""

    async def scenario() -> None:
        async with system_bench(variant) as bench:
            drive = bench.drive
            await drive.run(20.0, wait=True)
            bench.station().faults.frozen_readings = True
            await drive.status()
            outcome = await outcome_or_error(drive.stop())
            assert outcome.status == ("confirmed" if variant is C320 else "unknown") and not bench.motor.energised

    run_virtual(scenario())


def test_a_second_bus_on_the_same_drive_counts_as_a_foreign_master() -> None:
    """Two programs on one bus detect each other."""

    async def scenario() -> None:
        clear_simulated_buses()
        async with system_bench(C320, name="two") as bench:
            other = Bus(open_port(C320.url(name="two")), name="other")
            second = Drive(other, "c320", 1, encoding="ascii", store=MemoryStore())
            async with other:
                for _ in range(3):
                    await bench.drive.status()
                    await asyncio.sleep(0.5)
                    await second.status()
                    await asyncio.sleep(0.5)
                assert bench.bus.health(1).foreign_master and other.health(1).foreign_master
                for drive in (bench.drive, second):
                    with pytest.raises(StartInhibited) as caught:
                        await drive.run(10.0)
                    assert caught.value.key == "drives.foreign_master"
            assert bench.motor.starts == 0
        clear_simulated_buses()

    run_virtual(scenario())
