"""No frame that may move a motor or change a setting is sent without a valid permit."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivebus.bus.messages import BusRequest, Permit, RequestPriority, RetryPolicy
from drivebus.bus.prepared_request import PreparedRequest
from drivebus.bus.station import ENCODE_CACHE_SIZE
from drivebus.errors import ConfigurationError, Expired, LineError, NoReply, NotPermitted
from drivebus.protocols import modbus
from drivebus.protocols.codec import Effect
from drivebus.testing.bus_script import BusScript
from fixtures.bus import (
    COMMAND,
    SETTINGS,
    START,
    STOP,
    TIMING,
    FakeStation,
    make_core,
    make_script,
    read_request,
    start_request,
    station_config,
    stop_request,
    wire_to,
    write_request,
)


def permit(**changes: object) -> Permit:
    return replace(
        Permit(
            station=1, effect=Effect.MOTION, retry_policy=RetryPolicy.EDGE_TRIGGERED, expires_at=100.0, stop_epoch=0
        ),
        **changes,
    )  # type: ignore[arg-type]


def command_request(address: int, value: int, given: Permit | None) -> BusRequest:
    """Return a request for drive 1 with this command word, whose bytes name ``address``."""
    return BusRequest(
        station=1,
        request=modbus.WriteRegister(address, COMMAND, value),
        priority=RequestPriority.COMMAND,
        permit=given,
    )


@pytest.mark.parametrize(
    ("given", "key"),
    [
        (None, "bus.no_permit"),
        (permit(station=2), "bus.other_permit"),
        (permit(effect=Effect.SETTING), "bus.other_permit"),
        (permit(expires_at=-1.0), "bus.permit_expired"),
        (permit(stop_epoch=5), "bus.permit_stopped"),
    ],
)
def test_a_start_without_its_own_valid_permit_never_leaves(given: Permit | None, key: str) -> None:
    station = FakeStation()
    script = make_script(station)
    script.submit(command_request(1, START, given))
    result = script.result()
    assert isinstance(result.error, NotPermitted) and result.error.key == key
    assert script.sent == [] and station.start_count == 0


def test_a_permit_without_an_end_can_not_be_made() -> None:
    with pytest.raises(ValueError, match="expected monotonic seconds"):
        permit(expires_at=float("nan"))


def test_a_start_with_the_priority_of_a_poll_needs_a_permit() -> None:
    """The effect comes from the bytes, not from the request's own fields."""
    script = make_script(FakeStation())
    script.submit(
        BusRequest(
            station=1,
            request=modbus.WriteRegister(1, COMMAND, START),
            priority=RequestPriority.POLL,
        )
    )
    assert isinstance(script.result().error, NotPermitted)


def test_a_request_for_another_station_than_was_named_never_leaves() -> None:
    """A permit for drive 1 can't start drive 2."""
    script = make_script(FakeStation(address=1), FakeStation(address=2))
    script.submit(command_request(2, START, permit()))
    error = script.result().error
    assert isinstance(error, NotPermitted) and error.key == "bus.other_station"


def test_a_station_that_is_not_registered_can_not_be_addressed() -> None:
    script = make_script(FakeStation(address=1))
    script.submit(read_request(9))
    error = script.result().error
    assert isinstance(error, NotPermitted) and error.key == "bus.unregistered"
    assert script.sent == []


def test_expiry_is_checked_when_the_first_bit_goes_out() -> None:
    """The permit is valid at the request and expired at the turn of the frame."""
    station = FakeStation()
    script = make_script(station)
    script.submit(read_request(), "read")
    script.result("read")
    station.alive = False
    script.submit(read_request(), "busy")
    script.submit(start_request(script.core, until=script.now + 0.03), "start")
    result = script.result("start")
    assert isinstance(result.error, Expired) and result.sent == b""
    assert station.start_count == 0


def test_a_repetition_that_expires_does_not_hide_that_the_frame_was_sent() -> None:
    """An idempotent write without a reply waits for its retry; it counts as sent even if the retry is not sent."""
    station = FakeStation()
    script = make_script(station)
    script.submit(read_request(), "read")
    script.result("read")
    station.alive = False
    script.submit(write_request(script.core, until=script.now + 0.1), "write")
    script.run_until(script.now + 5)
    result = script.result("write")
    assert isinstance(result.error, Expired)
    assert (result.sent, result.sent_at, result.attempts) == (script.sent[1][1], script.sent[1][0], 1)


