"""Invariants for any requests and any bytes: one request outstanding, gaps, permits, no unexpected exception."""

from __future__ import annotations

import random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivebus.bus import Poll
from drivebus.bus.core import BusCore
from drivebus.bus.messages import BusRequest
from drivebus.errors import DrivebusError, PortLost
from drivebus.protocols import modbus
from drivebus.testing.bus_script import BusScript
from fixtures.bus import (
    CHARACTER_S,
    COMMAND,
    DELIVERIES,
    STOP,
    FakeStation,
    make_core,
    read,
    read_request,
    start_request,
    stop_request,
    wire_to,
    write_request,
)

GAP = 3.5 * CHARACTER_S


class CheckedScript(BusScript):
    """Script that checks the invariants at every frame."""

    silent_since = 0.0

    def _send(self, frame: bytes) -> None:
        transaction = self.core.transaction
        assert transaction is not None and transaction.prepared.data == frame, (
            "the frame on the wire is the one in transaction"
        )
        if self.sent:
            before_at, before = self.sent[-1]
            assert self.now >= before_at + len(before) * CHARACTER_S, "no frame is sent during another"
        effect = transaction.prepared.effect
        if effect.value in ("motion", "setting"):
            permit = transaction.prepared.permit
            assert permit is not None and permit.expires_at >= self.now, "a frame left with an expired permit"
            assert permit.stop_epoch == transaction.prepared.station.stop_epoch, "no stop since the permit"
        if transaction.prepared.priority != 0:
            assert self.now >= self.silent_since + GAP - 1e-9, "a frame left within the gap"
            assert not any(prepared.priority == 0 for prepared in self.core.scheduler.queues[0]), "a stop was waiting"
        super()._send(frame)
        self.silent_since = self.now + len(frame) * CHARACTER_S

    def _step(self, at: float) -> None:
        if self._incoming and self._incoming[0][0] <= max(self.now, at):
            self.silent_since = max(self.silent_since, at)
        super()._step(at)
        requests = [prepared for lane in self.core.scheduler.queues for prepared in lane]
        assert len(requests) == len({id(prepared) for prepared in requests})


def run_scenario(seed: int, line: str, paced: bool) -> CheckedScript:
    chance = random.Random(seed)
    stations = [FakeStation(address=address) for address in (1, 2, 3)]
    script = CheckedScript(
        make_core(1, 2, 3, has_line_timing=paced, echo="detect"), wire_to(*stations, deliver=DELIVERIES[line]())
    )
    for address in (1, 2):
        script.start_polling(address, [Poll(read(address), chance.choice([0.0, 0.1, 1.0]))], f"w{address}")
    for number in range(250):
        script.run_until(script.now + chance.random() * 0.2)
        address = chance.choice((1, 2, 3))
        match chance.randrange(12):
            case 0 | 1 | 2:
                script.submit(read_request(address), number)
            case 3 | 4:
                script.submit(write_request(script.core, address, until=script.now + chance.random()), number)
            case 5 | 6:
                script.submit(start_request(script.core, address, until=script.now + chance.random()), number)
            case 7:
                script.submit(stop_request(address), number)
            case 8:
                stations[address - 1].alive ^= True
            case 9:
                script.receive(chance.randbytes(chance.randrange(1, 30)), line_errors=chance.randrange(2))
            case 10:
                script.submit(BusRequest(station=0, request=modbus.WriteRegister(0, COMMAND, STOP)), number)
            case 11 if chance.random() < 0.2:
                script.lose_port(PortLost("ports.lost"))
                script.run_until(script.now + chance.random())
                script.reopen()
    script.run_until(script.now + 200)
    return script


@pytest.mark.parametrize("line", DELIVERIES)
@pytest.mark.parametrize("paced", [True, False])
def test_the_invariants_hold_in_random_scenarios(line: str, paced: bool) -> None:
    for seed in range(5):
        script = run_scenario(seed, line, paced)
        for token, results in script.results.items():
            assert isinstance(token, str) or len(results) == 1, "each request has exactly one result"
            for result in results:
                assert result.error is None or isinstance(result.error, DrivebusError), "an unexpected exception"
        assert len(script.core.scheduler) <= 2, "no request stays in the queues"


def test_the_same_seed_gives_the_same_scenario_to_the_last_bit() -> None:
    """The engine has no clock, no randomness and no dependence on hash order."""
    first, second = (run_scenario(42, "lossy", False).sent for _ in range(2))
    assert first == second


@given(st.lists(st.tuples(st.binary(min_size=1, max_size=24), st.floats(0.0, 0.05), st.integers(0, 1)), max_size=30))
@settings(max_examples=60)
def test_no_bytes_ever_raise_or_stop_the_bus(pieces: list[tuple[bytes, float, int]]) -> None:
    """After garbage the bus works as before."""
    station = FakeStation()
    script = BusScript(make_core(1, echo="detect"), wire_to(station))
    script.start_polling(1, [Poll(read(), 0.2)])
    at = 0.0
    for data, pause, marks in pieces:
        at += pause
        script.receive(data, at=at, line_errors=marks)
    script.run_until(at + 70)
    assert script.results["polls"][-1].error is None


def test_a_million_virtual_seconds_of_a_silent_bus_need_no_memory() -> None:
    """The memory of a silent bus does not grow."""
    script = BusScript(make_core(1, 2))
    script.recording = False
    script.start_polling(1, [Poll(read(), 1.0)])
    script.run_until(100_000)
    bus: BusCore = script.core
    assert (
        len(bus.scheduler) == 0
        and len(bus.scheduler.poll_schedule.heap) + len(bus.scheduler.poll_schedule.suspended.get(bus.stations[1], ()))
        == 1
    )
    assert len(bus.scheduler.untrusted_stations) == 1


def test_commands_execute_at_most_once_each_with_lost_frames_either_way() -> None:
    """10 % loss each way, edges never repeated, no stop lost."""
    chance = random.Random(11)
    station = FakeStation()
    inner = wire_to(station)

    def lossy(frame: bytes, ended_at: float) -> Any:
        if chance.random() < 0.1:
            return []
        replies = list(inner(frame, ended_at))
        return [] if chance.random() < 0.1 else replies

    script = BusScript(make_core(1), lossy)
    submitted = 0
    for number in range(1500):
        script.submit(start_request(script.core, until=script.now + 2), ("start", number))
        before = station.start_count
        result = script.result(("start", number))
        submitted += 1
        assert station.start_count - before <= 1
        if result.sent == b"":
            assert station.start_count == before
        script.submit(stop_request(), ("stop", number))
        script.result(("stop", number))
    assert station.start_count <= submitted
