"""Reading of a bus: bytes wait in the kernel until a reply is probably complete, and none of them is overlooked."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from copy import copy
from random import Random

import pytest

from drivebus.bus import Bus, Poll
from drivebus.bus.messages import BusResult
from drivebus.bus.prepared_request import PreparedPoll, PreparedRequest
from drivebus.bus.transaction import Transaction
from drivebus.bus.usual_delay import DELAY_STEP_S, MAX_SCATTER_S, UsualDelay
from drivebus.errors import PortLost, TrailingError
from drivebus.protocols import modbus
from drivebus.testing.bus_script import ScriptedPort
from drivebus.testing.virtual_time import run
from fixtures.bus import (
    CHARACTER_S,
    CODEC,
    SETTINGS,
    FakeStation,
    byte_by_byte,
    make_core,
    read,
    read_request,
    station_config,
    wire_to,
)

GAP_S = 3.5 * CHARACTER_S


class PausablePort(ScriptedPort):
    """Scripted port whose bytes wait while it is paused."""

    paused = False
    hung_up = False
    waiting = b""
    read_count = resume_count = 0

    def pause_reading(self) -> None:
        self.paused = True

    def resume_reading(self) -> None:
        self.resume_count += self.paused
        self.paused = False
        asyncio.get_running_loop().call_soon(self._read)

    def read_pending(self) -> None:
        self._read()

    def _deliver(self, data: bytes, opening: int) -> None:
        self.waiting += data
        if not self.paused:
            self._read()

    def _read(self) -> None:
        if self.hung_up:
            self.unplug()
        elif self.waiting:
            self.read_count += 1
            data, self.waiting = self.waiting, b""
            super()._deliver(data, self.openings)


def paused_bus(port: PausablePort, *addresses: int) -> Bus:
    bus = Bus(port)
    for address in addresses:
        bus.add_station(station_config(address))
    return bus


async def poll(period_s: float, *durations_s: float) -> list[tuple[list[BusResult], PausablePort]]:
    """Poll a station for these seconds one after the other; return the results and the port's counts of each."""
    port = PausablePort(wire_to(FakeStation(delay_s=0.005), deliver=byte_by_byte))
    results: list[BusResult] = []
    found = []
    async with paused_bus(port, 1) as bus:
        bus.start_polling(1, [Poll(read(), period_s)], results.append)
        for duration_s in durations_s:
            port.read_count = port.resume_count = 0
            results.clear()
            await asyncio.sleep(duration_s)
            found.append((list(results), copy(port)))
    return found


def test_a_reply_is_read_in_parts_at_first_and_then_mostly_at_once() -> None:
    (first, first_port), _, (results, port) = run(poll(0.1, 1.0, 9.0, 20.0))
    assert len(results) == 200 and all(result.error is None for result in results)
    assert first_port.read_count / len(first) > 1.5 and port.read_count / len(results) < 1.7
    ideal = 8 * CHARACTER_S + 0.005 + 13 * CHARACTER_S
    late = [(result.received_at or 0.0) - (result.sent_at or 0.0) - ideal for result in results]
    assert min(late) > -1e-9 and max(late) < 5 * DELAY_STEP_S


def test_a_busy_bus_reads_each_reply_once_and_leaves_the_reader_paused_in_between() -> None:
    _, (results, port) = run(poll(0.0, 10.0, 10.0))
    assert port.read_count < 1.6 * len(results) and port.resume_count < 0.6 * len(results)


def test_a_reply_that_only_the_deadline_finds_in_the_kernel_is_accepted() -> None:
    """A busy loop may serve its timers before its readers."""

    class UnwatchedPort(PausablePort):
        def resume_reading(self) -> None:
            pass

        def _deliver(self, data: bytes, opening: int) -> None:
            self.waiting += data

    async def main() -> None:
        port = UnwatchedPort(wire_to(FakeStation(), deliver=byte_by_byte))
        async with paused_bus(port, 1) as bus:
            assert (await bus.transact(read_request())).error is None

    run(main())