def test_a_start_that_waits_behind_a_quarantine_expires_in_time() -> None:
    """The caller waits no longer than the expiry, and nothing is sent afterwards."""
    station = FakeStation()
    script = make_script(station)
    script.submit(read_request(), "read")
    script.result("read")
    station.alive = False
    script.submit(write_request(script.core, retry_policy=RetryPolicy.EDGE_TRIGGERED), "lost")
    script.result("lost")
    submitted_at = script.now
    script.submit(start_request(script.core, until=submitted_at + 0.1), "start")
    assert isinstance(script.result("start").error, Expired)
    assert script.now - submitted_at < 0.15
    station.alive = True
    script.run_until(script.now + 5)
    assert station.start_count == 0


def test_while_inhibited_nothing_moves_and_settings_pass() -> None:
    station = FakeStation()
    script = make_script(station)
    script.core.registry.set_start_inhibit([1], inhibited=True)
    script.submit(start_request(script.core), "start")
    error = script.result("start").error
    assert isinstance(error, NotPermitted) and error.key == "bus.start_inhibited"
    script.submit(read_request(), "read")
    script.result("read")
    script.submit(write_request(script.core), "setpoint")
    assert script.result("setpoint").error is None
    script.core.registry.set_start_inhibit(None, inhibited=False)
    script.submit(start_request(script.core), "again")
    assert script.result("again").error is None and station.start_count == 1


def test_the_start_inhibit_is_checked_again_when_the_first_bit_goes_out() -> None:
    station = FakeStation()
    script = make_script(station)
    script.run_until(1.0)
    script.submit(read_request(), "busy")
    script.submit(start_request(script.core), "start")
    script.core.registry.set_start_inhibit(None, inhibited=True)
    assert isinstance(script.result("start").error, NotPermitted)
    assert station.start_count == 0


@pytest.mark.parametrize(
    ("retry_policy", "attempts"),
    [(RetryPolicy.IDEMPOTENT, 3), (RetryPolicy.EDGE_TRIGGERED, 1), (RetryPolicy.EEPROM, 1)],
)
def test_only_absolute_writes_are_resent_each_after_a_sync_probe(retry_policy: RetryPolicy, attempts: int) -> None:
    """The station receives everything, replies to loop-backs and never to writes."""
    station = FakeStation()
    inner = wire_to(station)

    def mute_for_writes(frame: bytes, ended_at: float) -> list[tuple[float, bytes]]:
        replies = list(inner(frame, ended_at))
        return [] if frame[1] == 6 else replies

    script = BusScript(make_core(1), mute_for_writes)
    script.submit(read_request(), "read")
    script.result("read")
    script.submit(write_request(script.core, retry_policy=retry_policy), "write")
    result = script.result("write")
    assert isinstance(result.error, NoReply) and result.attempts == attempts
    kinds = [frame[1] for frame in script.frames[1:]]
    assert kinds == ([6, 8] * attempts)[: 2 * attempts - 1]


def test_a_start_whose_permit_is_idempotent_is_still_sent_once() -> None:
    """The effect of the bytes counts, not the retry policy of the permit."""
    station = FakeStation(alive=True)
    script = make_script(station)
    script.submit(read_request(), "read")
    script.result("read")
    station.alive = False
    script.submit(write_request(script.core, 1, COMMAND, START, retry_policy=RetryPolicy.IDEMPOTENT), "start")
    assert script.result("start").attempts == 1


def test_a_retry_checks_the_permit_again() -> None:
    """An absolute write without a reply is not sent a second time after a stop."""
    station = FakeStation()
    script = make_script(station)
    script.submit(read_request(), "read")
    script.result("read")
    station.alive = False
    script.submit(write_request(script.core), "write")
    script.run_until(script.now + 0.05)
    station.alive = True
    script.core.stations[1].stop_epoch += 1
    result = script.result("write")
    assert isinstance(result.error, NotPermitted) and result.attempts == 1
    assert [frame[1] for frame in script.frames].count(6) == 1


def test_a_poll_only_reads() -> None:
    from drivebus.bus import Poll

    with pytest.raises(ValueError, match="only reads"):
        make_core(1).start_polling(1, [Poll(modbus.WriteRegister(1, COMMAND, START), 1.0)], "w", 0.0)


