"""Loss and delay between drivebus and peers: every value that both sides accepted is the same on both sides (I5)."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from random import Random
from typing import Any

import pytest

from drivebus.bus.messages import BusRequest
from drivebus.protocols import modbus
from drivebus.serial_settings import StationTiming
from drivebus.simulator.bus import SimulatedBus
from fixtures.lossy_relay import LinkQuality, LossyRelay, lossy_relay
from fixtures.receiver import wait_until
from fixtures.station_bench import quick_bench, run_program
from interop.conftest import StartProgram
from interop.servers import (
    LOOPBACK_SUPPORT,
    PEER_SERIAL_SETTINGS,
    STATION,
    PeerServer,
    peer_station,
    permitted_write,
    pymodbus,
)
from peers import need_module, need_program

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="ptys as Linux has them")

BAD_LINK = LinkQuality(loss=0.1, delay=0.15, delay_s=0.15)
"""Delay of a late reply: longer than our timeout, shorter than the configured longest lateness."""
TIMING = StationTiming(gap_floor_s=0.00175, reply_delay_s=0.06, max_reply_lateness_s=0.35)
TRANSACTIONS, WRITES = 30, 20


@pytest.fixture(params=["pymodbus-rtu", "pymodbus-ascii", "libmodbus-rtu"])
def peer(request: pytest.FixtureRequest, started: StartProgram) -> Iterator[Any]:
    """Return name, encoding and the function that starts the peer on a path."""
    name, _, encoding = request.param.partition("-")
    if name == "pymodbus":
        need_module("pymodbus")
        yield name, encoding, lambda path: pymodbus(started, path, encoding)
    else:
        program: Path = request.getfixturevalue("libmodbus_server")
        yield name, encoding, lambda path: started(program, path, STATION)


@asynccontextmanager
async def our_master(peer: Any, wire: LossyRelay) -> Any:
    name, encoding, launch = peer
    server = PeerServer(name, encoding, wire.ours, lambda: launch(wire.theirs))
    await asyncio.to_thread(server.start)
    bus = server.bus(TIMING)
    bus.remove_station(STATION)
    bus.add_station(peer_station(STATION, encoding, loops=LOOPBACK_SUPPORT[name], timing=TIMING))
    async with bus:
        yield bus
    server.kill()


async def test_every_value_that_our_master_accepts_is_that_registers_value_in_the_peer(peer: Any) -> None:
    """All requests have one shape, so that a late reply would fit the next request but for its registers."""
    chance, accepted, failed = Random(7), 0, 0
    async with lossy_relay(LinkQuality()) as wire, our_master(peer, wire) as bus:
        await bus.transact(BusRequest(station=STATION, request=modbus.ReadRegisters(STATION, 0, 1)))
        wire.quality = BAD_LINK
        for _ in range(TRANSACTIONS):
            register, count = chance.randrange(100), chance.choice((1, 2, 2, 4))
            answer = await bus.transact(
                BusRequest(station=STATION, request=modbus.ReadRegisters(STATION, register, count))
            )
            if answer.error is not None:
                failed += 1
                continue
            accepted += 1
            assert answer.reply.values == tuple(range(1000 + register, 1000 + register + count))
        assert wire.lost and wire.delayed
    assert accepted > TRANSACTIONS / 4
    assert failed


async def test_every_write_that_was_acknowledged_to_our_master_is_in_the_peer(peer: Any) -> None:
    """Each register is written once with its own value, and read back at the end without loss."""
    acknowledged, refused = dict[int, int](), set[int]()
    async with lossy_relay(LinkQuality(), seed=3) as wire, our_master(peer, wire) as bus:
        await bus.transact(BusRequest(station=STATION, request=modbus.ReadRegisters(STATION, 0, 1)))
        wire.quality = BAD_LINK
        for register in range(WRITES):
            value = 0x4000 + 7 * register
            answer = await bus.transact(permitted_write(bus, modbus.WriteRegister(STATION, register, value)))
            if answer.error is None and isinstance(answer.reply, modbus.WriteAck):
                acknowledged[register] = value
            elif not answer.sent:
                refused.add(register)
        wire.quality = LinkQuality()
        await asyncio.sleep(1.0)
        for register in range(WRITES):
            found = await _read_until_answered(bus, register)
            if register in acknowledged:
                assert found == acknowledged[register]
            else:
                assert found == (1000 + register if register in refused else found)
                assert found in (1000 + register, 0x4000 + 7 * register)
    assert WRITES / 4 < len(acknowledged) < WRITES


async def _read_until_answered(bus: Any, register: int) -> int:
    for _ in range(5):
        answer = await bus.transact(BusRequest(station=STATION, request=modbus.ReadRegisters(STATION, register, 1)))
        if answer.error is None:
            return int(answer.reply.values[0])
    raise AssertionError(f"register {register} can't be read on a clean wire")


@asynccontextmanager
async def our_station(wire: LossyRelay, encoding: str = "rtu") -> Any:
    """Run a simulated VC660 (DF800 for ASCII) on the far side of the relay."""
    made = quick_bench("vc660@1" if encoding == "rtu" else "df800@1", encoding)
    host = PtyHost(made, wire.theirs)
    try:
        yield made
    finally:
        host.close()


class PtyHost:
    """Master of a simulated bus that transmits the bytes from the slave side of a pty."""

    settings = None

    def __init__(self, made: SimulatedBus, path: str) -> None:
        import os

        self._os, self.bench = os, made
        self._fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        made.set_jitter_tolerance(0.002)
        made.attach(self)
        asyncio.get_running_loop().add_reader(self._fd, self._readable)

    def _readable(self) -> None:
        self.bench.transmit(self, self._os.read(self._fd, 4096))

    def receive(self, data: bytes, line_errors: int) -> None:
        self._os.write(self._fd, data)

    def on_unplugged(self) -> None: ...

    def close(self) -> None:
        asyncio.get_running_loop().remove_reader(self._fd)
        self.bench.detach(self)
        self._os.close(self._fd)


SLOW_LINK = LinkQuality(loss=0.1, delay=0.2, delay_s=0.1)
"""Delay shorter than the peers' timeouts: peers accept a late reply as the answer to their last request."""


