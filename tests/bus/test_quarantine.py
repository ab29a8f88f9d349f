"""Quarantine and sync probe after a timeout: no late reply is accepted for another request."""

from __future__ import annotations

import random
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import pytest

from drivebus.bus import Poll, Presence
from drivebus.bus.core import BusCore
from drivebus.errors import DrivebusError, NoReply, PortLost
from drivebus.protocols import modbus
from drivebus.testing.bus_script import BusScript
from fixtures.bus import (
    CHARACTER_S,
    CODEC,
    DELIVERIES,
    SETTINGS,
    TIMING,
    FakeStation,
    byte_by_byte,
    make_core,
    make_script,
    read,
    read_request,
    station_config,
    whole,
    wire_to,
)

TIMEOUT = TIMING.timeout_s(SETTINGS, 13)


def test_after_a_timeout_a_station_must_answer_a_sync_probe_before_its_next_request() -> None:
    station = FakeStation()
    script = make_script(station)
    script.submit(read_request(), "first")
    script.result("first")
    station.alive = False
    script.submit(read_request(), "second")
    sent_at = script.now
    script.run_until(sent_at + 0.1)
    station.alive = True
    result = script.result("second")
    assert result.error is None and result.attempts == 2
    (lost_at, lost), (probe_at, probe), (_, again) = script.sent[1:]
    assert probe[1] == 8 and again == lost
    assert probe_at - lost_at == pytest.approx(8 * CHARACTER_S + TIMEOUT + TIMING.max_reply_lateness_s)


def test_other_stations_are_served_during_a_quarantine() -> None:
    stations = [FakeStation(address=1), FakeStation(address=2)]
    script = make_script(*stations)
    for address in (1, 2):
        script.submit(read_request(address), address)
    script.result(2)
    stations[0].alive = False
    script.submit(read_request(1), "lost")
    script.run_until(script.now + 0.1)
    script.submit(read_request(2), "other")
    submitted_at = script.now
    assert script.result("other").error is None
    assert script.now - submitted_at < 0.05


def test_a_late_reply_is_not_accepted_for_the_next_request() -> None:
    """As in the test of pymodbus, the reply to the first read comes during the second."""
    station = FakeStation()
    script = make_script(station)
    script.submit(read_request(), "first")
    script.result("first")
    station.alive = False
    script.submit(read_request(register=0x1000), "a")
    script.submit(read_request(register=0x2002), "b")
    late_at = script.now + TIMEOUT + 0.02
    script.receive(CODEC.encode_reply(modbus.RegisterValues(1, 3, (666,) * 4)), at=late_at)
    script.run_until(late_at + 0.01)
    station.alive = True
    for token in ("a", "b"):
        assert 666 not in script.result(token).reply.values
    assert script.core.counters.events["late"] == 1


def test_a_late_reply_received_during_another_stations_turn_is_counted_late() -> None:
    stations = [FakeStation(address=1), FakeStation(address=2, delay_s=0.019)]
    script = make_script(*stations)
    for address in (1, 2):
        script.submit(read_request(address), address)
    script.result(2)
    stations[0].alive = False
    script.submit(read_request(1), "lost")
    script.run_until(script.now + 0.075)
    script.submit(read_request(2), "other")
    script.receive(
        CODEC.encode_reply(modbus.RegisterValues(1, 3, (666,) * 4)), at=script.now + 8 * CHARACTER_S + 0.0145
    )
    assert script.result("other").reply.values[0] != 666
    assert script.core.counters.events.get("late") == 1
    assert script.core.stations[1].counters.events == {"late": 1}


def test_an_unanswered_sync_probe_takes_the_station_offline_and_fails_waiting_requests() -> None:
    station = FakeStation()
    script = make_script(station)
    script.submit(read_request(), "first")
    script.result("first")
    station.alive = False
    script.submit(read_request(), "second")
    result = script.result("second")
    assert isinstance(result.error, NoReply) and result.error.key == "bus.offline"
    assert script.core.presence(1) is Presence.OFFLINE


