"""Frames that no request of ours has caused: their bytes, time, sender and consequence, one by one."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivebus import profiles
from drivebus.bus import TraceKind
from drivebus.bus.core import BusCore
from drivebus.bus.echo import EchoState
from drivebus.bus.unsolicited import MAX_UNSOLICITED_BYTES
from drivebus.drives.dialects.base import StopMode
from drivebus.drives.dialects.create import create_dialect
from drivebus.errors import LineError, NoReply
from drivebus.families.huanyang.codec import CONTROL, HuanyangReply
from drivebus.protocols import modbus
from drivebus.protocols.codec import Complete
from drivebus.protocols.modbus.rtu import build_frame
from drivebus.testing.bus_script import BusScript
from fixtures.bus import (
    CHARACTER_S,
    CODEC,
    SETTINGS,
    TIMING,
    FakeStation,
    make_core,
    make_traced_script,
    read,
    read_request,
    station_config,
    stop_request,
    wire_to,
    write_request,
)

FOREIGN_READ = CODEC.encode_request(modbus.ReadRegisters(1, 0x0100, 2))
READ_OF_STRANGER = CODEC.encode_request(modbus.ReadRegisters(17, 0x0100, 2))
FOREIGN_REPLY = CODEC.encode_reply(modbus.RegisterValues(1, 3, (1, 2)))


def online(*addresses: int) -> BusScript:
    """Return the script of a bus whose stations have answered once, tracing since then."""
    return make_traced_script(*(FakeStation(address=address) for address in addresses))


def make_suspect(script: BusScript, address: int) -> None:
    """Lose the reply to a read, and end in the quarantine of the station."""
    wire, script.wire = script.wire, lambda frame, ended_at: []
    script.submit(read_request(address), "lost")
    script.run_until(script.now + 0.1)
    script.wire = wire
    script.traced.clear()
    assert script.core.stations[address].state.is_suspect


def receive(script: BusScript, data: bytes) -> float:
    """Let bytes come when the bus has been silent for a while; return their time."""
    at = script.now + 0.05
    script.receive(data, at=at)
    script.run_until(at + 0.01)
    return at


def test_a_foreign_request_and_its_reply_without_a_pause_are_two_frames() -> None:
    script = online(1)
    at = receive(script, FOREIGN_READ + FOREIGN_REPLY)
    frames = [(event.time, event.kind, event.station, event.data) for event in script.traced]
    assert frames == [
        (at, TraceKind.FOREIGN_REQUEST, None, FOREIGN_READ),
        (at, TraceKind.FOREIGN, 1, FOREIGN_REPLY),
    ]
    assert not script.core.stations[1].state.is_suspect


def test_the_reply_to_a_foreign_request_belongs_to_the_station_that_was_asked() -> None:
    script = online(1, 2)
    receive(script, CODEC.encode_request(modbus.ReadRegisters(2, 0x0100, 2)))
    script.receive(CODEC.encode_reply(modbus.RegisterValues(2, 3, (1, 2))), at=script.now + 0.01)
    script.run_until(script.now + 0.02)
    assert [(event.kind, event.station) for event in script.traced] == [
        (TraceKind.FOREIGN_REQUEST, None),
        (TraceKind.FOREIGN, 2),
    ]


def test_a_late_reply_is_the_last_frame_of_its_station_and_names_its_lateness() -> None:
    script = online(1)
    make_suspect(script, 1)
    sent_at = script.core.stations[1].last_request_sent_at
    late = CODEC.encode_reply(modbus.RegisterValues(1, 3, (9,) * 4))
    at = receive(script, late)
    station = script.core.stations[1]
    assert station.last_frame == late
    assert isinstance(station.failure_reason, NoReply) and station.failure_reason.key == "bus.late_reply"
    assert station.failure_reason.params["milliseconds"] == round((at - sent_at) * 1000)


def test_a_late_acknowledgement_that_follows_an_unanswered_sync_probe_names_its_own_lateness() -> None:
    script = online(1)
    script.wire = lambda frame, ended_at: []
    script.submit(write_request(script.core), "lost")
    script.run_until(script.now + 0.01)
    assert script.core.transaction is not None
    sent_at = script.core.transaction.tx_end_at
    script.run_until(script.now + 0.6)
    assert isinstance(script.core.stations[1].last_request, modbus.Diagnostics)
    at = receive(script, CODEC.encode_request(modbus.WriteRegister(1, 0x2001, 5000)))
    reason = script.core.stations[1].failure_reason
    assert isinstance(reason, NoReply) and reason.key == "bus.late_reply"
    assert reason.params["milliseconds"] == round((at - sent_at) * 1000)


def test_a_late_reply_during_another_stations_turn_does_not_prolong_the_quarantine() -> None:
    script = online(1, 2)
    make_suspect(script, 2)
    quarantined_until = script.core.stations[2].quarantined_until
    late = CODEC.encode_reply(modbus.RegisterValues(2, 3, (1,) * 4))
    script.wire = lambda frame, ended_at: [(ended_at + 0.02, late)]
    script.submit(read_request(1), "read")
    script.run_until(script.now + 0.1)
    assert (TraceKind.LATE, 2) in [(event.kind, event.station) for event in script.traced]
    assert script.core.stations[2].quarantined_until == quarantined_until


def test_unknown_bytes_are_a_failure_of_each_suspect_station_and_of_no_other() -> None:
    script = online(1, 2, 3)
    make_suspect(script, 2)
    make_suspect(script, 3)
    receive(script, b"\x55\x66")
    reasons = [station.failure_reason for station in script.core.stations.values()]
    assert reasons[0] is None
    assert all(isinstance(reason, NoReply) and reason.key == "bus.offline_bytes" for reason in reasons[1:])
    assert [(event.kind, event.station) for event in script.traced] == [(TraceKind.UNSOLICITED, None)]


def test_a_write_to_a_stranger_is_no_late_reply_of_a_suspect_station() -> None:
    """The acknowledgement of a write equals its request, so only the address tells them apart."""
    script = online(1)
    make_suspect(script, 1)
    receive(script, CODEC.encode_request(modbus.WriteRegister(17, 0x2001, 5)))
    assert [event.kind for event in script.traced] == [TraceKind.FOREIGN_REQUEST]


def test_a_reply_of_our_station_in_place_of_another_ones_makes_it_suspect_and_noise_does_not() -> None:
    script = online(1, 2)
    script.wire = lambda frame, ended_at: [(ended_at + 0.02, CODEC.encode_reply(modbus.RegisterValues(2, 3, (1,) * 4)))]
    script.submit(read_request(1), "read")
    script.run_until(script.now + 0.1)
    assert script.core.stations[2].state.is_suspect
    assert [(event.kind, event.station) for event in script.traced if event.kind is TraceKind.FOREIGN] == [
        (TraceKind.FOREIGN, 2)
    ]
    quiet = online(1, 2)
    receive(quiet, b"\x55\x66")
    assert not any(station.state.is_suspect for station in quiet.core.stations.values())


def test_a_foreign_request_that_is_not_answered_in_time_makes_its_station_suspect_when_bytes_come() -> None:
    script = online(1)
    receive(script, FOREIGN_READ)
    script.run_until(script.now + 2.0)
    assert not script.core.stations[1].state.is_suspect, "nothing was sent and nothing came"
    receive(script, FOREIGN_REPLY)
    station = script.core.stations[1]
    assert station.state.is_suspect
    assert [entry.request for entry in station.unanswered_requests] == [modbus.ReadRegisters(1, 0x0100, 2)]


def test_a_second_foreign_request_ends_the_wait_for_the_reply_to_the_first() -> None:
    script = online(1, 2)
    for address in (1, 2):
        script.receive(CODEC.encode_request(modbus.ReadRegisters(address, 0x0100, 2)), at=script.now + 0.01)
        script.run_until(script.now + 0.015)
    assert [station.state.is_suspect for station in script.core.stations.values()] == [True, False]


def test_the_reply_to_a_foreign_request_that_is_being_received_is_waited_for() -> None:
    """The last byte of the reply came in time; only the silence after it ends later."""
    script = online(1)
    receive(script, FOREIGN_READ)
    foreign = script.core.unsolicited.foreign_request
    assert foreign is not None
    script.submit(read_request(), "ours")
    script.receive(FOREIGN_REPLY, at=foreign.reply_until - CHARACTER_S)
    assert script.result("ours").error is None and not script.core.stations[1].state.is_suspect
    assert script.sent[-1][0] == pytest.approx(foreign.reply_until + 2.5 * CHARACTER_S)


def test_after_the_reply_to_a_foreign_request_ours_is_sent_a_gap_later() -> None:
    script = online(1)
    receive(script, FOREIGN_READ)
    script.submit(read_request(), "ours")
    at = script.now + 0.01
    script.receive(FOREIGN_REPLY, at=at)
    assert script.result("ours").error is None
    assert script.sent[-1][0] == pytest.approx(at + 3.5 * CHARACTER_S)


def test_a_foreign_request_to_a_station_that_was_removed_is_forgotten() -> None:
    script = online(1, 2)
    receive(script, FOREIGN_READ)
    script._perform(script.core.remove_station(1, script.now))
    script.submit(read_request(2), "ours")
    assert script.result("ours").error is None and not script.core.stations[2].state.is_suspect


@pytest.mark.parametrize(("extra", "is_alone"), [(b"", True), (b"\x55", False)])
def test_a_foreign_request_in_place_of_a_reply_has_its_own_bytes_and_the_earliest_time(
    extra: bytes, is_alone: bool
) -> None:
    """With bytes after it only its earliest time is known, the end of our own frame."""
    script = online(1)
    script.wire = lambda frame, ended_at: [(ended_at + 0.02, READ_OF_STRANGER + extra)]
    script.submit(read_request(), "ours")
    transaction = script.core.transaction
    assert transaction is not None
    script.run_until(script.now + 0.1)
    [event] = [event for event in script.traced if event.kind is TraceKind.FOREIGN_REQUEST]
    assert event.data == READ_OF_STRANGER and event.station is None
    assert event.time == (transaction.last_byte_at if is_alone else transaction.tx_end_at)


def test_our_own_frame_in_place_of_a_reply_is_no_foreign_request() -> None:
    script = online(1)
    script.wire = lambda frame, ended_at: [(ended_at + 0.02, frame)]
    script.submit(read_request(), "ours")
    script.run_until(script.now + 0.1)
    assert "foreign_request" not in script.core.counters.events


def test_our_own_frame_with_a_byte_behind_it_is_no_foreign_request() -> None:
    script = online(1)
    script.wire = lambda frame, ended_at: [(ended_at + 0.02, frame + b"\x55")]
    script.submit(read_request(), "ours")
    script.run_until(script.now + 0.1)
    assert "foreign_request" not in script.core.counters.events


def test_a_foreign_master_is_two_requests_of_the_last_minute_and_no_older_ones_are_kept() -> None:
    unsolicited = make_core(1).unsolicited
    for at in (1000.0, 1010.0, 1020.0):
        unsolicited.add(READ_OF_STRANGER, at)
        unsolicited.classify_buffer(at + 0.01)
    assert unsolicited.has_foreign_master(1070.0) and not unsolicited.has_foreign_master(1070.001)
    assert unsolicited._foreign_request_times == [1010.0, 1020.0]


def test_at_most_512_unsolicited_bytes_are_kept_and_a_piece_is_joined_for_50_ms() -> None:
    unsolicited = make_core(1).unsolicited
    unsolicited.add(bytes(1000), 1.0)
    assert len(unsolicited.buffer) == MAX_UNSOLICITED_BYTES == 512
    unsolicited.reset()
    for pause_s, kind in ((0.05, TraceKind.FOREIGN_REQUEST), (0.0501, TraceKind.UNSOLICITED)):
        unsolicited.add(READ_OF_STRANGER[:3], 0.0)
        unsolicited.classify_buffer(0.0)
        unsolicited.add(READ_OF_STRANGER[3:], pause_s)
        assert [event.kind for event in unsolicited.classify_buffer(0.1)] == [kind]


def test_a_station_that_answers_slowly_is_given_half_a_second_for_the_reply_to_another_master() -> None:
    core = make_core(2)
    core.registry.add(station_config(1, replace(TIMING, reply_delay_s=2.0)))
    script = BusScript(core)
    at = receive(script, FOREIGN_READ)
    assert core.unsolicited.foreign_request is not None
    assert core.unsolicited.foreign_request.reply_until == pytest.approx(at + 0.5)


def test_an_adapter_that_echoes_although_it_did_not_before_is_noticed_at_the_first_echo() -> None:
    """The adapter was exchanged without a loss of the port: its first read fails, and the next one succeeds."""
    script = BusScript(make_core(1, has_line_timing=False, echo="detect"), wire_to(FakeStation()))
    script.submit(read_request(), "plain")
    assert script.result("plain").error is None and script.core.echo.ruled_out
    plain = script.wire
    script.wire = lambda frame, ended_at: [(ended_at, frame), *plain(frame, ended_at)]
    script.submit(read_request(), "first echo")
    script.run_until(script.now + 0.1)
    assert script.core.echo.state is EchoState.ON and not script.core.echo.ruled_out
    script.submit(read_request(register=0x3100), "second echo")
    assert script.result("second echo").error is None


def test_an_acknowledgement_that_may_be_our_own_echo_is_not_accepted_and_says_so() -> None:
    script = BusScript(make_core(1, echo="off"), lambda frame, ended_at: [(ended_at + 0.02, frame)])
    request = modbus.Diagnostics(1, 0x1234)
    script.submit(replace(read_request(), request=request), "loop-back")
    error = script.result("loop-back").error
    assert error is not None and not isinstance(error, LineError) and getattr(error, "key", "") == "bus.own_echo"
    assert not getattr(error, "retryable", True) and script.frames.count(CODEC.encode_request(request)) == 1


def test_the_reply_to_a_read_is_the_last_frame_of_its_station() -> None:
    script = online(1)
    assert bytes(script.core.stations[1].last_frame) == script.results[1][-1].received
    assert script.core.stations[1].last_request == read()


def test_a_late_acknowledgement_of_an_unknown_write_leaves_the_named_failure_of_its_station() -> None:
    """Nothing is known of its lateness, and the requests that wait still learn which bytes came before."""
    script = online(1)
    make_suspect(script, 1)
    receive(script, b"\x55\x66")
    named = script.core.stations[1].failure_reason
    receive(script, CODEC.encode_request(modbus.WriteRegister(1, 0x2001, 5)))
    assert [event.kind for event in script.traced] == [TraceKind.UNSOLICITED, TraceKind.LATE]
    assert named is not None and script.core.stations[1].failure_reason is named


def test_a_reply_that_comes_later_than_any_reply_still_names_its_lateness() -> None:
    """The last request to an offline station was a sync probe; the station was switched off while it replied."""
    script = online(1)
    make_suspect(script, 1)
    script.wire = lambda frame, ended_at: []
    script.run_until(script.now + 20.0)
    count = len(script.sent)
    while len(script.sent) == count:
        script._step(script._next_at())
    station = script.core.stations[1]
    sent_at = station.last_request_sent_at
    late = CODEC.encode_reply(modbus.DiagnosticsReply(1, station.last_request.data))
    script.receive(late, at=sent_at + 6.0)
    script.run_until(sent_at + 6.1)
    reason = station.failure_reason
    assert isinstance(reason, NoReply) and reason.key == "bus.late_reply"
    assert reason.params["milliseconds"] == 6000


def test_a_request_of_another_master_is_not_joined_with_the_bytes_before_it() -> None:
    """Both together would be a write of four registers with a right checksum."""
    script = online(1)
    head = bytes.fromhex("11 10 01 00 00 04 08 71 42")
    assert isinstance(CODEC.decode_request(head + READ_OF_STRANGER), Complete)
    receive(script, head)
    script.traced.clear()
    script.receive(READ_OF_STRANGER, at=script.now + 0.01)
    script.run_until(script.now + 0.02)
    assert [(event.kind, event.data) for event in script.traced] == [(TraceKind.FOREIGN_REQUEST, READ_OF_STRANGER)]


def test_bytes_behind_a_request_of_another_master_do_not_make_it_a_late_reply() -> None:
    """The request and the bytes after it would together be a reply to it with a right checksum."""
    script = online(1)
    make_suspect(script, 1)
    script.core.stations[1].last_request = modbus.Diagnostics(1, 0xA500)
    request = CODEC.encode_request(modbus.ReadRegisters(1, 0x0801, 4))
    behind = build_frame(request + bytes(3))[len(request) :]
    receive(script, request + behind)
    assert [event.kind for event in script.traced] == [TraceKind.FOREIGN_REQUEST, TraceKind.UNSOLICITED]


def test_the_reply_of_a_huanyang_drive_to_a_stop_that_is_not_trusted_is_no_request_of_another_master() -> None:
    """It has the form of a request: the drive repeats function and length, with the bits of its state."""
    dialect = create_dialect(profiles.load("huanyang_hy"), 1)
    core = BusCore(SETTINGS, echo="off")
    core.registry.add(dialect.station_config)
    core.scheduler.mark_suspect(core.stations[1], 0.0)
    reply = dialect.codec.encode_reply(HuanyangReply(1, CONTROL, 0, 0, 1))
    script = BusScript(core, lambda frame, ended_at: [(ended_at + 0.02, reply)])
    script.submit(replace(stop_request(), request=dialect.stop(StopMode.STOP)[0]), "stop")
    assert getattr(script.result("stop").error, "key", "") == "bus.suspect"
    assert core.counters.events == {}