def test_no_station_may_reply_later_than_its_unanswered_requests_are_remembered() -> None:
    """Else a sync probe could be confirmed by the late reply to an older request."""
    make_core(1, timing=replace(TIMING, max_reply_lateness_s=5.0))
    with pytest.raises(ValueError, match=r"no reply may be later than 5\.0 s"):
        make_core(1, timing=replace(TIMING, max_reply_lateness_s=5.1))


def test_an_address_is_registered_once_and_never_the_broadcast_address() -> None:
    """A drive at the broadcast address executes every frame and never replies."""
    bus = make_core(1)
    for address, key in ((1, "bus.address_taken"), (0, "bus.address_broadcast")):
        with pytest.raises(ConfigurationError) as caught:
            bus.registry.add(station_config(address))
        assert caught.value.key == key


def test_a_cancelled_write_is_not_sent_again() -> None:
    """It is cancelled while its frame is on the wire: the reply is dropped, and there is no second attempt."""
    station = FakeStation()
    script = make_script(station)
    script.submit(read_request(), "read")
    script.result("read")
    station.alive = False
    script.submit(write_request(script.core), "write")
    script.run_until(script.now + 0.02)
    script._perform(script.core.cancel("write", script.now))
    station.alive = True
    script.run_until(script.now + 10)
    assert [frame[1] for frame in script.frames].count(6) == 1


def test_a_drive_registered_again_inherits_its_start_inhibits() -> None:
    """Permits stay invalid, and start inhibit, second replies and error rates are kept."""
    script = make_script(FakeStation())
    script.run_until(1.0)
    before = start_request(script.core)
    script.core.registry.set_start_inhibit([1], inhibited=True)
    for _ in range(2):
        script.core.stations[1].record_duplicate_reply(script.now)
        script.core.stations[1].counters.record_failure(LineError("bus.line_errors", station=1, count=1), script.now)
    bad = script.core.statistics(script.now).stations[1].damage_rate
    assert bad > 0 and script.core.health(1, script.now).duplicate_address
    script._perform(script.core.remove_station(1, script.now))
    script.core.registry.add(station_config())
    assert script.core.stations[1].start_inhibited and script.core.health(1, script.now).duplicate_address
    assert script.core.statistics(script.now).stations[1].damage_rate == bad
    script.core.registry.set_start_inhibit([1], inhibited=False)
    script.submit(before, "start")
    error = script.result("start").error
    assert isinstance(error, NotPermitted) and error.key == "bus.permit_stopped"


def test_a_start_inhibit_of_all_includes_removed_stations() -> None:
    script = make_script(FakeStation(address=1), FakeStation(address=2))
    for on in (True, False):
        script._perform(script.core.remove_station(1, script.now))
        script.core.registry.set_start_inhibit(None, inhibited=on)
        script.core.registry.add(station_config(1))
        assert script.core.stations[1].start_inhibited is on


def test_a_second_reply_of_a_removed_drive_counts_for_its_successor() -> None:
    script = make_script(FakeStation())
    script.submit(read_request(), "read")
    script.result("read")
    before = script.core.stations[1]
    script._perform(script.core.remove_station(1, script.now))
    script.core.registry.add(station_config())
    for _ in range(2):
        before.record_duplicate_reply(script.now)
    assert script.core.health(1, script.now).duplicate_address


@pytest.mark.parametrize(("value", "key"), [(STOP, None), (START, "bus.broadcast")])
def test_a_broadcast_frame_is_checked_as_a_broadcast_whatever_station_is_named(value: int, key: str | None) -> None:
    """The request names drive 1 and has its permit, but address 0 in the bytes addresses all."""
    script = make_script(FakeStation(address=1), FakeStation(address=2))
    script.submit(command_request(0, value, permit()))
    error = script.result().error
    assert (error.key if isinstance(error, NotPermitted) else error) == key
    assert len(script.sent) == (key is None)


def test_the_broadcast_address_can_not_be_named_for_a_frame_with_a_reply() -> None:
    script = make_script(FakeStation(address=1), FakeStation(address=2))
    script.submit(BusRequest(station=0, request=modbus.WriteRegister(1, COMMAND, STOP), priority=RequestPriority.STOP))
    error = script.result().error
    assert isinstance(error, NotPermitted) and error.key == "bus.broadcast_answered" and error.params["station"] == 0
    assert script.sent == []


