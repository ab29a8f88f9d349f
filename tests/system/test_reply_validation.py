"""What must never be believed: late answers (I5), echoes, second drives at one address, other masters.

The truth is kept at the stations: each read shows a number that no other read shows, and it is written down for which
request it was made.
"""

from __future__ import annotations

import asyncio
import itertools
from typing import Any

import pytest

from drivebus.bus import Bus, Poll
from drivebus.bus.messages import BusRequest, BusResult, Permit, RequestPriority, RetryPolicy
from drivebus.drives import Drive, MemoryStore
from drivebus.errors import NoReply, StartInhibited
from drivebus.ports import open_port
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.protocols.codec import Effect
from drivebus.simulator.models.catalog import make_station
from drivebus.simulator.port import clear_simulated_buses
from fixtures.system_bench import (
    C320,
    DF800,
    VC660,
    SystemBench,
    SystemVariant,
    command_ending,
    every_drive,
    every_family,
    run_virtual,
    system_bench,
    wait_until,
)

TRANSACTIONS = 2000


def similar_reads(kind: SystemVariant, address: int) -> list[Any]:
    """Reads that look alike: four of one shape, as 5.3 models them."""
    if kind.model == "c320":
        return [sunfar.ReadMonitor(address, item) for item in (0, 2, 4, 5)]
    if kind.model == "dzb100":
        return [dzb100.Dzb100Query(address, item) for item in (0, 1, 2)]
    base = 0x3001 if kind.model == "vc660" else 0
    return [modbus.ReadRegisters(address, base + n, 1) for n in range(4)]


class ReplyLedger:
    """Makes every value that a station shows a new one, and knows for which request's end on the wire it was made."""

    def __init__(self, here: SystemBench) -> None:
        self.replies: dict[tuple[int, int], float] = {}
        """(station, value) → second at which the request had ended."""
        for station in here.bench.stations:
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
    """The number in a reply."""
    return reply.values[0] if isinstance(reply, modbus.RegisterValues) else reply.data


@pytest.mark.parametrize(
    "weather", ["late=0.05:0.4,bytes", "late=0.2:5", "late=0.1:5,loss=0.05,flip=0.001,duplicate=0.05"]
)
@every_family
def test_none_of_2000_transactions_gets_the_reply_of_another(kind: SystemVariant, weather: str) -> None:
    """Lateness up to 5 s; a station answers in order."""

    async def scenario() -> None:
        async with system_bench(kind, "1-4", weather, seed=7) as here:
            ledger = ReplyLedger(here)
            answers: list[BusResult] = []
            for address in here.drives:
                here.bus.start_polling(
                    address, [Poll(request, 0.0) for request in similar_reads(kind, address)], answers.append
                )
            await wait_until(lambda: here.bus.statistics().transactions >= TRANSACTIONS, 5.0)
            believed = [answer for answer in answers if answer.error is None]
            assert len(believed) >= 100
            carried = {round(one.end, 6): one for one in here.tap.replies_sent}
            for answer in believed:
                assert answer.sent_at is not None and answer.received_at is not None
                source = carried[round(answer.received_at, 6)]
                if bytes(source.transmission.data) != source.data:
                    assert kind.model == "dzb100", "a check value catches what a collision garbled"
                    continue
                made_at = ledger.replies[answer.bus_request.station, value_of(answer.reply)]
                assert answer.sent_at < made_at <= answer.received_at, "this answer belongs to another request"
            here.tap.check(kind)

    run_virtual(scenario())


def permitted_write(here: SystemBench, address: int, request: Any) -> BusRequest:
    """A write with a good permit."""
    link = here.link(address)
    effect = link.effect_of(link.codec.encode_request(request))
    assert effect in (Effect.SETTING, Effect.MOTION)
    until = here.bus.now() + 60.0
    permit = Permit(
        station=address,
        effect=effect,
        retry_policy=RetryPolicy.EDGE_TRIGGERED,
        expires_at=until,
        stop_epoch=here.bus.stop_epoch(address),
        command_id="story",
    )
    return BusRequest(address, request, RequestPriority.COMMAND, RetryPolicy.EDGE_TRIGGERED, permit, until)


