"""Failed transactions: what they change of their own station, of others, of the counters and of the trace."""

from __future__ import annotations

import pytest

from drivebus.bus import Poll, Presence, TraceKind
from drivebus.bus.station import PROBE_BUS_SHARE
from drivebus.errors import AddressError, ChecksumError, NoReply
from drivebus.protocols import modbus
from drivebus.protocols.codec import Effect
from drivebus.serial_settings import ANY_REPLY_LATENESS_S
from drivebus.testing.bus_script import BusScript
from fixtures.bus import (
    CHARACTER_S,
    CODEC,
    DAMAGED_REPLY,
    SETTINGS,
    TIMING,
    FakeStation,
    effect,
    make_core,
    make_traced_script,
    read,
    read_request,
    stop_request,
    wire_to,
)


def damage_next_reply(script: BusScript) -> None:
    """Damage the reply to the next frame."""
    intact = script.wire

    def wire(frame: bytes, ended_at: float) -> list[tuple[float, bytes]]:
        script.wire = intact
        return [(ended_at + 0.02, DAMAGED_REPLY)]

    script.wire = wire


def test_a_poll_with_a_damaged_reply_is_repeated_at_once_and_its_attempts_begin_at_one_each_time() -> None:
    script = make_traced_script(FakeStation())
    script.start_polling(1, [Poll(read(), 1.0, phase_s=0.0)])
    script.run_until(script.now + 0.5)
    damage_next_reply(script)
    script.run_until(script.now + 2.0)
    assert [result.attempts for result in script.results["polls"]] == [1, 2, 1]
    assert all(result.error is None for result in script.results["polls"])


def test_bytes_in_place_of_a_reply_do_not_make_a_station_absent_that_was_never_seen() -> None:
    """Something is connected there; only silence ends in probes at growing intervals."""
    script = BusScript(make_core(1), lambda frame, ended_at: [(ended_at + 0.02, b"\x55" * 13)])
    script.submit(read_request())
    assert isinstance(script.result().error, AddressError)
    assert script.core.presence(1) is Presence.NEVER_SEEN and not script.core.stations[1].state.is_unreachable
    silent = BusScript(make_core(1))
    silent.submit(read_request())
    assert isinstance(silent.result().error, NoReply)
    assert silent.core.stations[1].state.is_unreachable


def test_an_unanswered_sync_probe_fails_the_requests_of_its_own_station_only_and_no_stop() -> None:
    stations = FakeStation(address=1), FakeStation(address=2)
    script = make_traced_script(*stations)
    for station in stations:
        station.alive = False
    for address in (1, 2):
        script.submit(read_request(address), f"lost {address}")
    for address in (1, 2):
        script.submit(read_request(address, 0x3100), f"waiting {address}")
    while script.core.transaction is None or not script.core.transaction.prepared.is_sync_probe:
        script._step(script._next_at())
    probed = script.core.transaction.prepared.station.address
    script.submit(stop_request(probed), "stop")
    stations[2 - probed].alive = True
    assert isinstance(script.result(f"waiting {probed}").error, NoReply)
    assert "stop" not in script.results and f"waiting {3 - probed}" not in script.results
    assert script.result(f"waiting {3 - probed}").error is None
    assert [frame for frame in script.frames if effect(frame) is Effect.STOP]


def test_probes_of_an_offline_station_spend_the_share_of_bus_time_for_probes() -> None:
    """The first probe, of a suspect station, is free: requests wait for it."""
    station = FakeStation()
    script = make_traced_script(station)
    station.alive = False
    script.submit(read_request(), "lost")
    script.run_until(script.now + 0.6)
    budget, probe_s = script.core.scheduler.probe_budget, 8 * CHARACTER_S + TIMING.timeout_s(SETTINGS, 8)
    assert script.core.presence(1) is Presence.OFFLINE and budget.allowed_at <= script.now
    count = len(script.sent)
    while len(script.sent) == count:
        script._step(script._next_at())
    probed_at = script.now
    script.run_until(probed_at + probe_s + 0.001)
    gap_s = 3.5 * CHARACTER_S
    assert budget.allowed_at - probed_at == pytest.approx((probe_s + gap_s) / PROBE_BUS_SHARE, rel=0.02)


def test_unanswered_requests_are_remembered_for_as_long_as_their_reply_may_come() -> None:
    station = FakeStation()
    script = make_traced_script(station)
    entries = script.core.stations[1]
    for pause in (0.0, 1.0, ANY_REPLY_LATENESS_S + 1.0):
        station.alive = True
        script.run_until(script.now + pause)
        script.submit(read_request(), "again")
        script.result("again")
        station.alive = False
        script.submit(read_request(), "lost")
        script.run_until(script.now + 0.1)
    newest = entries.unanswered_requests[-1]
    assert all(entry.until > newest.until - ANY_REPLY_LATENESS_S for entry in entries.unanswered_requests)
    assert newest.request == read()