@pytest.mark.parametrize("encoding", ["rtu", "ascii"])
async def test_every_value_that_pymodbus_accepts_from_our_station_is_that_registers_value(encoding: str) -> None:
    need_module("pymodbus")
    from pymodbus import FramerType, ModbusException
    from pymodbus.client import AsyncModbusSerialClient

    chance, accepted, failed = Random(9), 0, 0
    async with lossy_relay(LinkQuality(), seed=5) as wire, our_station(wire, encoding) as made:
        words = made.station(1).memory
        keys = [key for key in words.specs if words.read_rejection(key) is None and 0x100 <= key < 0x1000]
        client = AsyncModbusSerialClient(
            wire.ours,
            framer=FramerType(encoding),
            baudrate=PEER_SERIAL_SETTINGS.baud,
            retries=0,
            timeout=0.4,
            reconnect_delay=0,
        )
        assert await client.connect()
        wire.quality = SLOW_LINK
        for _ in range(30):
            key = chance.choice(keys)
            try:
                found = await client.read_holding_registers(key, count=1, device_id=1)
            except ModbusException:
                failed += 1
                continue
            if found.isError():
                failed += 1
                continue
            accepted += 1
            assert found.registers == [words[key]], f"{key:04X}H"
        client.close()
    assert accepted > 8
    assert failed


async def test_every_value_that_mbpoll_writes_and_reads_on_our_station_is_that_registers_value() -> None:
    """Each request is a new process, so that a late reply cannot reach the next one."""
    program = need_program("mbpoll", "mbpoll")
    read = written = lost = 0
    async with lossy_relay(LinkQuality(), seed=11) as wire, our_station(wire) as made:
        wire.quality = SLOW_LINK
        memory = made.station(1).memory
        for number in range(14):
            value = 4000 + number
            common = (
                "-m",
                "rtu",
                "-b",
                PEER_SERIAL_SETTINGS.baud,
                "-P",
                "none",
                "-0",
                "-1",
                "-o",
                0.5,
                "-a",
                1,
                "-t",
                4,
                "-r",
                2,
            )
            done = await run_program(program, *common, wire.ours, *((value,) if number % 2 else ()))
            if "Written 1" in done.text:
                written += 1
                assert memory.ram[2] == value
            elif done.registers:
                read += 1
                assert done.registers == {2: memory.ram[2]}
            else:
                lost += 1
            await asyncio.sleep(0.2)
    assert read > 1
    assert written > 1
    assert lost


async def test_the_relay_loses_and_delays_and_keeps_the_order() -> None:
    """The relay really loses and delays: the other tests depend on it."""
    async with lossy_relay(LinkQuality(loss=0.3, delay=0.5, delay_s=0.05), seed=1) as wire:
        import os

        left = os.open(wire.ours, os.O_RDWR | os.O_NOCTTY)
        right = os.open(wire.theirs, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        for written in range(1, 41):
            os.write(left, bytes((written,)))
            await wait_until(
                lambda written=written: wire.passed + wire.lost == written
            )  # two bytes at once would be one frame
        await asyncio.sleep(0.3)
        came = list(os.read(right, 100))
        os.close(left)
        os.close(right)
    assert came == sorted(came)
    assert len(came) == wire.passed == 40 - wire.lost
    assert 4 < wire.lost < 25
    assert wire.delayed
