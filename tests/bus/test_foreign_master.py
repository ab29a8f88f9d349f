"""A second master polls our stations: the reply to its request is never taken for the reply to ours."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus.core import BusCore
from drivebus.bus.messages import BusRequest
from drivebus.bus.unsolicited import MAX_FOREIGN_REPLY_WAIT_S, MAX_FRAGMENT_PAUSE_S
from drivebus.drives.dialects.base import StopMode
from drivebus.drives.dialects.create import create_dialect
from drivebus.protocols import modbus
from drivebus.protocols.modbus import RegisterValues
from drivebus.testing.bus_script import BusScript
from fixtures.bus import (
    CHARACTER_S,
    CODEC,
    SETTINGS,
    TIMING,
    FakeStation,
    byte_by_byte,
    make_core,
    make_script,
    read_request,
    stop_request,
    wire_to,
)

FOREIGN_READ = modbus.ReadRegisters(1, 0x0100, 2)
FOREIGN_REPLY_S = 0.015
REPLY_TIMEOUT_S = TIMING.timeout_s(SETTINGS, CODEC.largest_reply(FOREIGN_READ))


class NumberedStation(FakeStation):
    """Station each of whose registers holds its own number; it answers only one request at a time."""

    busy_until = -1.0

    def reply_to(self, frame: bytes, ended_at: float) -> bytes | None:
        return None if ended_at < self.busy_until else super().reply_to(frame, ended_at)

    def _obey(self, request: Any) -> Any:
        if isinstance(request, modbus.ReadRegisters):
            return RegisterValues(self.address, 3, tuple(range(request.register, request.register + request.count)))
        return super()._obey(request)


def online(*stations: NumberedStation, **options: Any) -> BusScript:
    """Return the script of a bus whose stations have answered once."""
    script = make_script(*stations, **options)
    for station in stations:
        script.submit(read_request(station.address, count=2), f"first of {station.address}")
        assert script.result(f"first of {station.address}").error is None
    script.run()
    return script


def foreign_request(script: BusScript, station: NumberedStation, *, replies: bool = True) -> float:
    """Let another master read the station now; return the time of the request's last bit."""
    frame = CODEC.encode_request(FOREIGN_READ)
    ended_at = script.now + len(frame) * CHARACTER_S
    reply = station.reply_to(frame, ended_at)
    assert reply is not None
    replied_at = ended_at + FOREIGN_REPLY_S + len(reply) * CHARACTER_S
    station.busy_until = replied_at
    script.receive(frame, at=ended_at)
    if replies:
        script.receive(reply, at=replied_at)
    script.run_until(ended_at)
    return ended_at


@pytest.mark.parametrize("has_line_timing", [True, False])
def test_the_reply_to_another_masters_read_of_the_same_length_is_not_the_reply_to_ours(has_line_timing: bool) -> None:
    """Our read left between the other request and its reply, and its values were those of register 100H."""
    station = NumberedStation()
    script = online(station, has_line_timing=has_line_timing)
    foreign_request(script, station)
    script.submit(read_request(count=2), "ours")
    result = script.result("ours")
    assert result.error is None and result.reply.values == (0x3000, 0x3001)
    assert script.core.counters.events == {"foreign_request": 1, "foreign": 1}


def test_a_stop_does_not_wait_for_that_reply_which_does_not_acknowledge_it() -> None:
    """The other master stops the same drive: the reply to its stop equals the reply to ours, which was lost."""
    station = NumberedStation()
    script = online(station)
    frame = CODEC.encode_request(stop_request().request)
    script.receive(frame, at=script.now + len(frame) * CHARACTER_S)
    script.run_until(script.now + len(frame) * CHARACTER_S)
    asked_at = script.now
    script.wire = lambda sent, ended_at: [(ended_at + FOREIGN_REPLY_S, frame)]
    script.submit(stop_request(), "stop")
    result = script.result("stop")
    stops = [at for at, sent in script.sent if sent == frame]
    assert stops[0] - asked_at < 4 * CHARACTER_S
    assert result.reply is None and result.error.key == "bus.suspect"


def test_a_missing_reply_to_another_master_makes_the_station_suspect_and_delays_a_read_by_its_timeout_only() -> None:
    station, other = NumberedStation(), NumberedStation(address=2)
    script = online(station, other)
    ended_at = foreign_request(script, station, replies=False)
    script.submit(read_request(2, count=2), "other")
    assert script.result("other").error is None
    assert script.sent[-1][0] == pytest.approx(ended_at + REPLY_TIMEOUT_S)
    assert script.core.stations[1].state.is_suspect and not script.core.stations[2].state.is_suspect
    script.run_until(script.now + 1)
    assert not script.core.stations[1].state.is_suspect, "its sync probe was answered"


def test_a_reply_that_another_master_gets_too_late_is_not_the_reply_to_ours() -> None:
    station = NumberedStation()
    script = online(station)
    ended_at = foreign_request(script, station, replies=False)
    late = CODEC.encode_reply(RegisterValues(1, 3, (0x0100, 0x0101)))
    script.receive(late, at=ended_at + REPLY_TIMEOUT_S + 0.03)
    station.busy_until = ended_at + REPLY_TIMEOUT_S + 0.03
    script.submit(read_request(count=2), "ours")
    result = script.result("ours")
    assert result.error is None and result.reply.values == (0x3000, 0x3001)


