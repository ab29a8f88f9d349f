"""No frame that may act leaves without a valid permit, whoever asks and however (I1, F16, idea 5)."""

from __future__ import annotations

from dataclasses import replace

import pytest

from buskit import COMMAND, START, Station, ask_read, ask_start, ask_write, book, core, link, wire
from drivebus.errors import ConfigurationError, Expired, LineFault, NoReply, NotPermitted
from drivebus.message import Ask, Effect, Lane, Permit, WriteClass
from drivebus.protocols import modbus
from drivebus.testing.playbook import Playbook


def permit(**changes: object) -> Permit:
    return replace(Permit(1, Effect.MOTION, WriteClass.EDGE, 100.0, 0), **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("given", "key"),
    [
        (None, "bus.no_permit"),
        (permit(station=2), "bus.other_permit"),
        (permit(effect=Effect.SETTING), "bus.other_permit"),
        (permit(expires_at=-1.0), "bus.permit_expired"),
        (permit(generation=5), "bus.permit_stopped"),
    ],
)
def test_a_start_without_its_own_valid_permit_never_leaves(given: Permit | None, key: str) -> None:
    station = Station()
    play = book(station)
    play.ask(Ask(1, modbus.WriteRegister(1, COMMAND, START), Lane.COMMAND, WriteClass.EDGE, given))
    answer = play.answer()
    assert isinstance(answer.error, NotPermitted) and answer.error.key == key
    assert play.sent == [] and station.started == 0


def test_a_read_label_on_a_start_does_not_help() -> None:
    """The effect comes from the bytes, not from what the ask says of itself."""
    play = book(Station())
    play.ask(Ask(1, modbus.WriteRegister(1, COMMAND, START), Lane.POLL, WriteClass.READ))
    assert isinstance(play.answer().error, NotPermitted)


def test_a_request_for_another_station_than_was_named_never_leaves() -> None:
    """A permit for drive 1 can't start drive 2."""
    play = book(Station(1), Station(2))
    play.ask(Ask(1, modbus.WriteRegister(2, COMMAND, START), Lane.COMMAND, WriteClass.EDGE, permit()))
    error = play.answer().error
    assert isinstance(error, NotPermitted) and error.key == "bus.other_station"


def test_nobody_may_be_asked_who_is_not_registered() -> None:
    play = book(Station(1))
    play.ask(ask_read(9))
    error = play.answer().error
    assert isinstance(error, NotPermitted) and error.key == "bus.unregistered"
    assert play.sent == []


def test_expiry_is_checked_when_the_first_bit_goes_out() -> None:
    """Ruling 12: valid when it was asked, too old when its turn came."""
    station = Station()
    play = book(station)
    play.ask(ask_read(), "read")
    play.answer("read")
    station.alive = False
    play.ask(ask_read(), "busy")
    play.ask(ask_start(play.core, until=play.now + 0.03), "start")
    answer = play.answer("start")
    assert isinstance(answer.error, Expired) and answer.sent == b""
    assert station.started == 0


def test_a_repetition_that_expires_does_not_hide_that_the_frame_was_sent() -> None:
    """6.5: an absolute write that was not answered waits to be sent again; it has left although that never comes."""
    station = Station()
    play = book(station)
    play.ask(ask_read(), "read")
    play.answer("read")
    station.alive = False
    play.ask(ask_write(play.core, until=play.now + 0.1), "write")
    play.until(play.now + 5)
    answer = play.answer("write")
    assert isinstance(answer.error, Expired)
    assert (answer.sent, answer.sent_at, answer.attempts) == (play.sent[1][1], play.sent[1][0], 1)


def test_a_start_that_waits_behind_a_quarantine_expires_in_time() -> None:
    """Nobody waits longer than the command lives, and nothing is sent afterwards."""
    station = Station()
    play = book(station)
    play.ask(ask_read(), "read")
    play.answer("read")
    station.alive = False
    play.ask(ask_write(play.core, write_class=WriteClass.EDGE), "lost")
    play.answer("lost")
    asked = play.now
    play.ask(ask_start(play.core, until=asked + 0.1), "start")
    assert isinstance(play.answer("start").error, Expired)
    assert play.now - asked < 0.15
    station.alive = True
    play.until(play.now + 5)
    assert station.started == 0


def test_while_latched_nothing_moves_and_settings_pass() -> None:
    station = Station()
    play = book(station)
    play.core.latch([1], True)
    play.ask(ask_start(play.core), "start")
    error = play.answer("start").error
    assert isinstance(error, NotPermitted) and error.key == "bus.latched"
    play.ask(ask_read(), "read")
    play.answer("read")
    play.ask(ask_write(play.core), "setpoint")
    assert play.answer("setpoint").error is None
    play.core.latch(None, False)
    play.ask(ask_start(play.core), "again")
    assert play.answer("again").error is None and station.started == 1


def test_the_latch_is_checked_again_when_the_first_bit_goes_out() -> None:
    station = Station()
    play = book(station)
    play.until(1.0)
    play.ask(ask_read(), "busy")
    play.ask(ask_start(play.core), "start")
    play.core.latch(None, True)
    assert isinstance(play.answer("start").error, NotPermitted)
    assert station.started == 0


