"""No frame that may act leaves without a valid permit, whoever asks and however (I1, F16, idea 5)."""

from __future__ import annotations

from dataclasses import replace

import pytest

from buskit import COMMAND, LINE, START, STOP, Station, ask_read, ask_start, ask_write, book, core, link, wire
from drivebus.bus.job import REMEMBERED, Job, prepared
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


def test_i1_a_permit_without_an_end_can_not_be_made() -> None:
    with pytest.raises(ValueError, match="expected monotonic seconds"):
        permit(expires_at=float("nan"))


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


@pytest.mark.parametrize(("value", "key"), [(STOP, None), (START, "bus.broadcast")])
def test_a_frame_for_everybody_is_judged_as_one_whoever_was_named(value: int, key: str | None) -> None:
    """F10: drive 1 is named and even has a permit, but address 0 in the bytes speaks to all."""
    play = book(Station(1), Station(2))
    play.ask(Ask(1, modbus.WriteRegister(0, COMMAND, value), Lane.COMMAND, WriteClass.EDGE, permit()))
    error = play.answer().error
    assert (error.key if isinstance(error, NotPermitted) else error) == key
    assert len(play.sent) == (key is None)


def test_everybody_can_not_be_named_for_a_frame_that_one_drive_answers() -> None:
    play = book(Station(1), Station(2))
    play.ask(Ask(0, modbus.WriteRegister(1, COMMAND, STOP), Lane.STOP))
    error = play.answer().error
    assert isinstance(error, NotPermitted) and error.key == "bus.broadcast_answered" and error.params["station"] == 0
    assert play.sent == []


def test_a_request_that_can_not_be_remembered_is_sent_all_the_same() -> None:
    """A list of values can't be hashed."""
    play = Playbook(core(1))
    values: tuple[int, ...] = [7]  # type: ignore[assignment]
    play.ask(Ask(1, modbus.WriteRegisters(1, 0x3000, values), permit=permit(effect=Effect.SETTING)))
    play.until(0.01)
    assert play.frames == [modbus.RtuCodec().encode_request(modbus.WriteRegisters(1, 0x3000, (7,)))]


def test_only_so_many_reads_of_a_station_are_remembered_and_no_write() -> None:
    """I12: a program that reads ever other registers must not fill the memory."""
    station = core(1).stations[1]
    for register in range(REMEMBERED):
        prepared(modbus.ReadRegisters(1, register), station, LINE)
    assert len(station.prepared) == REMEMBERED
    found = prepared(modbus.ReadRegisters(1, 7), station, LINE)
    assert found is station.prepared[modbus.ReadRegisters(1, 7)]
    assert prepared(modbus.ReadRegisters(1, REMEMBERED), station, LINE)[0][3] == REMEMBERED & 0xFF
    assert len(station.prepared) == 1
    for other in (modbus.WriteRegister(1, 0x2001, 1), modbus.ReadRegisters(2, 7)):
        assert not prepared(other, station, LINE)[5]
    assert len(station.prepared) == 1


def job(given: Permit | None, register: int = COMMAND, value: int = START) -> Job:
    ask = Ask(1, modbus.WriteRegister(1, register, value), Lane.COMMAND, WriteClass.EDGE, given)
    return Job(ask, None, core(1).stations[1], LINE)


def test_a_permit_is_good_up_to_its_last_moment_and_says_how_late_it_came() -> None:
    """Ruling 12, at the boundary itself."""
    start = job(permit(expires_at=10.0))
    assert start.refusal(10.0) is None
    refusal = start.refusal(10.0015)
    assert refusal is not None and refusal.key == "bus.permit_expired"
    assert refusal.params == {"station": 1, "late_ms": 2}
    later = start.refusal(11.0)
    assert later is not None and later.params["late_ms"] == 1000


def test_a_permit_of_an_older_generation_than_the_last_stop_is_void_and_so_is_one_of_a_newer() -> None:
    for generation, refused in ((4, True), (5, False), (6, True)):
        start = job(permit(generation=generation))
        start.station.generation = 5
        assert (start.refusal(0.0) is not None) is refused


def test_a_latched_station_is_refused_motion_only() -> None:
    start, setting = job(permit()), job(permit(effect=Effect.SETTING), 0x2001)
    for one, key in ((start, "bus.latched"), (setting, None)):
        one.station.latched = True
        refusal = one.refusal(0.0)
        assert (refusal.key if refusal else None) == key


def test_a_refusal_names_the_station_and_what_was_granted() -> None:
    refusal = job(permit(station=2, effect=Effect.SETTING)).refusal(0.0)
    assert refusal is not None
    assert refusal.params == {"station": 1, "effect": "motion", "granted": 2, "granted_effect": "setting"}
    refusal = job(None).refusal(0.0)
    assert refusal is not None and refusal.params == {"station": 1, "effect": "motion"}


def test_a_stop_and_a_read_are_never_refused_and_a_stop_never_expires() -> None:
    """Ruling 5."""
    stop = job(permit(station=2, expires_at=-1.0, generation=9), COMMAND, STOP)
    stop.station.latched = True
    assert stop.refusal(1e9) is None
    ask = Ask(1, modbus.WriteRegister(1, COMMAND, STOP), Lane.COMMAND, expires_at=1.0)
    assert Job(ask, None, stop.station, LINE).expires_at is None