@pytest.mark.parametrize("setting", ["on", "off", "detect"])
@pytest.mark.parametrize("echoes", [True, False], ids=["echo", "no echo"])
@every_family
def test_a_wrong_echo_setting_never_forges_an_acknowledgement(kind: SystemVariant, echoes: bool, setting: str) -> None:
    """Writes to a drive that is not there, beside one that is."""

    async def scenario() -> None:
        async with system_bench(kind, "1-2", "echo,bytes" if echoes else "bytes", echo=setting) as here:
            dialect = here.drives[2].dialect
            here.station(2).faults.silent = True
            word = dialect.setpoint_word(10.0)
            writes = [dialect.start(None, word)[0].request, dialect.reset()[0].request]
            if not dialect.start_includes_setpoint:
                writes.append(dialect.set_frequency(word, None)[0].request)
            if kind.model == "c320":
                writes.append(sunfar.SunfarWriteParameter(2, 6, 12, 0))
            for number in range(120):
                if number % 3 == 0:
                    await here.bus.transact(
                        BusRequest(1, here.drives[1].dialect.echo_test_read(), RequestPriority.COMMAND)
                    )
                answer = await here.bus.transact(permitted_write(here, 2, writes[number % len(writes)]))
                assert answer.error is not None and answer.reply is None
            if setting == "detect" or (setting == "on") is echoes:
                fine = await here.bus.transact(
                    BusRequest(1, here.drives[1].dialect.echo_test_read(), RequestPriority.COMMAND)
                )
                assert fine.error is None, "the living drive is heard through it"

    run_virtual(scenario())


@pytest.mark.parametrize("setting", ["on", "off", "detect"])
@pytest.mark.parametrize("echoes", [True, False], ids=["echo", "no echo"])
@every_drive
def test_a_stopped_drive_behind_an_echo_is_never_reported_started(
    kind: SystemVariant, echoes: bool, setting: str
) -> None:
    async def scenario() -> None:
        async with system_bench(kind, "1", "echo" if echoes else "clean", echo=setting) as here:
            outcome = await command_ending(here.drive.run(20.0))
            if getattr(outcome, "succeeded", False):
                assert here.motor.energised
            await command_ending(here.drive.stop())
            here.station().faults.silent = True
            starts = here.motor.starts
            outcome = await command_ending(here.drive.run(20.0))
            assert not getattr(outcome, "succeeded", False) and here.motor.starts == starts

    run_virtual(scenario())


@every_drive
def test_another_master_is_detected_and_inhibits_every_start(kind: SystemVariant) -> None:
    """Flagged within two of its frames; a stop goes out all the same."""

    async def scenario() -> None:
        clear_simulated_buses()
        async with system_bench(kind, "1-2", name="shared") as here:
            assert (await command_ending(here.drives[1].run(10.0))).succeeded
            other: Any = open_port(kind.url("1-2", name="shared"))

            class Deaf:
                def data_received(self, data: bytes, marks: int = 0) -> None: ...
                def port_lost(self, error: Exception) -> None: ...

            await other.open(Deaf())
            frame = here.link(2).codec.encode_request(here.drives[2].dialect.echo_test_read())
            for _ in range(2):
                other.write(frame)
                await asyncio.sleep(1.0)
            assert here.bus.health(2).foreign_master
            starts = here.station(2).motor.starts
            with pytest.raises(StartInhibited) as caught:
                await here.drives[2].run(10.0)
            assert caught.value.key == "drives.foreign_master"
            assert here.station(2).motor.starts == starts
            stopped = await command_ending(here.drives[1].stop())
            assert stopped.succeeded and (not kind.reports_running or not here.station(1).motor.energised)
            await other.close()
            await asyncio.sleep(61.0)
            assert not here.bus.health(2).foreign_master, "a minute of peace ends it"
            assert (await command_ending(here.drives[2].run(10.0))).succeeded
        clear_simulated_buses()

    run_virtual(scenario())


async def duplicate_drive(kind: SystemVariant, here: SystemBench, skew_s: float) -> None:
    """A second drive at the first one's address, that answers so much later; and twenty seconds of polls."""
    double = make_station(kind.model, 1, dict(kind.options))
    double.faults.added_delay_s = skew_s
    here.bench.add(double)
    here.bus.start_polling(1, [Poll(here.drive.dialect.echo_test_read(), 0.5)], lambda answer: None)
    await asyncio.sleep(20.0)


