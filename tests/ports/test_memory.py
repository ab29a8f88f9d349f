"""Two ports in memory."""

from __future__ import annotations

import asyncio
import gc

import pytest

from drivebus.errors import PortLost, PortUnavailable, PortUrlError
from drivebus.ports import open_port
from drivebus.ports.memory import create_pair
from drivebus.serial_settings import SerialSettings
from fixtures.receiver import FakeReceiver, wait_until


async def test_each_end_receives_the_bytes_that_the_other_writes() -> None:
    left, right = create_pair()
    a, b = FakeReceiver(), FakeReceiver()
    await left.open(a)
    await right.open(b)
    left.write(b"ask")
    right.write(b"answer")
    assert (a.data, b.data) == (b"", b"")  # never from within write
    await wait_until(lambda: a.data and b.data)
    assert (a.data, b.data) == (b"answer", b"ask")


async def test_with_line_timing_each_byte_arrives_at_its_last_stop_bit() -> None:
    left, right = create_pair(SerialSettings(4800, 8, "E", 1), has_line_timing=True)
    sink = FakeReceiver()
    await left.open(FakeReceiver())
    await right.open(sink)
    begun = asyncio.get_running_loop().time()
    left.write(b"ab")
    left.write(b"c")
    await wait_until(lambda: len(sink.data) == 3)
    character_s = 11 / 4800
    assert [data for _, data in sink.chunks] == [b"a", b"b", b"c"]
    for number, (at, _) in enumerate(sink.chunks, 1):
        assert at - begun >= number * character_s - 1e-6


async def test_bytes_of_an_earlier_opening_never_arrive() -> None:
    left, right = create_pair()
    sink = FakeReceiver()
    await left.open(FakeReceiver())
    await right.open(FakeReceiver())
    left.write(b"late")
    await right.close()
    await right.open(sink)
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert sink.data == b""


async def test_a_closed_port_rejects_a_write() -> None:
    left, _ = create_pair()
    with pytest.raises(PortLost) as caught:
        left.write(b"x")
    assert caught.value.key == "ports.not_open"
    await left.open(FakeReceiver())
    with pytest.raises(PortUnavailable):
        await left.open(FakeReceiver())
    await left.close()
    await left.close()
    with pytest.raises(PortLost):
        left.write(b"x")


def test_each_end_opened_by_name_has_the_echo_setting_of_its_own_url() -> None:
    """The option was accepted and ignored."""
    ends = [open_port(f"memory://echoing{query}") for query in ("?echo=on", "")]
    assert [end.echo for end in ends] == ["on", "off"]


async def test_unplug_is_reported_once_and_the_port_opens_again_after_plug() -> None:
    left, right = create_pair()
    a, b = FakeReceiver(), FakeReceiver()
    await left.open(a)
    await right.open(b)
    left.unplug()
    left.unplug()
    assert [error.params["reason"].key for error in (*a.lost, *b.lost)] == ["ports.pulled"] * 2
    with pytest.raises(PortUnavailable) as caught:
        await left.open(a)
    assert caught.value.key == "ports.memory_unplugged"
    left.plug()
    await left.open(a)
    left.write(b"x")


async def test_a_name_joins_two_ports_and_no_third() -> None:
    left = open_port("memory://yard?baud=19200")
    right = open_port("memory://yard")
    with pytest.raises(PortUrlError, match="both ends of yard are in use; use another name"):
        open_port("memory://yard")
    sink = FakeReceiver()
    await left.open(FakeReceiver())
    await right.open(sink)
    left.write(b"x")
    await wait_until(lambda: sink.data)
    assert left.settings.baud == 19200
    del left, right
    gc.collect()
    assert open_port("memory://yard").settings.baud == 9600