def noisy_script(station: FakeStation) -> BusScript:
    """Return a script after a read whose reply had a stray byte before it."""
    script = BusScript(make_core(1), wire_to(station, deliver=lambda reply, at: whole(b"\x00" + reply, at)))
    script.submit(read_request(), "noisy")
    script.result("noisy")
    return script


def errors_of_two_reads(script: BusScript) -> list[Any]:
    for token in ("a", "b"):
        script.submit(read_request(), token)
    return [script.result(token).error for token in ("a", "b")]


def test_requests_that_wait_for_one_sync_probe_have_an_error_each() -> None:
    """The receiver of an error adds the outcome of its own command to it."""
    first, second = errors_of_two_reads(noisy_script(FakeStation()))
    assert first.key == second.key == "bus.stray_before" and first.params == second.params
    assert first is not second


@pytest.mark.parametrize(("port_lost", "key"), [(False, "bus.stray_before"), (True, "bus.offline")])
def test_the_bytes_before_a_lost_port_do_not_name_the_failure_after_it(port_lost: bool, key: str) -> None:
    station = FakeStation()
    script = noisy_script(station)
    station.alive = False
    if port_lost:
        script.lose_port(PortLost("bus.closed"))
        script.reopen()
    assert [error.key for error in errors_of_two_reads(script)] == [key, key]


def test_two_sync_probes_in_a_row_are_never_the_same() -> None:
    station = FakeStation()
    script = make_script(station)
    script.submit(read_request(), "first")
    script.result("first")
    station.alive = False
    script.run_until(script.now + 1)
    script.submit(read_request(), "second")
    script.run_until(script.now + 20)
    probes = [frame for frame in script.frames if frame[1] == 8]
    assert len(probes) >= 4 and len(set(probes)) == len(probes)


def test_the_reply_to_another_request_makes_the_station_suspect() -> None:
    """Another count means an older reply; its own is still on its way, so there is no retry before the sync probe."""
    station = FakeStation()
    script = make_script(station)
    script.submit(read_request(), "first")
    script.result("first")
    station.alive = False
    script.submit(read_request(count=2), "second")
    script.receive(
        CODEC.encode_reply(modbus.RegisterValues(1, 3, (6, 6, 6, 6))),
        at=script.now + 8 * CHARACTER_S + 20 * CHARACTER_S,
    )
    script.run_until(script.now + 0.06)
    assert script.core.stations[1].state.is_suspect and len(script.sent) == 2


def test_an_offline_station_that_rejects_its_sync_probes_is_not_called_silent_until_one_counts() -> None:
    station = FakeStation()
    script = make_script(station)
    station.alive = False
    script.submit(read_request(), "lost")
    script.result("lost")
    inner, shown = wire_to(station), []

    def refuses_loopbacks(frame: bytes, ended: float) -> Iterable[tuple[float, bytes]]:
        error: Any = script.core.unusable_reply(1)
        shown.append(error and error.key)
        return (
            [(ended + 0.02, CODEC.encode_reply(modbus.ExceptionReply(1, 8, 1)))]
            if frame[1] == 8
            else inner(frame, ended)
        )

    station.alive = True
    script.wire = refuses_loopbacks
    script.submit(read_request(), "next")
    assert script.result("next").error is None
    assert shown == [None, "bus.sync_rejected", "bus.sync_rejected", None]


def counting() -> BusCore:
    """Return a bus with a DF800, whose sync probe differs from other reads only in its register count."""
    bus = BusCore(SETTINGS, echo="off")
    bus.registry.add(replace(station_config(1), sync_request=lambda n: read(1, 0x3000 + 2 * (n % 8), 2)))
    return bus


def registers(*values: int) -> bytes:
    return CODEC.encode_reply(modbus.RegisterValues(1, 3, values))


