"""Port that is not open, lost or opened again: nothing of before goes on, and what was on the wire is counted."""

from __future__ import annotations

import pytest

from drivebus.bus import Presence
from drivebus.bus.commands import DeliverResult
from drivebus.errors import PortLost
from drivebus.protocols import modbus
from drivebus.testing.bus_script import BusScript
from fixtures.bus import CHARACTER_S, CODEC, FakeStation, make_core, make_script, read_request, stop_request

LOST = PortLost("ports.lost", port="test", reason=PortLost("ports.pulled"))
FOREIGN_READ = CODEC.encode_request(modbus.ReadRegisters(1, 0x0100, 2))


def test_a_request_before_the_port_is_open_fails_and_says_so() -> None:
    core = make_core()
    [command] = core.submit(read_request(), "early", 1.0)
    assert isinstance(command, DeliverResult) and isinstance(command.result.error, PortLost)
    assert command.result.error.key == "bus.not_open" and core.wake_at is None
    assert core.statistics(1.0).load_percent == 0


def test_a_lost_port_makes_an_online_station_offline_and_a_station_never_seen_stays_so() -> None:
    script = make_script(FakeStation(address=1), FakeStation(address=2))
    script.submit(read_request(1))
    script.result()
    script.lose_port(LOST)
    assert [script.core.presence(address) for address in (1, 2)] == [Presence.OFFLINE, Presence.NEVER_SEEN]


def test_each_loss_of_the_port_is_one_contact_loss_of_every_station() -> None:
    script = make_script(FakeStation(address=1), FakeStation(address=2))
    for count in (1, 2):
        script.lose_port(LOST)
        script.reopen()
        assert [station.contact_losses for station in script.core.stations.values()] == [count, count]


def test_the_bytes_of_a_transaction_that_the_loss_of_the_port_ended_are_counted() -> None:
    script = make_script(FakeStation())
    script.submit(read_request(), "lost")
    script.receive(b"\x01", at=0.02)
    script.run_until(0.021)
    script.lose_port(LOST)
    assert script.results["lost"][-1].received == b"\x01"
    assert script.core.stations[1].counters.bytes_received == 1
    assert script.core.statistics(0.021).stations[1].occupied_percent > 0


def test_bytes_of_before_the_loss_are_no_part_of_a_frame_after_it() -> None:
    script = BusScript(make_core(1))
    script.core.tracing = True
    script.receive(FOREIGN_READ[:5], at=1.0)
    script.run_until(1.0)
    script.lose_port(LOST)
    script.reopen()
    script.receive(FOREIGN_READ[5:])
    script.run_until(1.0 + 10 * CHARACTER_S)
    assert [event.data for event in script.traced] == [FOREIGN_READ[5:]]


def test_a_reply_that_was_due_to_another_master_before_the_loss_delays_nothing_after_it() -> None:
    script = BusScript(make_core(1))
    script.receive(FOREIGN_READ, at=1.0)
    script.run_until(1.0 + 4 * CHARACTER_S)
    assert script.core.unsolicited.foreign_request is not None
    script.lose_port(LOST)
    script.reopen()
    assert script.core.unsolicited.foreign_request is None


def test_what_a_frame_has_waited_for_silence_before_the_loss_does_not_count_after_it() -> None:
    """On a bus that is never silent a frame fails after a second; what another has waited before does not count."""
    script = make_script(FakeStation())
    for number in range(200):
        script.receive(b"\xff", at=number * CHARACTER_S)
    script.run_until(0.1)
    script.submit(read_request(), "before")
    script.run_until(0.15)
    script.lose_port(LOST)
    script.run_until(5.0)
    script.reopen()
    script.submit(read_request(), "after")
    assert script.result("after").error is None and "no_silence" not in script.core.counters.events


def test_what_a_stop_has_waited_for_silence_before_the_loss_does_not_count_after_it() -> None:
    """It waits for 64 characters on a bus that is never silent; what it has waited before the loss does not count."""
    script = make_script(FakeStation())
    noise = [(number * CHARACTER_S / 2, b"\xff") for number in range(3000)]
    for at, data in noise:
        script.receive(data, at=at)
    script.run_until(0.1)
    script.submit(stop_request(), "before")
    script.run_until(0.1 + 60 * CHARACTER_S)
    script.lose_port(LOST)
    for at, data in noise:
        if at > script.now:
            script.receive(data, at=at)
    lost_at, count = script.now, len(script.sent)
    script.reopen()
    script.submit(stop_request(), "after")
    script.run_until(lost_at + 0.5)
    assert count == 0 and script.sent[0][0] - lost_at == pytest.approx(67.5 * CHARACTER_S, abs=CHARACTER_S)


def test_the_first_frame_is_sent_a_gap_after_the_port_was_opened() -> None:
    script = make_script(FakeStation())
    script.submit(read_request())
    script.run()
    assert script.sent[0][0] == pytest.approx(3.5 * CHARACTER_S)