def test_another_masters_request_right_behind_the_reply_to_ours_is_recognized() -> None:
    """It spoils our own transaction; the station that it addresses is another one of ours, and trusted."""
    first, second = NumberedStation(), NumberedStation(address=2)
    script = online(first, second)
    foreign = CODEC.encode_request(modbus.ReadRegisters(2, 0x0100, 2))
    wire = wire_to(first, second)

    def with_a_request_behind_it(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        script.wire = wire
        for at, reply in wire(frame, ended_at):
            foreign_end = at + (2 + len(foreign)) * CHARACTER_S
            answer = second.reply_to(foreign, foreign_end)
            assert answer is not None
            second.busy_until = foreign_end + FOREIGN_REPLY_S + len(answer) * CHARACTER_S
            yield at, reply
            yield from byte_by_byte(foreign, at + 2 * CHARACTER_S)
            yield second.busy_until, answer

    script.wire = with_a_request_behind_it
    script.submit(read_request(1, count=2), "spoiled")
    script.submit(read_request(2, count=2), "ours")
    assert script.result("ours").reply.values == (0x3000, 0x3001)
    assert script.core.counters.events["foreign_request"] == 1


def test_the_replies_to_a_second_master_after_its_usual_pause_are_no_second_drive() -> None:
    """Two drives at one address were reported, beside the other master."""
    station = NumberedStation()
    script = online(station)
    for _ in range(4):
        foreign_request(script, station)
        script.run_until(script.now + 0.1)
    health = script.core.health(1, script.now)
    assert health.foreign_master and not health.duplicate_address and not health.suspect


def test_a_second_master_that_polls_without_pause_leaves_us_our_turns() -> None:
    station, other = NumberedStation(), NumberedStation(address=2)
    script = online(station, other)
    for number in range(20):
        script.submit(read_request(2, count=2), number)
        foreign_request(script, station)
        script.run_until(script.now + 0.1)
    assert all(script.results[number][0].error is None for number in range(20))


def test_no_reply_to_another_master_is_awaited_for_longer_than_half_the_time_of_a_frame() -> None:
    slow = make_core(1, timing=TIMING.__class__(reply_delay_s=3.0))
    script = BusScript(slow, wire_to(NumberedStation()))
    script.receive(CODEC.encode_request(FOREIGN_READ), at=1.0)
    script.run_until(1.0 + 4 * CHARACTER_S)
    script.submit(read_request(count=2))
    assert script.result().error is None
    assert script.core.stations[1].last_reply_at is not None
    assert script.sent[0][0] >= 1.0 + MAX_FOREIGN_REPLY_WAIT_S


@pytest.mark.parametrize("model", ["c320", "dzb100", "vc660", "df800", "huanyang_hy", "fr_e500"])
def test_the_wait_for_another_masters_reply_holds_in_every_family(model: str) -> None:
    dialect = create_dialect(profiles.load(model), 1)
    core = BusCore(SETTINGS, echo="off")
    core.registry.add(dialect.station_config)
    script = BusScript(core)
    script.receive(dialect.codec.encode_request(dialect.echo_test_read()), at=1.0)
    silent_at = 1.0 + core.stations[1].gap_s
    script.run_until(silent_at)
    script.submit(BusRequest(station=1, request=dialect.echo_test_read()), "ours")
    script.run_until(silent_at + 0.01)
    assert not script.sent
    script.submit(BusRequest(station=1, request=dialect.stop(StopMode.STOP)[0]), "stop")
    assert len(script.sent) == 1 and core.stations[1].state.is_suspect


@pytest.mark.parametrize("has_line_timing", [True, False])
@pytest.mark.parametrize("pause_s", [0.005, 0.01, 0.016, 0.03])
def test_the_reply_to_a_request_that_the_adapter_delivers_in_two_pieces_is_not_the_reply_to_ours(
    pause_s: float, has_line_timing: bool
) -> None:
    """The bus seemed silent between the pieces: our read left then, and its values were those of register 100H."""
    for first in range(1, 8):
        for asked_s in (0.0, 0.004, 0.006):
            station = NumberedStation()
            script = online(station, has_line_timing=has_line_timing)
            frame = CODEC.encode_request(FOREIGN_READ)
            ended_at = script.now + len(frame) * CHARACTER_S
            reply = station.reply_to(frame, ended_at)
            assert reply is not None
            station.busy_until = ended_at + FOREIGN_REPLY_S + len(reply) * CHARACTER_S
            script.receive(frame[:first], at=ended_at)
            script.receive(frame[first:], at=ended_at + pause_s)
            script.receive(reply, at=max(station.busy_until, ended_at + pause_s + CHARACTER_S))
            script.run_until(ended_at + asked_s)
            script.submit(read_request(count=2), "ours")
            result = script.result("ours")
            assert result.error is not None or result.reply.values == (0x3000, 0x3001)


def test_a_request_in_two_pieces_is_counted_as_one_of_another_master() -> None:
    station = NumberedStation()
    script = online(station)
    frame = CODEC.encode_request(FOREIGN_READ)
    for _ in range(2):
        script.receive(frame[:3], at=script.now + 0.1)
        script.receive(frame[3:], at=script.now + 0.116)
        script.run_until(script.now + 1.0)
    assert script.core.health(1, script.now).foreign_master


def test_two_pieces_that_come_far_apart_are_no_request() -> None:
    station = NumberedStation()
    script = online(station)
    frame = CODEC.encode_request(FOREIGN_READ)
    for _ in range(2):
        script.receive(frame[:3], at=script.now + 0.1)
        script.receive(frame[3:], at=script.now + 0.1 + 2 * MAX_FRAGMENT_PAUSE_S)
        script.run_until(script.now + 1.0)
    assert not script.core.health(1, script.now).foreign_master