def test_the_late_reply_to_a_users_read_is_not_taken_for_that_of_a_sync_probe() -> None:
    """A user's read of two registers times out; its reply comes while the sync probe, of two as well, waits.

    Found by the campaign ``late`` (seed 1, df800-rtu/10): only older sync probes were remembered, not older requests.
    """
    station = FakeStation()
    script = BusScript(counting(), wire_to(station))
    script.submit(read_request(count=4), "first")
    script.result("first")
    station.alive = False
    script.submit(read_request(register=0x3020, count=2), "own")
    submitted_at = script.now
    script.run_until(submitted_at + 8 * CHARACTER_S + TIMEOUT + TIMING.max_reply_lateness_s + 0.001)
    probe_at, probe = script.sent[2]
    assert probe[1] == 3 and probe[5] == 2
    script.receive(registers(7, 7), at=probe_at + 8 * CHARACTER_S + 0.01)
    script.run_until(probe_at + 0.09)
    assert script.core.stations[1].state.is_suspect
    shown: Any = script.core.stations[1].unusable_reply
    assert (shown.key, shown.params["seconds"]) == ("bus.sync_ambiguous", 5.0)
    station.alive = True
    script.run_until(probe_at + 5.0)
    assert len(script.sent) == 3, "a sync probe proves nothing while an older reply may match it"
    script.run_until(probe_at + 5.3)
    assert not script.core.stations[1].state.is_suspect and script.sent[3][0] > probe_at + 5.0
    assert script.core.stations[1].unusable_reply is None