@pytest.mark.parametrize(
    ("write_class", "attempts"),
    [(WriteClass.ABSOLUTE, 3), (WriteClass.EDGE, 1), (WriteClass.EEPROM, 1), (WriteClass.READ, 1)],
)
def test_only_absolute_writes_are_resent_and_each_try_is_fenced(write_class: WriteClass, attempts: int) -> None:
    """6.5. The station hears everything and never answers writes; its loop-back it answers."""
    station = Station()
    inner = wire(station)

    def mute_for_writes(frame: bytes, ended_at: float) -> list[tuple[float, bytes]]:
        replies = list(inner(frame, ended_at))
        return [] if frame[1] == 6 else replies

    play = Playbook(core(1), mute_for_writes)
    play.ask(ask_read(), "read")
    play.answer("read")
    play.ask(ask_write(play.core, write_class=write_class), "write")
    answer = play.answer("write")
    assert isinstance(answer.error, NoReply) and answer.attempts == attempts
    kinds = [frame[1] for frame in play.frames[1:]]
    assert kinds == ([6, 8] * attempts)[: 2 * attempts - 1]


def test_an_ask_that_calls_its_start_absolute_is_still_sent_once() -> None:
    """F16: the permit's class counts, not the ask's."""
    station = Station(alive=True)
    play = book(station)
    play.ask(ask_read(), "read")
    play.answer("read")
    station.alive = False
    start = replace(ask_start(play.core), write_class=WriteClass.ABSOLUTE)
    play.ask(start, "start")
    assert play.answer("start").attempts == 1


def test_a_retry_checks_the_permit_again() -> None:
    """An absolute write lost its reply; a stop came meanwhile: it is not sent a second time."""
    station = Station()
    play = book(station)
    play.ask(ask_read(), "read")
    play.answer("read")
    station.alive = False
    play.ask(ask_write(play.core), "write")
    play.until(play.now + 0.05)
    station.alive = True
    play.core.stations[1].generation += 1
    answer = play.answer("write")
    assert isinstance(answer.error, NotPermitted) and answer.attempts == 1
    assert [frame[1] for frame in play.frames].count(6) == 1


def test_a_poll_only_reads() -> None:
    from drivebus.bus import Poll

    with pytest.raises(ValueError, match="only reads"):
        core(1).watch(1, [Poll(modbus.WriteRegister(1, COMMAND, START), 1.0)], "w", 0.0)


def test_an_address_is_registered_once_and_never_the_broadcast_address() -> None:
    """T10: a drive at the broadcast address obeys everybody and answers nobody."""
    bus = core(1)
    for address, key in ((1, "bus.address_taken"), (0, "bus.address_broadcast")):
        with pytest.raises(ConfigurationError) as caught:
            bus.add(link(address))
        assert caught.value.key == key


def test_a_write_that_nobody_waits_for_any_more_is_not_sent_again() -> None:
    """Cancelled while its frame is out: the answer is dropped, and there is no second attempt."""
    station = Station()
    play = book(station)
    play.ask(ask_read(), "read")
    play.answer("read")
    station.alive = False
    play.ask(ask_write(play.core), "write")
    play.until(play.now + 0.02)
    play._perform(play.core.cancel("write", play.now))
    station.alive = True
    play.until(play.now + 10)
    assert [frame[1] for frame in play.frames].count(6) == 1


def test_a_drive_registered_anew_is_no_freer_than_before() -> None:
    """6.5, F15, RELIABILITY 4: permits stay void, it stays latched, two drives stay two, a bad link stays bad."""
    play = book(Station())
    play.until(1.0)
    before = ask_start(play.core)
    play.core.latch([1], True)
    for _ in range(2):
        play.core.stations[1].answered_twice(play.now)
        play.core.stations[1].counters.failed(LineFault("bus.marks", station=1, count=1), play.now)
    bad = play.core.statistics(play.now).stations[1].damage_rate
    assert bad > 0 and play.core.health(1, play.now).duplicate
    play._perform(play.core.remove(1, play.now))
    play.core.add(link())
    assert play.core.stations[1].latched and play.core.health(1, play.now).duplicate
    assert play.core.statistics(play.now).stations[1].damage_rate == bad
    play.core.latch([1], False)
    play.ask(before, "start")
    error = play.answer("start").error
    assert isinstance(error, NotPermitted) and error.key == "bus.permit_stopped"


def test_everybody_is_latched_and_released_also_who_is_away() -> None:
    play = book(Station(1), Station(2))
    for on in (True, False):
        play._perform(play.core.remove(1, play.now))
        play.core.latch(None, on)
        play.core.add(link(1))
        assert play.core.stations[1].latched is on


def test_f15_a_second_answer_to_a_drive_that_was_just_taken_off_counts_for_who_follows_it() -> None:
    play = book(Station())
    play.ask(ask_read(), "read")
    play.answer("read")
    before = play.core.stations[1]
    play._perform(play.core.remove(1, play.now))
    play.core.add(link())
    for _ in range(2):
        before.answered_twice(play.now)
    assert play.core.health(1, play.now).duplicate