def test_a_request_that_cannot_be_cached_is_still_sent() -> None:
    """A list of values can't be hashed."""
    script = BusScript(make_core(1))
    values: tuple[int, ...] = [7]  # type: ignore[assignment]
    script.submit(
        BusRequest(station=1, request=modbus.WriteRegisters(1, 0x3000, values), permit=permit(effect=Effect.SETTING))
    )
    script.run_until(0.01)
    assert script.frames == [modbus.ModbusRtuCodec().encode_request(modbus.WriteRegisters(1, 0x3000, (7,)))]


def test_a_limited_number_of_reads_is_cached_and_no_write() -> None:
    """A program that always reads new registers must not fill the memory."""
    station = make_core(1).stations[1]
    for register in range(ENCODE_CACHE_SIZE):
        station.encode(modbus.ReadRegisters(1, register), SETTINGS)
    assert len(station.encode_cache) == ENCODE_CACHE_SIZE
    found = station.encode(modbus.ReadRegisters(1, 7), SETTINGS)
    assert found is station.encode_cache[modbus.ReadRegisters(1, 7)]
    assert station.encode(modbus.ReadRegisters(1, ENCODE_CACHE_SIZE), SETTINGS).data[3] == ENCODE_CACHE_SIZE & 0xFF
    assert len(station.encode_cache) == 1
    for other in (modbus.WriteRegister(1, 0x2001, 1), modbus.ReadRegisters(2, 7)):
        assert not station.encode(other, SETTINGS).cacheable
    assert len(station.encode_cache) == 1


def prepared_write(given: Permit | None, register: int = COMMAND, value: int = START) -> PreparedRequest:
    ask = BusRequest(
        station=1,
        request=modbus.WriteRegister(1, register, value),
        priority=RequestPriority.COMMAND,
        permit=given,
    )
    return PreparedRequest(ask, None, make_core(1).stations[1], SETTINGS)


def test_a_permit_is_valid_until_its_expiry_and_the_rejection_reports_the_lateness() -> None:
    """A permit is valid at exactly its expiry."""
    start = prepared_write(permit(expires_at=10.0))
    assert start.permit_error(10.0) is None
    rejection = start.permit_error(10.0015)
    assert rejection is not None and rejection.key == "bus.permit_expired"
    assert rejection.params == {"station": 1, "late_ms": 2}
    later = start.permit_error(11.0)
    assert later is not None and later.params["late_ms"] == 1000


def test_a_permit_of_another_stop_epoch_is_invalid() -> None:
    for stop_epoch, refused in ((4, True), (5, False), (6, True)):
        start = prepared_write(permit(stop_epoch=stop_epoch))
        start.station.stop_epoch = 5
        assert (start.permit_error(0.0) is not None) is refused


def test_an_inhibited_station_rejects_motion_only() -> None:
    start, setting = prepared_write(permit()), prepared_write(permit(effect=Effect.SETTING), 0x2001)
    for prepared, key in ((start, "bus.start_inhibited"), (setting, None)):
        prepared.station.start_inhibited = True
        rejection = prepared.permit_error(0.0)
        assert (rejection.key if rejection else None) == key


def test_a_rejection_names_the_station_and_the_permit() -> None:
    rejection = prepared_write(permit(station=2, effect=Effect.SETTING)).permit_error(0.0)
    assert rejection is not None
    assert rejection.params == {"station": 1, "effect": "motion", "granted": 2, "granted_effect": "setting"}
    rejection = prepared_write(None).permit_error(0.0)
    assert rejection is not None and rejection.params == {"station": 1, "effect": "motion"}


def test_a_stop_and_a_read_are_never_rejected_and_a_stop_never_expires() -> None:
    stop = prepared_write(permit(station=2, expires_at=-1.0, stop_epoch=9), COMMAND, STOP)
    stop.station.start_inhibited = True
    assert stop.permit_error(1e9) is None
    ask = BusRequest(
        station=1, request=modbus.WriteRegister(1, COMMAND, STOP), priority=RequestPriority.COMMAND, expires_at=1.0
    )
    assert PreparedRequest(ask, None, stop.station, SETTINGS).expires_at is None


def test_only_frames_that_move_and_were_sent_count_as_motions() -> None:
    """A start that was withdrawn before it was sent leaves the count of its station, and so its drive, as it was."""
    script = make_script(FakeStation())
    station = script.core.stations[1]
    for request in (read_request(), write_request(script.core), stop_request(), start_request(script.core, until=-1.0)):
        script.submit(request, "no motion")
        script.result("no motion")
    assert station.motions_sent == 0
    for count in (1, 2):
        script.submit(start_request(script.core), count)
        assert script.result(count).error is None and station.motions_sent == count