def test_a_byte_after_the_reply_is_noticed_although_it_waits_in_the_kernel() -> None:
    """A second reply within the gap is that of a second drive at the address: the first one must not be accepted."""

    def with_second_byte(reply: bytes, begins_at: float) -> Iterable[tuple[float, bytes]]:
        ends_at = begins_at + len(reply) * CHARACTER_S
        return [(ends_at, reply), (ends_at + GAP_S / 2, b"\x01")]

    async def main() -> None:
        port = PausablePort(wire_to(FakeStation(), deliver=with_second_byte))
        async with paused_bus(port, 1) as bus:
            result = await bus.transact(read_request())
            assert isinstance(result.error, TrailingError)

    run(main())


def test_bytes_between_transactions_are_read_as_they_come() -> None:
    """Without a transaction every byte matters: another master may be speaking."""

    async def main() -> None:
        port = PausablePort(wire_to(FakeStation(), deliver=byte_by_byte))
        async with paused_bus(port, 1) as bus:
            for _ in range(3):
                assert (await bus.transact(read_request())).error is None
            await asyncio.sleep(0.1)
            assert not port.paused
            port._deliver(b"\x55", port.openings)
            assert port.waiting == b""

    run(main())


@pytest.mark.parametrize("alive_for_s", [0.0, 3.0])
def test_a_missing_reply_ends_at_its_deadline_as_on_a_port_without_pauses(alive_for_s: float) -> None:
    async def duration_s(port: ScriptedPort, station: FakeStation) -> float:
        bus = Bus(port)
        bus.add_station(station_config(1))
        async with bus:
            bus.start_polling(1, [Poll(read(), 0.1)], lambda result: None)
            await asyncio.sleep(alive_for_s)
            station.alive = False
            result = await bus.transact(read_request())
            assert result.error is not None and result.sent_at is not None
            return bus.now() - result.sent_at

    async def main() -> None:
        durations = []
        for port_type in (ScriptedPort, PausablePort):
            station = FakeStation(delay_s=0.015)
            durations.append(await duration_s(port_type(wire_to(station, deliver=byte_by_byte)), station))
        assert durations[0] == pytest.approx(durations[1])

    run(main())


def test_a_hang_up_while_the_reader_is_paused_is_noticed_with_the_reply() -> None:
    async def main() -> None:
        port = PausablePort(wire_to(FakeStation(), deliver=byte_by_byte))
        async with paused_bus(port, 1) as bus:
            future = bus.submit(read_request())
            await asyncio.sleep(GAP_S + CHARACTER_S)
            assert port.paused
            port.hung_up = True
            result = await future
            assert isinstance(result.error, PortLost)

    run(main())


def test_only_a_reply_of_the_full_length_says_something_about_the_delay() -> None:
    """A drive rejects a request in fewer bytes, and often sooner, than it answers it."""
    station = make_core(1).stations[1]
    poll = PreparedPoll(Poll(read(), 1.0), None, station, SETTINGS, 0.0)
    for _ in range(2):
        transaction = Transaction(poll, 0.0, CHARACTER_S, has_line_timing=True, echo=None)
        transaction.on_data(CODEC.encode_reply(modbus.RegisterValues(1, 3, (1, 2, 3, 4))), 0.1)
        transaction.learn_delay()
    learned = poll.usual_delay.seconds
    assert transaction.earliest_useful_at() is None
    assert learned == pytest.approx(0.1 - (8 + 12) * CHARACTER_S)
    following = Transaction(poll, 1.0, CHARACTER_S, has_line_timing=True, echo=None)
    assert following.earliest_useful_at() == pytest.approx(1.1)
    following.on_data(CODEC.encode_reply(modbus.ExceptionReply(1, 3, 2)), 1.05)
    following.learn_delay()
    assert poll.usual_delay.seconds == learned