@pytest.mark.parametrize("waits", [True, False])
def test_a_read_that_does_not_wait_in_a_quarantine_fails_where_a_sync_probe_proves_nothing(
    waits: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stop that waits for such a read could not be sent again for 5 s; any other read is served after them."""
    station = FakeStation()
    script = make_script(station)
    script.submit(read_request(), "first")
    script.result("first")
    script.core.scheduler.mark_suspect(script.core.stations[1], script.now)
    monkeypatch.setattr("drivebus.bus.core._matches_older_request", lambda transaction: True)
    script.submit(replace(read_request(), waits_in_quarantine=waits), "second")
    script.run_until(script.now + TIMING.max_reply_lateness_s + TIMEOUT)
    if waits:
        assert "second" not in script.results
        monkeypatch.undo()
        assert script.result("second").error is None
    else:
        error = script.result("second").error
        assert isinstance(error, DrivebusError) and error.key == "bus.sync_ambiguous"


def test_the_late_reply_to_an_untrusted_sync_probe_is_not_taken_for_the_next_ones() -> None:
    """The second sync probe gets the reply of the first; its own still comes and must not be accepted for the third."""
    station = FakeStation()
    script = BusScript(counting(), wire_to(station))
    script.submit(read_request(count=4), "first")
    script.result("first")
    station.alive = False
    script.submit(read_request(count=4), "lost")
    script.run_until(script.now + 0.5)
    while len(script.sent) < 4:
        script.run_until(script.now + 0.002)
    second_at = script.sent[3][0]
    script.receive(registers(7, 7), at=second_at + 8 * CHARACTER_S + 0.01)
    script.run_until(second_at + 4.9)
    assert len(script.sent) == 4 and script.core.stations[1].state.is_suspect
    station.alive = True
    script.run_until(second_at + 6.0)
    assert not script.core.stations[1].state.is_suspect and script.sent[4][0] > second_at + 5.0


class LateStation(FakeStation):
    """Station that replies in order, with some replies late by up to ``longest_s``."""

    def __init__(self, address: int, chance: random.Random, share: float, longest_s: float) -> None:
        super().__init__(address=address)
        self.chance, self.share, self.longest_s, self.free_at = chance, share, longest_s, 0.0

    def speak(self, frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        reply = self.reply_to(frame, ended_at)
        if reply is None:
            return []
        begins = ended_at + (self.chance.random() * self.longest_s if self.chance.random() < self.share else 0.004)
        begins = max(begins, self.free_at)
        pieces = list((whole if self.chance.random() < 0.5 else byte_by_byte)(reply, begins))
        self.free_at = pieces[-1][0] + 4 * CHARACTER_S
        return pieces


@pytest.mark.parametrize(
    ("share", "longest_s", "seed"), [(0.01, 0.3, 4), (0.05, 0.3, 8), (0.2, 0.3, 23), (0.2, 5.0, 70), (0.2, 1.0, 3)]
)
@pytest.mark.parametrize(("paced", "sync_kind"), [(True, "nonce"), (False, "nonce"), (False, "count")])
def test_no_late_reply_is_ever_misattributed(
    share: float, longest_s: float, paced: bool, sync_kind: str, seed: int
) -> None:
    """Same-shaped reads back to back, each value names its request; lateness up to 5 s, in order.

    The sync probes are those of VC660 (a loop-back with a nonce) and of DF800 (a read with its own count). Seed 70 with
    counts once took the late reply of an older sync probe for that of a newer one; seed 3 repeated a read at once
    after damaged bytes that belonged to another reply.
    """
    chance = random.Random(seed)
    stations = [LateStation(address, chance, share, longest_s) for address in (1, 2, 3)]
    for station in stations:
        station.registers = {register: register for register in range(0x3000, 0x3040)}

    def line(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        return [piece for station in stations for piece in station.speak(frame, ended_at)]

    bus = BusCore(SETTINGS, has_line_timing=paced, echo="off")
    for station in stations:
        with_nonce = station_config(station.address)
        with_count = replace(with_nonce, sync_request=lambda n, a=station.address: read(a, 0x3000 + 2 * (n % 8), 2))
        bus.registry.add(with_nonce if sync_kind == "nonce" else with_count)
    script = BusScript(bus, line)
    registers: dict[int, int] = {}
    for number in range(2500):
        register = 0x3000 + 4 * chance.randrange(16)
        registers[number] = register
        script.submit(read_request(1 + number % 3, register), number)
        if number % 5 == 4:
            script.result(number)
    script.run_until(script.now + 60)
    answered = 0
    for number, register in registers.items():
        reply = script.results[number][0].reply
        if reply is not None:
            answered += 1
            assert reply.values == tuple(range(register, register + 4)), number
    assert answered > (1500 if longest_s < 1 else 40)


@pytest.mark.parametrize("line", DELIVERIES)
def test_polls_keep_coming_on_every_line(line: str) -> None:
    stations = [FakeStation(address=1), FakeStation(address=2)]
    script = make_script(*stations, deliver=DELIVERIES[line]())
    for station in stations:
        script.start_polling(station.address, [Poll(read(station.address), 0.1)], station.address)
    script.run_until(60)
    for station in stations:
        accepted = [result for result in script.results[station.address] if result.error is None]
        assert len(accepted) > (550 if line in ("clean", "byte by byte") else 100)


def test_two_replies_in_one_window_indicate_a_duplicate_address() -> None:

    def twice(reply: bytes, begins_at: float) -> Iterable[tuple[float, bytes]]:
        yield from byte_by_byte(reply, begins_at)
        yield from byte_by_byte(reply, begins_at + (len(reply) + 2) * CHARACTER_S)

    script = BusScript(make_core(1), wire_to(FakeStation(), deliver=twice))
    for number in range(3):
        script.submit(read_request(), number)
        script.result(number)
    assert script.core.health(1, script.now).duplicate_address
    assert script.core.counters.events["duplicate"] >= 2
    assert all(script.results[number][0].reply is None for number in range(3))


def test_a_rejected_sync_probe_proves_nothing_until_it_was_rejected_three_times() -> None:
    """An error reply repeats only the function, so an older error looks the same.

    A drive that rejects the request of the sync probe must nevertheless come back.
    """
    station = FakeStation()
    script = make_script(station)
    script.submit(read_request(), "first")
    script.result("first")
    script.wire = lambda frame, ended: []
    script.submit(read_request(), "second")
    script.run_until(script.now + 0.1)
    inner = wire_to(station)

    def refuses_loopbacks(frame: bytes, ended: float) -> Iterable[tuple[float, bytes]]:
        if frame[1] == 8:
            return [(ended + 0.02, CODEC.encode_reply(modbus.ExceptionReply(1, 8, 1)))]
        return inner(frame, ended)

    script.wire = refuses_loopbacks
    assert script.result("second").error is None
    assert [frame[1] for frame in script.frames] == [3, 3, 8, 8, 8, 3]