def test_a_lost_and_a_damaged_reply_are_traced_as_what_they_are() -> None:
    script = make_traced_script(FakeStation())
    damage_next_reply(script)
    script.submit(read_request(), "damaged")
    assert script.result("damaged").attempts == 2
    [sent, invalid, *_] = script.traced
    assert (sent.kind, invalid.kind) == (TraceKind.SENT, TraceKind.INVALID)
    assert invalid.data == DAMAGED_REPLY and invalid.station == 1 and isinstance(invalid.error, ChecksumError)
    script.traced.clear()
    script.wire = lambda frame, ended_at: []
    script.submit(read_request(), "lost")
    script.run_until(script.now + 0.15)
    assert [event.kind for event in script.traced] == [TraceKind.SENT, TraceKind.NO_REPLY]


def test_a_line_error_without_a_byte_is_traced_as_invalid_and_not_as_silence() -> None:
    script = make_traced_script(FakeStation())
    script.wire = lambda frame, ended_at: []
    script.submit(read_request(), "disturbed")
    script.run_until(script.now + 0.005)
    script.receive(b"", line_errors=1)
    script.run_until(script.now + 0.15)
    assert [event.kind for event in script.traced] == [TraceKind.SENT, TraceKind.INVALID]


def test_a_cut_reply_is_traced_as_invalid_and_not_as_silence() -> None:
    script = make_traced_script(FakeStation())
    script.wire = lambda frame, ended_at: [(ended_at + 0.02, DAMAGED_REPLY[:5])]
    script.submit(read_request(), "cut")
    script.run_until(script.now + 0.15)
    assert [event.kind for event in script.traced] == [TraceKind.SENT, TraceKind.INVALID]


def test_a_reply_that_comes_twice_counts_as_duplicate_of_its_station_and_noise_after_it_does_not() -> None:
    script = make_traced_script(FakeStation())
    reply = CODEC.encode_reply(modbus.RegisterValues(1, 3, (7,) * 4))
    for count, after in enumerate((b"\xff", reply)):
        script.wire = lambda frame, ended_at, after=after: [(ended_at + 0.03, reply + after)]
        script.submit(read_request(), "trailing")
        script.run_until(script.now + 0.06)
        station = script.core.stations[1].counters
        assert station.events.get("duplicate", 0) == script.core.counters.events.get("duplicate", 0) == count
        script.wire = wire_to(FakeStation())
        script.run_until(script.now + 2)


def test_bytes_before_the_end_of_our_frame_are_traced_and_count_as_time_on_the_wire() -> None:
    clean, early = (make_traced_script(FakeStation()) for _ in range(2))
    for script in (clean, early):
        script.submit(read_request(), "read")
        if script is early:
            script.receive(b"\xff\xff", at=script.now + 5 * CHARACTER_S)
        assert script.result("read").error is None
    [event] = [event for event in early.traced if event.kind is TraceKind.BEFORE_TX_END]
    assert event.data == b"\xff\xff"
    assert clean.traced[-1].kind is early.traced[-1].kind is TraceKind.REPLY
    loads = [script.core.statistics(script.now).load_percent for script in (clean, early)]
    assert loads[1] > loads[0]


def test_every_byte_received_counts_for_its_station() -> None:
    script = make_traced_script(FakeStation())
    assert script.core.stations[1].counters.bytes_received == script.core.counters.bytes_received == 13


def test_health_says_until_when_reads_of_a_suspect_station_wait() -> None:
    station = FakeStation()
    script = make_traced_script(station)
    assert script.core.health(1, script.now).reads_wait_until == 0.0
    station.alive = False
    script.submit(read_request(), "lost")
    script.run_until(script.now + 0.1)
    waits_until = script.core.health(1, script.now).reads_wait_until
    assert script.now < waits_until == script.core.stations[1].quarantined_until


def test_a_broadcast_says_nothing_about_an_echo() -> None:
    core = make_core(1, echo="detect")
    script = BusScript(core)
    script.submit(stop_request(0), "all")
    script.run()
    assert script.results["all"][-1].error is None and not core.echo.ruled_out


def test_a_single_byte_in_place_of_a_reply_is_named_to_the_requests_that_wait_for_the_sync_probe() -> None:
    """Something is connected there, so they do not fail as offline."""
    script = make_traced_script(FakeStation())
    for token, received in (("cut", DAMAGED_REPLY[:1]), ("waiting", b"")):
        script.wire = lambda frame, ended_at, received=received: [(ended_at + 0.02, received)] if received else []
        script.submit(read_request(), token)
        script.run_until(script.now + 0.1)
    error = script.result("waiting").error
    assert isinstance(error, NoReply) and error.key == "bus.truncated" and error.params["bytes"] == 1


def test_what_an_offline_station_sends_in_place_of_a_reply_is_shown_until_nothing_comes_any_more() -> None:
    script = make_traced_script(FakeStation())
    script.wire = lambda frame, ended_at: [(ended_at + 0.02, DAMAGED_REPLY[:5])]
    script.submit(read_request(), "cut")
    assert script.core.unusable_reply(1) is None, "it is online"
    script.run_until(script.now + 5.0)
    error = script.core.unusable_reply(1)
    assert script.core.presence(1) is Presence.OFFLINE and error is not None
    script.wire = lambda frame, ended_at: []
    script.run_until(script.now + 60.0)
    assert script.core.presence(1) is Presence.OFFLINE and script.core.unusable_reply(1) is None
