"""Attempts to move a motor without a permit, or to lose a stop."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import pytest

from drivebus.bus import Bus, Poll
from drivebus.bus.core import BusCore
from drivebus.bus.messages import RetryPolicy
from drivebus.bus.station import DUPLICATE_WINDOW_S
from drivebus.errors import NotPermitted, PortLost
from drivebus.protocols import modbus
from drivebus.testing.bus_script import BusScript, ScriptedPort
from drivebus.testing.virtual_time import run
from drivebus.types import Receiver
from fixtures.bus import (
    CHARACTER_S,
    COMMAND,
    SETTINGS,
    START,
    STOP,
    FakeStation,
    read,
    read_request,
    start_request,
    station_config,
    stop_request,
    write_request,
)


def wire_of(*stations: FakeStation) -> Any:
    def wire(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        for station in stations:
            reply = station.reply_to(frame, ended_at)
            if reply is not None:
                yield ended_at + station.delay_s + CHARACTER_S * len(reply), reply

    return wire


async def opened(*stations: FakeStation) -> tuple[Bus, ScriptedPort]:
    """Return an open bus whose stations have all replied once."""
    port = ScriptedPort(wire_of(*stations), SETTINGS)
    bus = Bus(port)
    await bus.open()
    for station in stations:
        bus.add_station(station_config(station.address))
        await bus.transact(read_request(station.address))
    return bus, port


def commands(station: FakeStation) -> list[int]:
    """Return the words written to the command register."""
    writes = [request for _, request in station.received_requests if isinstance(request, modbus.WriteRegister)]
    return [request.value for request in writes if request.register == COMMAND]


def test_no_callback_runs_between_a_permit_check_and_its_frame() -> None:
    """A sink may block or inhibit starts, but only after the frame whose permit was just checked has been sent."""

    async def main() -> None:
        station = FakeStation()
        bus, port = await opened(station)
        left: list[int] = []

        def sink(_: Any) -> None:
            left.append(len(port.sent))
            bus.inhibit_start(None)

        bus.start_polling(1, [Poll(read(), 10.0, 0.0)], sink)
        before = len(port.sent)
        await bus.transact(start_request(bus.core))
        assert left == [before + 1], "the start was held back until the sink had inhibited starts"
        result = await bus.transact(start_request(bus.core))
        assert isinstance(result.error, NotPermitted)
        await bus.close()

    run(main())


def test_a_stop_whose_caller_is_cancelled_is_still_sent() -> None:
    """No check drops a stop, and a timeout of ``wait_for(stop, …)`` must not cancel it."""

    async def main() -> None:
        station = FakeStation(delay_s=0.015)
        bus, _ = await opened(station)
        busy = asyncio.ensure_future(bus.transact(read_request()))
        await asyncio.sleep(0.001)
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(bus.transact(stop_request()), 0.005)
        await busy
        await asyncio.sleep(0.1)
        assert commands(station) == [STOP]
        await bus.close()

    run(main())


def test_a_stop_whose_caller_is_cancelled_is_still_repeated_without_a_reply() -> None:
    core = BusCore(SETTINGS, echo="off")
    core.registry.add(station_config())
    book = BusScript(core, lambda frame, at: [(at + 0.01, reply)] if (reply := station.reply_to(frame, at)) else [])
    station = FakeStation()
    book.submit(read_request(), "first")
    book.result("first")
    station.alive = False
    sent = len(book.sent)
    book.submit(stop_request(), "stop")
    book._perform(core.cancel("stop", book.now))
    book.run_until(book.now + 1.0)
    assert len([frame for _, frame in book.sent[sent:] if frame == book.sent[sent][1]]) == 3


def test_a_permit_does_not_outlive_a_stop_by_registering_the_station_again() -> None:
    async def main() -> None:
        station = FakeStation()
        bus, _ = await opened(station)
        old = start_request(bus.core)
        await bus.transact(stop_request())
        bus.remove_station(1)
        bus.add_station(station_config())
        result = await bus.transact(old)
        assert isinstance(result.error, NotPermitted) and station.start_count == 0
        await bus.close()

    run(main())


@pytest.mark.parametrize("all_of_them", [True, False])
def test_a_start_inhibit_outlives_registering_the_station_again(all_of_them: bool) -> None:
    async def main() -> None:
        station = FakeStation()
        bus, _ = await opened(station)
        bus.inhibit_start(None if all_of_them else [1])
        bus.remove_station(1)
        bus.add_station(station_config())
        assert bus.start_inhibited(1)
        if all_of_them:
            bus.add_station(station_config(2))
            assert bus.start_inhibited(2), "a drive that joins a stopped bus is stopped too"
        bus.release_start()
        assert not bus.start_inhibited(1)
        bus.remove_station(1)
        bus.add_station(station_config())
        assert not bus.start_inhibited(1)
        await bus.close()

    run(main())


def mute_for_writes(station: FakeStation) -> Any:
    """Return a wire whose station executes every request and replies to reads and loop-backs only."""
    inner = wire_of(station)
    return lambda frame, ended_at: [reply for reply in inner(frame, ended_at) if frame[1] != 6]


def test_a_start_is_never_repeated_even_if_its_permit_calls_it_idempotent() -> None:
    """A motion frame is sent once, whatever retry policy its permit has."""
    station = FakeStation()
    core = BusCore(SETTINGS, echo="off")
    core.registry.add(station_config())
    script = BusScript(core, mute_for_writes(station))
    script.submit(read_request(), "read")
    script.result("read")
    script.submit(write_request(core, 1, COMMAND, START, retry_policy=RetryPolicy.IDEMPOTENT), "start")
    assert script.result("start").attempts == 1
    script.run_until(script.now + 5.0)
    assert commands(station) == [START]


@pytest.mark.parametrize(("late_s", "leaves"), [(0.0, True), (0.001, False)])
def test_a_permit_expires_at_its_time_whatever_the_request_contains(late_s: float, leaves: bool) -> None:
    """The expiry of the permit applies although the request has none."""
    station = FakeStation()
    core = BusCore(SETTINGS, echo="off")
    core.registry.add(station_config())
    script = BusScript(core, wire_of(station))
    script.submit(read_request(), "read")
    script.result("read")
    script.run_until(script.now + 1.0)
    script.submit(replace(start_request(core, until=script.now - late_s), expires_at=None), "start")
    assert (script.result("start").error is None) is leaves
    assert (station.start_count == 1) is leaves


def test_a_permit_that_expires_while_its_frame_waits_is_invalid() -> None:
    station = FakeStation()
    core = BusCore(SETTINGS, echo="off")
    core.registry.add(station_config())
    script = BusScript(core, wire_of(station))
    script.submit(read_request(), "read")
    script.result("read")
    station.alive = False
    script.submit(read_request(), "busy")
    script.submit(replace(start_request(core, until=script.now + 0.03), expires_at=None), "start")
    error = script.result("start").error
    assert isinstance(error, NotPermitted) and error.key == "bus.permit_expired"
    assert station.start_count == 0


def test_a_stop_never_expires_even_with_an_expiry_set() -> None:
    station = FakeStation()
    core = BusCore(SETTINGS, echo="off")
    core.registry.add(station_config())
    script = BusScript(core, wire_of(station), start=10.0)
    script.submit(replace(stop_request(), expires_at=1.0), "stop")
    assert script.result("stop").sent
    assert commands(station) == [STOP]


def test_a_suspect_station_gets_its_sync_probe_during_a_parameter_backup_of_another() -> None:
    """After four parameters in a row other requests have their turn; otherwise its values would be stale meanwhile."""

    async def main() -> None:
        first, second = FakeStation(address=1), FakeStation(address=2)
        bus, _ = await opened(first, second)
        good: list[float] = []
        bus.start_polling(
            2, [Poll(read(2), 0.5)], lambda result: good.append(bus.now()) if result.error is None else None
        )

        async def backup() -> None:
            while bus.now() < 20.0:
                await bus.transact(read_request(1))

        async def blink() -> None:
            await asyncio.sleep(5.0)
            second.alive = False
            await asyncio.sleep(0.6)
            second.alive = True

        await asyncio.gather(blink(), *(backup() for _ in range(3)))
        assert [at for at in good if at > 9.0], "it is polled again"
        await bus.close()

    run(main())


class FailingReopenPort(ScriptedPort):
    """Port that fails twice with an unexpected error when it is opened again."""

    failures = 0

    async def open(self, receiver: Receiver) -> None:
        if self.openings and self.failures < 2:
            self.failures += 1
            raise OSError(5, "half enumerated")
        await super().open(receiver)


def test_a_port_that_fails_with_an_unknown_error_is_opened_again() -> None:
    async def main() -> None:
        reports: list[Any] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, context: reports.append(context))
        station = FakeStation()
        port = FailingReopenPort(wire_of(station), SETTINGS)
        bus = Bus(port)
        await bus.open()
        bus.add_station(station_config())
        port.unplug()
        port.plugged = True
        await asyncio.sleep(2.0)
        assert bus.is_open and port.failures == 2
        assert len(reports) == 2, "reported to the exception handler of the loop"
        await bus.close()

    run(main())


class FailingWritePort(ScriptedPort):
    """Port whose write fails once with an unexpected error."""

    stumbled = False

    def write(self, data: bytes, /) -> None:
        if not self.stumbled and data[1] == 3 and self.sent:
            self.stumbled = True
            raise ValueError("a driver's own error")
        super().write(data)

    async def open(self, receiver: Receiver) -> None:
        assert self._receiver is None, "as every port: not twice without close"
        await super().open(receiver)


def test_a_write_that_fails_with_an_unknown_error_loses_the_port_and_not_the_bus() -> None:
    async def main() -> None:
        reports: list[Any] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, context: reports.append(context))
        station = FakeStation()
        port = FailingWritePort(wire_of(station), SETTINGS)
        bus = Bus(port)
        await bus.open()
        bus.add_station(station_config())
        await bus.transact(read_request())
        assert isinstance((await bus.transact(read_request())).error, PortLost)
        assert len(reports) == 1
        await bus.transact(stop_request())
        await asyncio.sleep(1.0)
        assert bus.is_open
        await bus.transact(stop_request())
        assert commands(station)[-1:] == [STOP]
        await bus.close()

    run(main())


def test_after_a_replug_every_station_must_answer_a_sync_probe_before_its_data_count() -> None:
    """A serial server may still have the reply to an earlier request."""
    station = FakeStation()
    core = BusCore(SETTINGS, echo="off")
    core.registry.add(station_config())
    script = BusScript(core, wire_of(station))
    script.submit(read_request(), "read")
    script.result("read")
    script.lose_port(PortLost("ports.lost", port="x", reason="unplugged"))
    script.reopen()
    assert core.stations[1].state.is_suspect
    lost_at, before = script.now, len(script.sent)
    script.submit(read_request(), "again")
    assert script.result("again").error is None
    assert [frame[1] for frame in script.frames[before:]] == [8, 3]
    assert script.sent[before][0] >= lost_at + core.stations[1].config.timing.max_reply_lateness_s


def test_a_command_in_the_gap_after_a_reply_does_not_shorten_the_gap() -> None:
    """A reply is accepted after the complete gap; a byte within the gap invalidates it."""
    station = FakeStation(registers={0x3000: 7})
    core = BusCore(SETTINGS, echo="off")
    core.registry.add(station_config())
    script = BusScript(core, wire_of(station))
    script.submit(read_request(), "first")
    script.result("first")
    script.submit(read_request(count=1), "read")
    script.run_until(script.now + 0.01)
    reply = modbus.ModbusRtuCodec().encode_reply(modbus.RegisterValues(1, 3, (7,)))
    sent_at = script.sent[-1][0]
    whole_at = sent_at + CHARACTER_S * 8 + station.delay_s + CHARACTER_S * len(reply)
    gap_s = core.stations[1].gap_s
    script.receive(b"\x55", at=whole_at + gap_s - 0.0002)
    script.run_until(whole_at + gap_s - 0.0004)
    script.submit(read_request(), "command")
    assert (script.result("read").error, script.result("read").attempts) == (None, 2), "retried, not accepted"


def test_a_batch_that_ends_where_a_short_error_would_end_is_no_error() -> None:
    """DF800 sends error replies of five bytes, and an adapter may deliver an eight-byte echo in two batches."""
    codec = modbus.ModbusRtuCodec(error_form="short")
    error_reply = codec.encode_reply(modbus.ExceptionReply(1, 6, None))
    register, value = error_reply[3], error_reply[4] << 8
    assert len(error_reply) == 5
    core = BusCore(SETTINGS, echo="off")
    core.registry.add(station_config(codec=codec))
    script = BusScript(core, wire_of(FakeStation()))
    script.submit(read_request(), "read")
    script.result("read")
    script.wire = lambda frame, ended_at: [(ended_at + 0.010, frame[:5]), (ended_at + 0.026, frame[5:])]
    ask = write_request(core, 1, register, value, retry_policy=RetryPolicy.EEPROM)
    script.submit(ask, "write")
    result = script.result("write")
    assert result.sent[:5] == error_reply, "the reply begins like an error reply"
    assert result.error is None and isinstance(result.reply, modbus.WriteAck)


def make_online_script(*stations: FakeStation, **options: Any) -> BusScript:
    """Return a script whose stations have all replied once."""
    core = BusCore(SETTINGS, **({"echo": "off"} | options))
    script = BusScript(core, wire_of(*stations))
    for station in stations:
        core.registry.add(station_config(station.address))
        script.submit(read_request(station.address), station.address)
        script.result(station.address)
    return script


def damaged_reply(count: int) -> bytes:
    """Return a reply to a read of one register with a wrong checksum and ``count`` bytes too many."""
    whole = modbus.ModbusRtuCodec().encode_reply(modbus.RegisterValues(1, 3, (7,)))
    return whole[:-1] + bytes([whole[-1] ^ 1]) + bytes(count)


@pytest.mark.parametrize(("more", "suspect"), [(0, False), (1, True)])
def test_only_exactly_the_bytes_of_a_reply_are_a_damaged_reply(more: int, suspect: bool) -> None:
    """Longer bytes may be noise, and the reply may still come."""
    script = make_online_script(FakeStation())
    script.wire = lambda frame, ended_at: [(ended_at + 0.01, damaged_reply(more))] if frame[1] == 3 else []
    script.submit(read_request(count=1), "read")
    script.run_until(script.now + 0.03)
    assert script.core.stations[1].state.is_suspect is suspect


def test_garbage_may_be_the_late_reply_of_another_suspect_station() -> None:
    """While the reply of another station is overdue, damaged bytes may be that reply."""
    first, second = FakeStation(address=1), FakeStation(address=2)
    script = make_online_script(first, second)
    second.alive = False
    script.submit(read_request(2), "lost")
    script.run_until(script.now + 0.1)
    assert script.core.stations[2].state.is_suspect
    script.wire = lambda frame, ended_at: [(ended_at + 0.01, damaged_reply(0))] if frame[:2] == b"\x01\x03" else []
    script.submit(read_request(1, count=1), "read")
    script.run_until(script.now + 0.04)
    assert script.core.stations[1].state.is_suspect


@pytest.mark.parametrize(("second_replies", "suspect"), [([], False), ([0.0], True)])
def test_after_the_sync_probe_of_the_suspect_station_a_damaged_reply_is_that_of_its_own_request(
    second_replies: list[float], suspect: bool
) -> None:
    """A station replies in order, so nothing of it is late any more; of two drives at one address only one did."""
    first, second = FakeStation(address=1), FakeStation(address=2)
    script = make_online_script(first, second)
    second.alive = False
    script.submit(read_request(2), "lost")
    script.run_until(script.now + 0.1)
    second.alive = True
    script.core.stations[2].duplicate_reply_times[:] = second_replies
    assert script.result("lost").error is None and not script.core.stations[2].state.is_suspect
    script.wire = lambda frame, ended_at: [(ended_at + 0.01, damaged_reply(0))] if frame[:2] == b"\x01\x03" else []
    script.submit(read_request(1, count=1), "read")
    script.run_until(script.now + 0.03)
    assert script.core.stations[1].state.is_suspect is suspect


def test_a_damaged_reply_to_a_sync_probe_is_no_reply_and_the_quarantine_begins_again() -> None:
    station = FakeStation()
    script = make_online_script(station)
    station.alive = False
    script.submit(read_request(), "lost")
    script.run_until(script.now + 0.2)
    good = modbus.ModbusRtuCodec().encode_reply(modbus.DiagnosticsReply(1, 0xA500))
    script.wire = lambda frame, ended_at: [(ended_at + 0.01, frame[:-1] + bytes([frame[-1] ^ 1]))]
    while script.frames[-1][1] != 8:
        script.run_until(script.now + 0.01)
    fenced_at = script.sent[-1][0]
    script.run_until(fenced_at + 8 * CHARACTER_S + 0.02 + len(good) * CHARACTER_S)
    state = script.core.stations[1]
    assert state.state.is_suspect and state.quarantined_until >= fenced_at + state.config.timing.max_reply_lateness_s


def test_after_a_replug_a_mirrored_reply_is_not_accepted_although_the_old_adapter_had_no_echo() -> None:
    station = FakeStation()
    script = make_online_script(station)
    assert script.core.echo.ruled_out
    script.lose_port(PortLost("ports.lost", port="x", reason="unplugged"))
    script.reopen()
    script.submit(write_request(script.core, retry_policy=RetryPolicy.EEPROM), "write")
    assert script.result("write").error is not None
    script.submit(read_request(), "read")
    script.result("read")
    script.submit(write_request(script.core, retry_policy=RetryPolicy.EEPROM), "again")
    assert script.result("again").error is None


def test_a_reply_behind_early_bytes_does_not_show_that_there_is_no_echo() -> None:
    """On a port with line timing the echo is early and dropped, so the rest does not rule an echo out."""
    station = FakeStation()
    core = BusCore(SETTINGS, echo="off", has_line_timing=True)
    core.registry.add(station_config())
    inner = wire_of(station)

    def echoing(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        yield from ((ended_at - CHARACTER_S * (len(frame) - 1 - i), frame[i : i + 1]) for i in range(len(frame)))
        yield from inner(frame, ended_at)

    script = BusScript(core, echoing)
    script.submit(read_request(), "read")
    assert script.result("read").error is None
    assert not core.echo.ruled_out


def test_two_second_replies_inhibit_starts_for_a_limited_time() -> None:
    async def main() -> None:
        station = FakeStation()
        bus, port = await opened(station)
        for _ in range(2):
            await bus.transact(read_request())
            await asyncio.sleep(0.05)
            port._deliver(buskit_reply(), port.openings)
            await asyncio.sleep(1.0)
            await bus.transact(read_request())
        assert bus.health(1).duplicate_address
        await asyncio.sleep(DUPLICATE_WINDOW_S + 1.0)
        assert not bus.health(1).duplicate_address
        await bus.close()

    run(main())


def test_two_second_replies_far_apart_are_no_duplicate_address() -> None:
    async def main() -> None:
        station = FakeStation()
        bus, port = await opened(station)
        for _ in range(3):
            await bus.transact(read_request())
            await asyncio.sleep(0.05)
            port._deliver(buskit_reply(), port.openings)
            await asyncio.sleep(DUPLICATE_WINDOW_S + 1.0)
            await bus.transact(read_request())
            assert not bus.health(1).duplicate_address
        await bus.close()

    run(main())


def buskit_reply() -> bytes:
    return modbus.ModbusRtuCodec().encode_reply(modbus.RegisterValues(1, 3, (1, 2, 3, 4)))


def test_cancelled_polls_use_no_memory() -> None:
    async def main() -> None:
        bus, _ = await opened(FakeStation())
        for _ in range(50):
            bus.start_polling(1, [Poll(read(), 3600.0)], lambda result: None).cancel()
        assert len(bus.core.scheduler.poll_schedule.heap) == 0
        await bus.close()

    run(main())
