"""Sync probe of a drive that reads one register at a time: a read of two, which it answers by exception 03."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from drivebus.bus.core import BusCore
from drivebus.protocols import modbus
from drivebus.testing.bus_script import BusScript
from fixtures.bus import SETTINGS, read_request, station_config

CODEC = modbus.ModbusRtuCodec(max_read=1, rejected_read=2)
REJECTION = CODEC.encode_reply(modbus.ExceptionReply(1, 3, 3))
PROBE = CODEC.encode_request(modbus.ReadRegisters(1, 0xFD01, 2))
LATENESS_S = 0.3
"""Quarantine of the fixture's station."""
REPLY_S = 0.01


def value(word: int) -> bytes:
    return CODEC.encode_reply(modbus.RegisterValues(1, 3, (word,)))


def answer(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
    """Answer as the drive does; its register holds 7."""
    return [(ended_at + REPLY_S, REJECTION if frame == PROBE else value(7))]


def online_script() -> BusScript:
    core = BusCore(SETTINGS, echo="off")
    probe = modbus.ReadRegisters(1, 0xFD01, 2)
    core.registry.add(replace(station_config(codec=CODEC), sync_request=lambda n: probe))
    script = BusScript(core, answer)
    script.submit(read_request(count=1), "first")
    assert script.result("first").error is None
    return script


def is_suspect(script: BusScript) -> bool:
    return script.core.stations[1].state.is_suspect


def probes(script: BusScript) -> list[float]:
    return [at for at, frame in script.sent if frame == PROBE]


def reply_values(result: Any) -> tuple[int, ...]:
    assert result.error is None
    values: tuple[int, ...] = result.reply.values
    return values


def test_one_rejection_ends_the_quarantine_and_the_read_is_repeated() -> None:
    script = online_script()
    lost = iter([True])
    script.wire = lambda frame, at: [] if next(lost, False) else answer(frame, at)
    script.submit(read_request(count=1), "read")
    assert reply_values(script.result("read")) == (7,)
    assert len(probes(script)) == 1 and not is_suspect(script)


def test_a_reply_that_comes_after_the_probe_was_sent_is_credited_to_nothing() -> None:
    """The late reply holds 9, an older value than the 7 of now."""
    script = online_script()
    late = iter([True])

    def wire(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        if frame == PROBE and next(late, False):
            return [(ended_at + 0.002, value(9)), (ended_at + REPLY_S + 0.01, REJECTION)]
        return answer(frame, ended_at) if probes(script) else []

    script.wire = wire
    script.submit(read_request(count=1), "read")
    script.run_until(script.now + 0.2 + LATENESS_S)
    assert len(probes(script)) == 1 and is_suspect(script), "the probe was not answered by its own reply alone"
    script.submit(read_request(count=1), "later")
    script.run_until(script.now + 20)
    assert not is_suspect(script)
    assert {
        result.reply.values for results in script.results.values() for result in results if result.error is None
    } == {(7,)}


def test_a_rejection_may_be_the_late_one_of_an_unanswered_probe() -> None:
    script = online_script()
    script.wire = lambda frame, at: []
    script.submit(read_request(count=1), "read")
    script.run_until(script.now + 1.0)
    assert len(probes(script)) == 1 and is_suspect(script)
    script.wire = answer
    script.submit(read_request(count=1), "soon")
    script.run_until(probes(script)[0] + 3.0)
    assert len(probes(script)) >= 2 and is_suspect(script), "two probes look alike"
    script.submit(read_request(count=1), "later")
    script.run_until(probes(script)[0] + 30.0)
    assert not is_suspect(script)