@every_drive
def test_two_drives_at_one_address_are_detected_and_stopped_but_not_started(kind: SystemVariant) -> None:
    """Two answers to one question; the command is blocked, the stop is not."""

    async def scenario() -> None:
        async with system_bench(kind) as here:
            await duplicate_drive(
                kind, here, 0.12
            )  # well behind the answer: what comes into the next one only looks like noise
            assert here.bus.health(1).duplicate_address
            outcome = await command_ending(here.drive.run(10.0))
            assert not getattr(outcome, "succeeded", False)
            here.bench.advance()
            assert all(station.motor.starts == 0 for station in here.bench.stations)
            for station in here.bench.stations:
                station.keypad_run(10.0)
            await asyncio.sleep(2.0)
            await command_ending(here.drive.stop())
            await asyncio.sleep(5.0)
            here.bench.advance()
            assert not any(station.motor.energised for station in here.bench.stations)

    run_virtual(scenario())


@pytest.mark.parametrize("skew_s", [0.0, 0.003, 0.01, 0.02, 0.035, 0.06, 0.15])
@every_family
def test_a_duplicate_address_is_never_started_whenever_the_second_drive_replies(
    kind: SystemVariant, skew_s: float
) -> None:
    """As two overlapping answers, as bytes behind an answer, as a second answer: whatever it looks like."""

    async def scenario() -> None:
        async with system_bench(kind) as here:
            await duplicate_drive(kind, here, skew_s)
            outcome = await command_ending(here.drive.run(10.0))
            assert not getattr(outcome, "succeeded", False)
            here.bench.advance()
            assert all(station.motor.starts == 0 for station in here.bench.stations)

    run_virtual(scenario())


@pytest.mark.parametrize("kind", [C320, VC660, DF800], ids=lambda kind: kind.name)
def test_a_reply_under_a_wrong_address_belongs_to_no_station(kind: SystemVariant) -> None:
    """It is dropped, and waiting goes on to the deadline."""

    async def scenario() -> None:
        async with system_bench(kind, "1-2") as here:
            here.station(1).faults.wrong_address = 2
            for _ in range(20):
                answer = await here.bus.transact(
                    BusRequest(1, here.drives[1].dialect.echo_test_read(), RequestPriority.COMMAND)
                )
                assert isinstance(answer.error, NoReply)
                fine = await here.bus.transact(
                    BusRequest(2, here.drives[2].dialect.echo_test_read(), RequestPriority.COMMAND)
                )
                assert fine.error is None or isinstance(fine.error, NoReply)
            outcome = await command_ending(here.drives[1].run(10.0))
            assert not getattr(outcome, "succeeded", False)
            assert here.station(1).motor.starts == 0 and here.station(2).motor.starts == 0

    run_virtual(scenario())


@pytest.mark.parametrize("kind", [C320, VC660], ids=lambda kind: kind.name)
def test_a_drive_with_frozen_monitors_is_not_reported_stopped(kind: SystemVariant) -> None:
    """Where the state goes on saying "running" the stop stays unconfirmed; of C320 each reply has it afresh."""

    async def scenario() -> None:
        async with system_bench(kind) as here:
            drive = here.drive
            await drive.run(20.0, wait=True)
            here.station().faults.frozen_readings = True
            await drive.status()
            outcome = await command_ending(drive.stop())
            assert outcome.status == ("confirmed" if kind is C320 else "unknown") and not here.motor.energised

    run_virtual(scenario())


def test_a_second_bus_on_the_same_drive_counts_as_a_foreign_master() -> None:
    """Two programs on one line: each notices the other."""

    async def scenario() -> None:
        clear_simulated_buses()
        async with system_bench(C320, name="two") as here:
            other = Bus(open_port(C320.url(name="two")), name="other")
            twin = Drive(other, "c320", 1, encoding="ascii", store=MemoryStore())
            async with other:
                for _ in range(3):
                    await here.drive.status()
                    await asyncio.sleep(0.5)
                    await twin.status()
                    await asyncio.sleep(0.5)
                assert here.bus.health(1).foreign_master and other.health(1).foreign_master
                for drive in (here.drive, twin):
                    with pytest.raises(StartInhibited) as caught:
                        await drive.run(10.0)
                    assert caught.value.key == "drives.foreign_master"
            assert here.motor.starts == 0
        clear_simulated_buses()

    run_virtual(scenario())