def test_the_requests_of_a_program_learn_the_delay_of_their_station_and_a_poll_has_its_own() -> None:
    """A program that awaits one read after the other was woken for each part of a reply."""
    station = make_core(1).stations[1]
    for _ in range(2):
        asked = PreparedRequest(read_request(count=4), None, station, SETTINGS)
        transaction = Transaction(asked, 0.0, CHARACTER_S, has_line_timing=True, echo=None)
        transaction.on_data(CODEC.encode_reply(modbus.RegisterValues(1, 3, (1, 2, 3, 4))), 0.1)
        transaction.learn_delay()
    following = PreparedRequest(read_request(count=2), None, station, SETTINGS)
    poll = PreparedPoll(Poll(read(), 1.0), None, station, SETTINGS, 0.0)
    shorter_s = 4 * CHARACTER_S
    for prepared, useful_at in (following, 1.1 - shorter_s), (poll, 1.0 + (8 + 12) * CHARACTER_S):
        transaction = Transaction(prepared, 1.0, CHARACTER_S, has_line_timing=True, echo=None)
        assert transaction.earliest_useful_at() == pytest.approx(useful_at)


# --- the usual delay -------------------------------------------------------------------------------------------------


def settle(usual: UsualDelay, delays: Iterable[float], read_late_s: float = 0.0) -> list[float | None]:
    """Add replies as a bus reads them: at the usual delay those that are complete by then, the others as they come.

    Return how late each was read, None where it was not complete at the usual delay.
    """
    late: list[float | None] = []
    for delay in delays:
        at_once = usual.seconds > 0 and delay <= usual.seconds + read_late_s
        late.append(usual.seconds + read_late_s - delay if at_once else None)
        usual.add(usual.seconds + read_late_s if at_once else delay, read_at_once=at_once)
    return late


def mean_lateness_s(late: list[float | None]) -> float:
    return sum(value or 0.0 for value in late) / len(late)


def test_a_first_reply_that_was_read_late_delays_no_other() -> None:
    """A program that starts reads its first replies up to 0.1 s late."""
    usual = UsualDelay()
    usual.add(0.1, read_at_once=False)
    assert usual.seconds == 0.0
    usual.add(0.004, read_at_once=False)
    assert usual.seconds == pytest.approx(0.004)


def test_half_of_the_replies_of_a_steady_drive_are_read_at_once() -> None:
    usual = UsualDelay()
    late = [value for value in settle(usual, [0.005] * 300) if value is not None]
    assert 100 < len(late) < 200
    assert max(late) < 3 * DELAY_STEP_S


def test_a_drive_that_becomes_faster_is_read_early_again_within_ten_replies() -> None:
    usual = UsualDelay()
    settle(usual, [0.05] * 20)
    settle(usual, [0.002] * 12)
    assert usual.seconds < 0.002 + MAX_SCATTER_S


def test_an_adapter_that_delivers_every_16_ms_is_not_read_at_its_mean() -> None:
    chance = Random(1)
    late = settle(UsualDelay(), [0.004 + chance.random() * 0.016 for _ in range(2000)])
    assert mean_lateness_s(late[100:]) < 0.0002


def test_a_delay_that_scatters_by_a_millisecond_costs_less_than_a_tenth_of_it() -> None:
    chance = Random(1)
    late = settle(UsualDelay(), [0.004 + chance.random() * 0.001 for _ in range(2000)])
    assert 0 < mean_lateness_s(late[100:]) < 0.0001


def test_replies_that_are_read_late_by_a_busy_program_do_not_raise_the_delay() -> None:
    usual = UsualDelay()
    settle(usual, [0.005] * 300, read_late_s=0.02)
    assert usual.seconds < 0.005 + 3 * DELAY_STEP_S


def test_the_delay_of_a_drive_that_replies_at_once_is_never_negative() -> None:
    usual = UsualDelay()
    usual.add(-0.001, read_at_once=True)
    usual.add(-0.001, read_at_once=True)
    assert usual.seconds == 0.0
    usual.add(0.0, read_at_once=True)
    assert usual.seconds == 0.0
