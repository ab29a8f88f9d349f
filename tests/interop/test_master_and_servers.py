"""Our master drives pymodbus' (RTU, ASCII) and libmodbus' (RTU) servers over socat pairs."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from drivebus.bus import Poll, Presence
from drivebus.bus.messages import BusRequest, BusResult, RequestPriority
from drivebus.errors import NoReply, NotPermitted
from drivebus.protocols import modbus
from fixtures.station_bench import wait_until
from interop.conftest import StartProgram
from interop.servers import (
    PEER_SERIAL_SETTINGS,
    SHORT_TIMING,
    STATION,
    PeerServer,
    peer_station,
    permitted_write,
    pymodbus,
)
from peers import need_module

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="socat's ptys as Linux has them")


@pytest.fixture(params=["pymodbus-rtu", "pymodbus-ascii", "libmodbus-rtu"])
def server(request: pytest.FixtureRequest, wire: tuple[str, str], started: StartProgram) -> Iterator[PeerServer]:
    name, _, encoding = request.param.partition("-")
    our_end, peer_end = wire
    if name == "pymodbus":
        need_module("pymodbus")
        peer = PeerServer(name, encoding, our_end, lambda: pymodbus(started, peer_end, encoding))
    else:
        program: Path = request.getfixturevalue("libmodbus_server")
        peer = PeerServer(name, encoding, our_end, lambda: started(program, peer_end, STATION))
    peer.start()
    yield peer


def read(register: int, count: int, function: int = 3) -> BusRequest:
    return BusRequest(station=STATION, request=modbus.ReadRegisters(STATION, register, count, function))


def bits(register: int, count: int, function: int) -> BusRequest:
    return BusRequest(station=STATION, request=modbus.ReadBits(STATION, register, count, function))


async def replies(server: PeerServer, *asks: BusRequest) -> list[Any]:
    """Send requests one after another and return their replies; none may fail."""
    async with server.bus() as bus:
        answers = [await bus.transact(ask) for ask in asks]
    assert [answer.error for answer in answers] == [None] * len(asks)
    return [answer.reply for answer in answers]


async def test_every_read_returns_the_values_of_the_servers_tables(server: PeerServer) -> None:
    """Functions 03, 04, 01 and 02, at both ends of their tables and with the most values that one frame carries."""
    asks = [
        read(0, 1),
        read(127, 1),
        read(40, 4),
        read(0, 125),
        read(3, 125),
        read(10, 3, 4),
        read(2, 125, 4),
        bits(0, 1, 1),
        bits(7, 19, 1),
        bits(0, 128, 1),
        bits(1, 1, 2),
        bits(64, 64, 2),
    ]
    tables = {
        1: lambda n: n % 3 == 0,
        2: lambda n: n % 2 == 1,
        3: lambda n: 1000 + n,
        4: lambda n: 2000 + n,
    }
    for ask, reply in zip(asks, await replies(server, *asks), strict=True):
        request = ask.request
        expected = [tables[request.function](n) for n in range(request.register, request.register + request.count)]
        assert (reply.address, reply.function, list(reply.values)) == (STATION, request.function, expected)


async def test_values_written_with_a_permit_are_read_back(server: PeerServer) -> None:
    """Functions 06, 10H, 05 and 0FH; neighbouring values stay unchanged."""
    async with server.bus() as bus:
        await bus.transact(read(0, 1))  # shows that this port does not echo: a reply to 06 could be an echo
        for request in (
            modbus.WriteRegister(STATION, 5, 0xBEEF),
            modbus.WriteRegisters(STATION, 10, (0, 0xFFFF, 0x0D0A)),
            modbus.WriteRegisters(STATION, 0, tuple(range(5))),
            modbus.WriteBit(STATION, 1, True),
            modbus.WriteBit(STATION, 3, False),
            modbus.WriteBits(STATION, 8, (True,) * 11),
        ):
            answer = await bus.transact(permitted_write(bus, request))
            assert answer.error is None
            assert isinstance(answer.reply, modbus.WriteAck)
            assert (answer.reply.function, answer.reply.register) == (request.function, request.register)
        words = await bus.transact(read(0, 14))
        coils = await bus.transact(bits(0, 20, 1))
    assert words.reply.values == (0, 1, 2, 3, 4, 0xBEEF, 1006, 1007, 1008, 1009, 0, 0xFFFF, 0x0D0A, 1013)
    assert coils.reply.values == (True, True, *(False,) * 4, True, False, *(True,) * 11, False)


async def test_a_write_without_a_permit_never_reaches_the_server(server: PeerServer) -> None:
    async with server.bus() as bus:
        refused = await bus.transact(
            BusRequest(station=STATION, request=modbus.WriteRegister(STATION, 5, 1), priority=RequestPriority.COMMAND)
        )
        assert isinstance(refused.error, NotPermitted) and refused.sent == b""
        assert (await bus.transact(read(5, 1))).reply.values == (1005,)


async def test_the_servers_exceptions_arrive_as_replies_and_not_as_errors(server: PeerServer) -> None:
    async with server.bus() as bus:
        outside = await bus.transact(read(128, 1))
        straddling = await bus.transact(read(120, 9))
        coils = await bus.transact(bits(200, 3, 1))
        written = await bus.transact(permitted_write(bus, modbus.WriteRegisters(STATION, 127, (1, 2))))
        assert (await bus.transact(read(127, 1))).reply.values == (1127,), "nothing was written"
        assert bus.statistics().errors == {}
    for answer, function in ((outside, 3), (straddling, 3), (coils, 1), (written, 16)):
        assert answer.error is None and answer.reply == modbus.ExceptionReply(STATION, function, 2)


@pytest.mark.parametrize("server", ["pymodbus-rtu", "pymodbus-ascii"], indirect=True)  # libmodbus' has no 08
async def test_a_loop_back_returns_its_nonce(server: PeerServer) -> None:
    nonces = (0xA55A, 0x0000, 0xFFFF, 0x0D0A)
    asks = [BusRequest(station=STATION, request=modbus.Diagnostics(STATION, nonce)) for nonce in nonces]
    found = await replies(server, read(0, 1), *asks)
    assert found[1:] == [modbus.DiagnosticsReply(STATION, nonce) for nonce in nonces]


async def test_two_hundred_transactions_increase_no_error_counter(server: PeerServer) -> None:
    async with server.bus() as bus:
        sizes = []
        for number in range(200):
            count = 1 + number % 8
            answer = await bus.transact(read(number % 64, count))
            assert answer.reply.values == tuple(range(1000 + number % 64, 1000 + number % 64 + count))
            assert (answer.error, answer.attempts) == (None, 1)
            sizes.append((len(answer.sent), len(answer.received)))
        found = bus.statistics()
        health = bus.health(STATION)
    assert (found.transactions, found.replies, found.errors, found.error_rate) == (200, 200, {}, 0.0)
    assert {name: count for name, count in found.counters.items() if count} == {}
    assert (found.bytes_sent, found.bytes_received) == (sum(a for a, _ in sizes), sum(b for _, b in sizes))
    assert found.reply_p50_s is not None and found.reply_p95_s is not None and found.reply_p99_s is not None
    assert 0 < found.reply_p50_s <= found.reply_p95_s <= found.reply_p99_s < 0.5
    assert 0 < found.load_percent <= found.occupied_percent <= 100
    assert 0 < found.transactions_per_s <= 200 / found.elapsed_s * 1.01
    assert found.elapsed_s > PEER_SERIAL_SETTINGS.seconds(found.bytes_sent), "never faster than the wire"
    assert found.stations[STATION].replies == 200
    assert (health.presence, health.suspect, health.foreign_master, health.duplicate_address) == (
        Presence.ONLINE,
        False,
        False,
        False,
    )


async def test_a_killed_server_goes_offline_and_comes_back_online_by_itself(server: PeerServer) -> None:
    answers: list[BusResult] = []
    async with server.bus(SHORT_TIMING) as bus:
        assert bus.presence(STATION) is Presence.NEVER_SEEN
        bus.start_polling(STATION, [Poll(modbus.ReadRegisters(STATION, 0, 4), 0.02)], answers.append)
        await wait_until(lambda: bus.presence(STATION) is Presence.ONLINE, "the first answer")
        server.kill()
        await wait_until(lambda: bus.presence(STATION) is Presence.OFFLINE, "the silence")
        assert isinstance(answers[-1].error, NoReply)
        assert bus.statistics().errors["NoReply"] >= 1
        count = len(answers)
        server.start()
        await wait_until(lambda: bus.presence(STATION) is Presence.ONLINE, "the return")
        await wait_until(lambda: len(answers) > count and answers[-1].error is None, "polls again")
        assert answers[-1].reply.values == (1000, 1001, 1002, 1003)


@pytest.mark.parametrize("server", ["libmodbus-rtu"], indirect=True)  # pymodbus answers for every address
async def test_an_unused_address_does_not_disturb_a_station_that_answers(server: PeerServer) -> None:
    async with server.bus() as bus:
        bus.add_station(peer_station(STATION + 1, loops=False))
        no_user = await bus.transact(BusRequest(station=STATION + 1, request=modbus.ReadRegisters(STATION + 1, 0, 1)))
        assert isinstance(no_user.error, NoReply) and no_user.received == b""
        assert (await bus.transact(read(1, 1))).reply.values == (1001,)
        assert bus.presence(STATION + 1) is Presence.NEVER_SEEN
        assert bus.presence(STATION) is Presence.ONLINE
