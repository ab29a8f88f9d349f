"""What somebody tried who wanted a motor to move, or a stop to be lost, when it must not."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import pytest

from buskit import COMMAND, LINE, START, STOP, C, Station, ask_read, ask_start, ask_stop, ask_write, link, read
from drivebus.bus import Bus, Poll
from drivebus.bus.core import BusCore
from drivebus.bus.stations import DUPLICATE_MEMORY_S
from drivebus.errors import NotPermitted, PortLost
from drivebus.message import WriteClass
from drivebus.ports.port import Receiver
from drivebus.protocols import modbus
from drivebus.testing.playbook import Playbook, ScriptedPort
from drivebus.testing.virtual import run


def wire_of(*stations: Station) -> Any:
    def wire(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        for station in stations:
            answer = station.answer(frame, ended_at)
            if answer is not None:
                yield ended_at + station.delay_s + C * len(answer), answer

    return wire


async def opened(*stations: Station) -> tuple[Bus, ScriptedPort]:
    """A bus whose stations have all answered once."""
    port = ScriptedPort(wire_of(*stations), LINE)
    bus = Bus(port)
    await bus.open()
    for station in stations:
        bus.add(link(station.address))
        await bus.transact(ask_read(station.address))
    return bus, port


def commands(station: Station) -> list[int]:
    """What was written to the command register."""
    writes = [request for _, request in station.heard if isinstance(request, modbus.WriteRegister)]
    return [request.value for request in writes if request.register == COMMAND]


def test_no_sink_comes_between_a_permit_that_was_checked_and_its_frame() -> None:
    """A sink may block, or latch: by then the frame whose permit was checked at this moment has left (I1)."""

    async def told() -> None:
        station = Station()
        bus, port = await opened(station)
        left: list[int] = []

        def sink(_: Any) -> None:
            left.append(len(port.sent))
            bus.latch(None)

        bus.watch(1, [Poll(read(), 10.0, 0.0)], sink)
        before = len(port.sent)
        await bus.transact(ask_start(bus.core))
        assert left == [before + 1], "the start was held back until the sink had latched the bus"
        answer = await bus.transact(ask_start(bus.core))
        assert isinstance(answer.error, NotPermitted)
        await bus.close()

    run(told())


def test_a_stop_whose_asker_gave_up_waiting_is_sent_all_the_same() -> None:
    """Ruling 5: dropped by nothing; ``wait_for(stop, …)`` must not take it back."""

    async def told() -> None:
        station = Station(delay_s=0.015)
        bus, _ = await opened(station)
        busy = asyncio.ensure_future(bus.transact(ask_read()))
        await asyncio.sleep(0.001)
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(bus.transact(ask_stop()), 0.005)
        await busy
        await asyncio.sleep(0.1)
        assert commands(station) == [STOP]
        await bus.close()

    run(told())


def test_a_stop_whose_asker_gave_up_is_still_sent_again_when_nobody_answers() -> None:
    core = BusCore(LINE, echo="off")
    core.add(link())
    book = Playbook(core, lambda frame, at: [(at + 0.01, answer)] if (answer := station.answer(frame, at)) else [])
    station = Station()
    book.ask(ask_read(), "first")
    book.answer("first")
    station.alive = False
    sent = len(book.sent)
    book.ask(ask_stop(), "stop")
    book._perform(core.cancel("stop", book.now))
    book.until(book.now + 1.0)
    assert len([frame for _, frame in book.sent[sent:] if frame == book.sent[sent][1]]) == 3


def test_a_permit_does_not_outlive_a_stop_by_registering_the_station_anew() -> None:
    async def told() -> None:
        station = Station()
        bus, _ = await opened(station)
        old = ask_start(bus.core)
        await bus.transact(ask_stop())
        bus.remove(1)
        bus.add(link())
        answer = await bus.transact(old)
        assert isinstance(answer.error, NotPermitted) and station.started == 0
        await bus.close()

    run(told())


@pytest.mark.parametrize("all_of_them", [True, False])
def test_a_latch_outlives_registering_the_station_anew(all_of_them: bool) -> None:
    async def told() -> None:
        station = Station()
        bus, _ = await opened(station)
        bus.latch(None if all_of_them else [1])
        bus.remove(1)
        bus.add(link())
        assert bus.latched(1)
        if all_of_them:
            bus.add(link(2))
            assert bus.latched(2), "a drive that joins a stopped bus is stopped too"
        bus.release()
        assert not bus.latched(1)
        bus.remove(1)
        bus.add(link())
        assert not bus.latched(1)
        await bus.close()

    run(told())


def mute_for_writes(station: Station) -> Any:
    """It hears everything and answers reads and loop-backs only."""
    inner = wire_of(station)
    return lambda frame, ended_at: [reply for reply in inner(frame, ended_at) if frame[1] != 6]


def test_nobody_can_have_a_start_repeated_by_calling_it_absolute() -> None:
    """F16: whatever class a permit names, a frame that moves goes once."""
    station = Station()
    core = BusCore(LINE, echo="off")
    core.add(link())
    play = Playbook(core, mute_for_writes(station))
    play.ask(ask_read(), "read")
    play.answer("read")
    play.ask(ask_write(core, 1, COMMAND, START, write_class=WriteClass.ABSOLUTE), "start")
    assert play.answer("start").attempts == 1
    play.until(play.now + 5.0)
    assert commands(station) == [START]


@pytest.mark.parametrize(("late_s", "leaves"), [(0.0, True), (0.001, False)])
def test_a_permit_ends_at_its_second_whatever_the_ask_says_of_itself(late_s: float, leaves: bool) -> None:
    """Ruling 12, with an ask that names no expiry of its own."""
    station = Station()
    core = BusCore(LINE, echo="off")
    core.add(link())
    play = Playbook(core, wire_of(station))
    play.ask(ask_read(), "read")
    play.answer("read")
    play.until(play.now + 1.0)
    play.ask(replace(ask_start(core, until=play.now - late_s), expires_at=None), "start")
    assert (play.answer("start").error is None) is leaves
    assert (station.started == 1) is leaves


def test_a_permit_that_ends_while_its_frame_waits_is_worth_nothing() -> None:
    station = Station()
    core = BusCore(LINE, echo="off")
    core.add(link())
    play = Playbook(core, wire_of(station))
    play.ask(ask_read(), "read")
    play.answer("read")
    station.alive = False
    play.ask(ask_read(), "busy")
    play.ask(replace(ask_start(core, until=play.now + 0.03), expires_at=None), "start")
    error = play.answer("start").error
    assert isinstance(error, NotPermitted) and error.key == "bus.permit_expired"
    assert station.started == 0


def test_ruling_5_a_stop_has_no_expiry_even_where_it_was_given_one() -> None:
    station = Station()
    core = BusCore(LINE, echo="off")
    core.add(link())
    play = Playbook(core, wire_of(station), start=10.0)
    play.ask(replace(ask_stop(), expires_at=1.0), "stop")
    assert play.answer("stop").sent
    assert commands(station) == [STOP]


def test_a_suspect_station_is_asked_for_its_fence_during_a_backup_of_another() -> None:
    """Four parameters in a row, then whoever else is waiting: else its values would be stale for as long (I4)."""

    async def told() -> None:
        one, two = Station(1), Station(2)
        bus, _ = await opened(one, two)
        good: list[float] = []
        bus.watch(2, [Poll(read(2), 0.5)], lambda answer: good.append(bus.now()) if answer.error is None else None)

        async def backup() -> None:
            while bus.now() < 20.0:
                await bus.transact(ask_read(1))

        async def blink() -> None:
            await asyncio.sleep(5.0)
            two.alive = False
            await asyncio.sleep(0.6)
            two.alive = True

        await asyncio.gather(blink(), *(backup() for _ in range(3)))
        assert [at for at in good if at > 9.0], "nothing was heard of it again"
        await bus.close()

    run(told())


class Halting(ScriptedPort):
    """Fails in a way that no port should, twice, when it is opened again."""

    failures = 0

    async def open(self, receiver: Receiver) -> None:
        if self.openings and self.failures < 2:
            self.failures += 1
            raise OSError(5, "half enumerated")
        await super().open(receiver)


def test_a_port_that_fails_in_an_unknown_way_is_opened_again_all_the_same() -> None:
    async def told() -> None:
        complaints: list[Any] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, context: complaints.append(context))
        station = Station()
        port = Halting(wire_of(station), LINE)
        bus = Bus(port)
        await bus.open()
        bus.add(link())
        port.unplug()
        port.plugged = True
        await asyncio.sleep(2.0)
        assert bus.is_open and port.failures == 2
        assert len(complaints) == 2, "and the loop's handler is told"
        await bus.close()

    run(told())


class Stumbling(ScriptedPort):
    """Its write fails once, in a way that no port should."""

    stumbled = False

    def write(self, data: bytes, /) -> None:
        if not self.stumbled and data[1] == 3 and self.sent:
            self.stumbled = True
            raise ValueError("a driver's own error")
        super().write(data)

    async def open(self, receiver: Receiver) -> None:
        assert self._receiver is None, "as every port: not twice without close"
        await super().open(receiver)


def test_a_write_that_fails_in_an_unknown_way_loses_the_port_and_not_the_bus() -> None:
    async def told() -> None:
        complaints: list[Any] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, context: complaints.append(context))
        station = Station()
        port = Stumbling(wire_of(station), LINE)
        bus = Bus(port)
        await bus.open()
        bus.add(link())
        await bus.transact(ask_read())
        assert isinstance((await bus.transact(ask_read())).error, PortLost)
        assert len(complaints) == 1
        await bus.transact(ask_stop())
        await asyncio.sleep(1.0)
        assert bus.is_open
        await bus.transact(ask_stop())
        assert commands(station)[-1:] == [STOP]
        await bus.close()

    run(told())


def test_after_a_replug_every_station_owes_a_fence_before_its_data_count() -> None:
    """A serial server may still hold the answer to what was asked before (5.3)."""
    station = Station()
    core = BusCore(LINE, echo="off")
    core.add(link())
    play = Playbook(core, wire_of(station))
    play.ask(ask_read(), "read")
    play.answer("read")
    play.lose(PortLost("ports.lost", port="x", reason="unplugged"))
    play.reopen()
    assert core.stations[1].suspect
    lost_at, before = play.now, len(play.sent)
    play.ask(ask_read(), "again")
    assert play.answer("again").error is None
    assert [frame[1] for frame in play.frames[before:]] == [8, 3]
    assert play.sent[before][0] >= lost_at + core.stations[1].link.timing.lateness_s


def test_a_wish_in_the_gap_after_a_reply_does_not_cut_the_gap_short() -> None:
    """A reply counts after the whole gap: a byte that comes within it voids it (T15, F05)."""
    station = Station(registers={0x3000: 7})
    core = BusCore(LINE, echo="off")
    core.add(link())
    play = Playbook(core, wire_of(station))
    play.ask(ask_read(), "first")
    play.answer("first")
    play.ask(ask_read(count=1), "read")
    play.until(play.now + 0.01)
    reply = modbus.RtuCodec().encode_reply(modbus.Registers(1, 3, (7,)))
    sent_at = play.sent[-1][0]
    whole_at = sent_at + C * 8 + station.delay_s + C * len(reply)
    gap_s = core.stations[1].gap_s
    play.hear(b"\x55", at=whole_at + gap_s - 0.0002)
    play.until(whole_at + gap_s - 0.0004)
    play.ask(ask_read(), "wish")
    assert (play.answer("read").error, play.answer("read").attempts) == (None, 2), "asked again, not believed"


def test_ruling_11_a_batch_that_ends_where_a_short_error_would_end_is_no_error() -> None:
    """DF800 refuses with five bytes, and an adapter may hand an eight-byte echo over in two batches (F04)."""
    codec = modbus.RtuCodec(error_form="short")
    refusal = codec.encode_reply(modbus.ErrorReply(1, 6, None))
    register, value = refusal[3], refusal[4] << 8
    assert len(refusal) == 5
    core = BusCore(LINE, echo="off")
    core.add(link(codec=codec))
    play = Playbook(core, wire_of(Station()))
    play.ask(ask_read(), "read")
    play.answer("read")
    play.wire = lambda frame, ended_at: [(ended_at + 0.010, frame[:5]), (ended_at + 0.026, frame[5:])]
    ask = ask_write(core, 1, register, value, write_class=WriteClass.EEPROM)
    play.ask(ask, "write")
    answer = play.answer("write")
    assert answer.sent[:5] == refusal, "the case that this is about"
    assert answer.error is None and isinstance(answer.reply, modbus.Written)


def playing(*stations: Station, **options: Any) -> Playbook:
    """A core whose stations have all answered once."""
    core = BusCore(LINE, **({"echo": "off"} | options))
    play = Playbook(core, wire_of(*stations))
    for station in stations:
        core.add(link(station.address))
        play.ask(ask_read(station.address), station.address)
        play.answer(station.address)
    return play


def spoiled(count: int) -> bytes:
    """A reply to a read of one register whose check fails, and so many bytes too many."""
    whole = modbus.RtuCodec().encode_reply(modbus.Registers(1, 3, (7,)))
    return whole[:-1] + bytes([whole[-1] ^ 1]) + bytes(count)


@pytest.mark.parametrize(("more", "suspect"), [(0, False), (1, True)])
def test_f05_only_exactly_an_answers_worth_of_bytes_is_a_spoiled_answer(more: int, suspect: bool) -> None:
    """Anything longer may be noise, and the answer may still come."""
    play = playing(Station())
    play.wire = lambda frame, ended_at: [(ended_at + 0.01, spoiled(more))] if frame[1] == 3 else []
    play.ask(ask_read(count=1), "read")
    play.until(play.now + 0.03)
    assert play.core.stations[1].suspect is suspect


def test_f01_garbage_may_be_a_late_answer_of_somebody_else_who_owes_one() -> None:
    """While another station is overdue a spoiled answer proves nothing of this one."""
    one, two = Station(1), Station(2)
    play = playing(one, two)
    two.alive = False
    play.ask(ask_read(2), "lost")
    play.until(play.now + 0.1)
    assert play.core.stations[2].suspect
    play.wire = lambda frame, ended_at: [(ended_at + 0.01, spoiled(0))] if frame[:2] == b"\x01\x03" else []
    play.ask(ask_read(1, count=1), "read")
    play.until(play.now + 0.04)
    assert play.core.stations[1].suspect


def test_a_spoiled_answer_to_a_fence_is_no_answer_and_the_quarantine_begins_anew() -> None:
    station = Station()
    play = playing(station)
    station.alive = False
    play.ask(ask_read(), "lost")
    play.until(play.now + 0.2)
    good = modbus.RtuCodec().encode_reply(modbus.Looped(1, 0xA500))
    play.wire = lambda frame, ended_at: [(ended_at + 0.01, frame[:-1] + bytes([frame[-1] ^ 1]))]
    while play.frames[-1][1] != 8:
        play.until(play.now + 0.01)
    fenced_at = play.sent[-1][0]
    play.until(fenced_at + 8 * C + 0.02 + len(good) * C)
    state = play.core.stations[1]
    assert state.suspect and state.quarantined_until >= fenced_at + state.link.timing.lateness_s


def test_g19_after_a_replug_a_mirrored_reply_is_not_believed_although_the_old_adapter_had_no_echo() -> None:
    station = Station()
    play = playing(station)
    assert play.core.echo.proved
    play.lose(PortLost("ports.lost", port="x", reason="unplugged"))
    play.reopen()
    play.ask(ask_write(play.core, write_class=WriteClass.EEPROM), "write")
    assert play.answer("write").error is not None
    play.ask(ask_read(), "read")
    play.answer("read")
    play.ask(ask_write(play.core, write_class=WriteClass.EEPROM), "again")
    assert play.answer("again").error is None


def test_g19_a_reply_behind_early_bytes_does_not_show_that_there_is_no_echo() -> None:
    """On a paced port the echo comes early and is dropped: what is left says nothing of the adapter."""
    station = Station()
    core = BusCore(LINE, echo="off", paced=True)
    core.add(link())
    inner = wire_of(station)

    def echoing(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        yield from ((ended_at - C * (len(frame) - 1 - i), frame[i : i + 1]) for i in range(len(frame)))
        yield from inner(frame, ended_at)

    play = Playbook(core, echoing)
    play.ask(ask_read(), "read")
    assert play.answer("read").error is None
    assert not core.echo.proved


def test_f15_two_second_answers_block_for_a_while_and_not_for_ever() -> None:
    async def told() -> None:
        station = Station()
        bus, port = await opened(station)
        for _ in range(2):
            await bus.transact(ask_read())
            await asyncio.sleep(0.05)
            port._arrive(buskit_reply(), port.openings)
            await asyncio.sleep(1.0)
            await bus.transact(ask_read())
        assert bus.health(1).duplicate
        await asyncio.sleep(DUPLICATE_MEMORY_S + 1.0)
        assert not bus.health(1).duplicate
        await bus.close()

    run(told())


def test_f15_two_second_answers_far_apart_are_no_duplicate_address() -> None:
    async def told() -> None:
        station = Station()
        bus, port = await opened(station)
        for _ in range(3):
            await bus.transact(ask_read())
            await asyncio.sleep(0.05)
            port._arrive(buskit_reply(), port.openings)
            await asyncio.sleep(DUPLICATE_MEMORY_S + 1.0)
            await bus.transact(ask_read())
            assert not bus.health(1).duplicate
        await bus.close()

    run(told())


def buskit_reply() -> bytes:
    return modbus.RtuCodec().encode_reply(modbus.Registers(1, 3, (1, 2, 3, 4)))


def test_i12_polls_that_were_cancelled_leave_nothing_behind() -> None:
    async def told() -> None:
        bus, _ = await opened(Station())
        for _ in range(50):
            bus.watch(1, [Poll(read(), 3600.0)], lambda answer: None).cancel()
        assert len(bus.core.scheduler.plan) == 0
        await bus.close()

    run(told())
