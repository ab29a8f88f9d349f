"""Unsolicited bytes (late, second, foreign, noise) are counted by kind and never applied."""

from __future__ import annotations

import random

import pytest

from drivebus import profiles
from drivebus.bus import TraceKind
from drivebus.bus.core import BusCore
from drivebus.bus.messages import BusRequest
from drivebus.bus.station import StationState
from drivebus.drives.dialects.base import StopMode
from drivebus.drives.dialects.create import create_dialect
from drivebus.protocols import modbus
from drivebus.testing.bus_script import BusScript
from fixtures.bus import CHARACTER_S, CODEC, SETTINGS, FakeStation, make_core, make_script, read, read_request


def test_two_foreign_requests_are_a_foreign_master_until_a_minute_without_one() -> None:
    """It is reported after two frames."""
    script = BusScript(make_core(1))
    script.run_until(1.0)
    frame = CODEC.encode_request(modbus.ReadRegisters(17, 0x100, 2))
    script.receive(frame, at=1.1)
    script.run_until(1.2)
    assert not script.core.health(1, script.now).foreign_master
    script.receive(frame, at=1.3)
    script.run_until(1.4)
    assert script.core.health(1, script.now).foreign_master
    assert script.core.counters.events["foreign_request"] == 2
    script.run_until(70)
    assert not script.core.health(1, script.now).foreign_master


def test_a_second_drivebus_that_sends_the_same_frames_is_a_foreign_master() -> None:
    script = make_script(FakeStation())
    script.submit(read_request())
    script.result()
    for number in range(2):
        script.receive(CODEC.encode_request(read()), at=script.now + 0.1 + 0.1 * number)
    script.run_until(script.now + 0.5)
    assert script.core.health(1, script.now).foreign_master


def test_the_reply_to_a_foreign_request_is_not_called_a_duplicate() -> None:
    script = make_script(FakeStation())
    script.submit(read_request())
    script.result()
    for number in range(4):
        at = script.now + 0.1
        script.receive(CODEC.encode_request(read()), at=at)
        script.receive(CODEC.encode_reply(modbus.RegisterValues(1, 3, (number,) * 4)), at=at + CHARACTER_S)
        script.run_until(at + 0.1)
    health = script.core.health(1, script.now)
    assert health.foreign_master and not health.duplicate_address


def test_an_unsolicited_reply_shows_another_master_while_we_wait() -> None:
    script = BusScript(make_core(1))
    for number in range(2):
        script.run_until(script.now + 1)
        script.submit(read_request(), number)
        script.receive(CODEC.encode_reply(modbus.RegisterValues(99, 3, (1, 1, 1, 1))), at=script.now + 0.03)
        script.result(number)
    assert script.core.health(1, script.now).foreign_master


def test_a_second_reply_while_idle_is_counted_and_makes_suspect() -> None:
    script = make_script(FakeStation())
    script.core.tracing = True
    script.submit(read_request())
    result = script.result()
    script.receive(result.received, at=script.now + 0.05)
    script.run_until(script.now + 0.1)
    assert script.core.counters.events["duplicate"] == 1
    assert script.core.stations[1].state.is_suspect
    assert [event.kind for event in script.traced] == [TraceKind.SENT, TraceKind.REPLY, TraceKind.DUPLICATE]
    script.run_until(script.now + 2)
    assert not script.core.stations[1].state.is_suspect, "its sync probe was answered"


def test_noise_is_counted_and_discarded() -> None:
    script = make_script(FakeStation())
    for number in range(50):
        script.receive(b"\xff\x00", at=number * 0.1)
    script.run_until(10)
    assert script.core.counters.events == {"unsolicited": 50}
    assert len(script.core.unsolicited.buffer) == 0
    script.submit(read_request())
    assert script.result().error is None


def test_unsolicited_bytes_use_bounded_memory() -> None:
    script = BusScript(make_core(1))
    chance = random.Random(1)
    at = 0.0
    for _ in range(3000):
        at += CHARACTER_S
        script.receive(chance.randbytes(8), at=at)
    script.run_until(at)
    assert len(script.core.unsolicited.buffer) <= 512


def test_the_gap_counts_from_the_last_byte_received_of_any_sender() -> None:
    """The next frame is sent 3.5 characters after the end of foreign traffic."""
    script = make_script(FakeStation())
    script.run_until(1.0)
    script.receive(b"\x55")
    script.run_until(1.0 + CHARACTER_S)
    script.receive(b"\x55")
    script.submit(read_request())
    script.result()
    assert script.sent[0][0] == pytest.approx(1.0 + CHARACTER_S + 3.5 * CHARACTER_S)


def test_a_foreign_request_that_comes_while_we_wait_is_recognized() -> None:
    """The bus has no idle time."""
    script = BusScript(make_core(1))
    foreign = CODEC.encode_request(modbus.ReadRegisters(9, 0x100, 2))
    for number in range(2):
        script.run_until(script.now + 2)
        script.submit(read_request(), number)
        script.receive(foreign, at=script.now + 0.03)
        script.result(number)
    assert script.core.health(1, script.now).foreign_master


@pytest.mark.parametrize("waiting", [True, False])
def test_a_late_mirrored_reply_is_late_and_no_foreign_master(waiting: bool) -> None:
    """The reply of FC06 is a valid request too; from a suspect station it is a late reply."""
    script = BusScript(make_core(1))
    late = CODEC.encode_reply(modbus.WriteAck(1, 6, 0x2001, 1000))
    script.submit(read_request())
    for _ in range(3):
        script.core.stations[1].state = StationState.SUSPECT
        if waiting:
            script.run_until(script.now + 1)
            script.receive(late, at=script.now + 0.001)
        else:
            script.receive(late, at=script.now + 1)
        script.run_until(script.now + 1)
    assert not script.core.health(1, script.now).foreign_master
    assert script.core.counters.events["late"] >= 2
    assert "foreign_request" not in script.core.counters.events


@pytest.mark.parametrize("model", ["c320", "dzb100", "vc660", "df800"])
@pytest.mark.parametrize("address", [1, 2])
@pytest.mark.parametrize("waiting", [True, False])
def test_a_foreign_master_is_detected_in_every_family_also_while_a_station_is_suspect(
    model: str, address: int, waiting: bool
) -> None:
    """A foreign request may address the very station that is silent; no bytes may end the bus."""
    ours, other = (create_dialect(profiles.load(model), number) for number in (1, address))
    bus = BusCore(SETTINGS, echo="off")
    bus.registry.add(ours.station_config)
    script = BusScript(bus)
    script.submit(BusRequest(station=1, request=ours.echo_test_read()), "silent")
    script.result("silent")
    assert bus.stations[1].state.is_suspect
    foreign = other.codec.encode_request(other.echo_test_read())
    for _ in range(2):
        if waiting:
            script.submit(BusRequest(station=1, request=ours.stop(StopMode.STOP)[0]), "stop")
            script.run_until(script.now + 0.05)
        script.receive(foreign)
        script.run_until(script.now + 2.0)
    assert bus.health(1, script.now).foreign_master
