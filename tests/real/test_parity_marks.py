"""A byte with bad parity voids its frame at any position; an FF with good parity is an ordinary byte (T10).

The far end writes the marks of a kernel with INPCK | PARMRK (termios(3)): ``FF 00 xx`` for a bad byte, ``FF FF`` for a
good FF. The marked byte has its right value, so that only the mark can void the frame; DZB100 has no other check.
Ptys have no parity, so the tests give the port its mark decoder.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.bus.messages import BusRequest
from drivebus.bus.trace import TraceEvent, TraceKind
from drivebus.drives.dialects.create import create_dialect
from drivebus.errors import LineError
from drivebus.ports import open_port, tty
from drivebus.ports.parmrk import ParityMarkDecoder
from drivebus.protocols import dzb100, modbus, sunfar
from real.recorded_bench import RecordedPlant, bus_specification

Plants = Callable[..., RecordedPlant]
FF = 0x01FF
CASES: dict[str, tuple[dict[str, Any], Any]] = {
    "c320-ascii": (bus_specification("c320", "ascii", keypad={0x002: FF}), sunfar.SunfarReadParameter(1, 0, 2)),
    "c320-hex": (bus_specification("c320", "hex", keypad={0x002: FF}), sunfar.SunfarReadParameter(1, 0, 2)),
    "dzb100": (bus_specification("dzb100", "ascii", format="8E1"), dzb100.Dzb100Query(1, 0)),
    "vc660": (bus_specification("vc660", "rtu", keypad={2: FF}), modbus.ReadRegisters(1, 2, 1)),
    "df800-rtu": (bus_specification("df800", "rtu"), modbus.ReadRegisters(1, 100, 2)),
    "df800-ascii": (bus_specification("df800", "ascii"), modbus.ReadRegisters(1, 100, 2)),
}


def host(plant: RecordedPlant, model: str, encoding: str) -> Bus:
    """Return a bus with one station whose replies may be 0.3 s late."""
    profile = profiles.load(model)
    bus = Bus(open_port(plant.url()))
    bus.add_station(
        create_dialect(
            profile, 1, encoding=encoding, timing=replace(profile.timing, adapter_latency_s=0.3)
        ).station_config
    )
    return bus


def delivered_replies(plant: RecordedPlant) -> list[tuple[str, int | None]]:
    """Return the replies as the far end delivered them, and the index of the bad byte in each."""
    plant.settle()
    return [(each["data"], each["place"]) for each in plant.read() if each["what"] == "delivered"]


@pytest.mark.parametrize("name", CASES)
async def test_a_marked_byte_voids_its_frame_at_any_position(plants: Plants, name: str) -> None:
    """The request is repeated once; a second voided reply is an error without a value."""
    specification, request = CASES[name]
    plant = plants({**specification, "marks": True})
    events: list[TraceEvent] = []
    async with host(plant, specification["model"], specification["encoding"]) as bus:
        bus.port._mark_decoder = ParityMarkDecoder()  # type: ignore[attr-defined]
        clean = await bus.transact(BusRequest(station=1, request=request))
        assert clean.error is None
        bus.trace(events.append)
        size = len(clean.received)
        for place in range(size):
            plant.order(mark=[place])
            answer = await bus.transact(BusRequest(station=1, request=request))
            assert answer.error is None and answer.reply == clean.reply
        plant.order(mark=[0, size - 1])
        answer = await bus.transact(BusRequest(station=1, request=request))
        assert isinstance(answer.error, LineError) and answer.reply is None
        voided = [event for event in events if event.kind is TraceKind.INVALID]
    assert [type(event.error) for event in voided] == [LineError] * (size + 2), "each of them, and nothing else"
    assert len([event for event in events if event.kind is TraceKind.REPLY]) == size
    places = [at for place in range(size) for at in (place, None)]
    assert [place for _, place in delivered_replies(plant)][1:] == [*places, 0, size - 1]


@pytest.mark.parametrize("name", ["c320-hex", "vc660"])
async def test_a_good_ff_survives_the_doubling(plants: Plants, name: str) -> None:
    specification, request = CASES[name]
    plant = plants({**specification, "marks": True})
    async with host(plant, specification["model"], specification["encoding"]) as bus:
        bus.port._mark_decoder = ParityMarkDecoder()  # type: ignore[attr-defined]
        answer = await bus.transact(BusRequest(station=1, request=request))
    assert value(answer.reply) == FF
    assert all("01ffff" in data for data, _ in delivered_replies(plant)), "the far end doubled it"


async def test_a_good_ff_survives_a_kernel_that_marks(plants: Plants, monkeypatch: pytest.MonkeyPatch) -> None:
    """The pty counts as a real port: INPCK | PARMRK is set and the kernel itself doubles the FF."""
    monkeypatch.setattr(tty, "is_pty", lambda _: False)
    monkeypatch.setattr(tty, "_refuse_if_in_use", lambda *_: None)
    specification, request = CASES["vc660"]
    plant = plants(specification)
    async with host(plant, "vc660", "rtu") as bus:
        assert isinstance(bus.port._mark_decoder, ParityMarkDecoder)  # type: ignore[attr-defined]
        answer = await bus.transact(BusRequest(station=1, request=request))
    assert value(answer.reply) == FF


def value(reply: Any) -> int:
    found: int = reply.values[0] if isinstance(reply, modbus.RegisterValues) else reply.data
    return found
