"""Raw TCP serial servers, and the RFC 2217 port against servers that misbehave."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

import pytest

from drivebus.errors import PortLost, PortUnavailable
from drivebus.ports import Port, open_port, rfc2217
from drivebus.ports.base import port_notes
from drivebus.ports.rfc2217 import COM_PORT, DO, DONT, IAC, SB, SE, WILL, subnegotiation
from fixtures.receiver import FakeReceiver, wait_until

Handler = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


@asynccontextmanager
async def server(handler: Handler) -> AsyncIterator[int]:
    """A TCP server on a free port of this machine."""
    tasks: set[asyncio.Task[None]] = set()

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        tasks.add(asyncio.current_task())  # type: ignore[arg-type]
        try:
            await handler(reader, writer)
        finally:
            writer.close()

    listening = await asyncio.start_server(handle, "127.0.0.1", 0)
    try:
        yield listening.sockets[0].getsockname()[1]
    finally:
        listening.close()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while data := await reader.read(1000):
        writer.write(data)


async def listen(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    await asyncio.sleep(60)


async def refused(port: Port) -> PortUnavailable:
    with pytest.raises(PortUnavailable) as caught:
        await port.open(FakeReceiver())
    return caught.value


async def test_bytes_go_both_ways_without_line_timing_or_parity() -> None:
    async with server(echo) as number:
        port, sink = open_port(f"tcp://127.0.0.1:{number}?baud=19200&format=8E1"), FakeReceiver()
        await port.open(sink)
        port.write(b"\xff\x00abc")
        await wait_until(lambda: len(sink.data) == 5)
        assert bytes(sink.data) == b"\xff\x00abc"
        assert (port.capabilities.has_line_timing, port.capabilities.parity, port.settings.baud) == (
            False,
            False,
            19200,
        )
        assert port.identity == f"tcp:127.0.0.1:{number}"
        await port.close()
        await port.close()
        with pytest.raises(PortLost):
            port.write(b"x")
        await port.open(sink)
        again = await refused(port)
        assert (again.key, again.params["port"]) == ("ports.already_open", f"tcp://127.0.0.1:{number}")
        await port.close()
        assert sink.lost == []


async def test_frames_are_sent_at_once_and_a_dead_peer_is_detected() -> None:
    async with server(listen) as number:
        port = open_port(f"tcp://localhost:{number}")
        await port.open(FakeReceiver())
        sock = port._connection._transport.get_extra_info("socket")  # type: ignore[attr-defined]
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) != 0
        assert sock.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) != 0
        if hasattr(socket, "TCP_USER_TIMEOUT"):
            assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == 2000
        await port.close()


async def test_a_server_that_reads_nothing_loses_the_port_and_its_frames_are_not_sent_later() -> None:
    async with server(listen) as number:
        port, sink = open_port(f"tcp://127.0.0.1:{number}"), FakeReceiver()
        await port.open(sink)
        with pytest.raises(PortLost) as caught:
            for _ in range(1000):
                port.write(bytes(65536))
        assert str(caught.value.params["reason"]) == "it takes no more data"
        await wait_until(lambda: sink.lost)
        assert len(sink.lost) == 1


async def test_a_server_that_hangs_up_is_reported_once_and_the_port_opens_again() -> None:
    async def hang_up(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"bye")

    async with server(hang_up) as number:
        port, sink = open_port(f"tcp://127.0.0.1:{number}"), FakeReceiver()
        for times in (1, 2):
            await port.open(sink)
            await wait_until(lambda: len(sink.lost) == times)  # noqa: B023  # awaited here
        assert bytes(sink.data) == b"byebye"
        assert {error.params["reason"].key for error in sink.lost} == {"ports.server_closed"}
        with pytest.raises(PortLost):
            port.write(b"x")


async def test_a_rejected_connection_reports_that_no_server_listens() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        number = free.getsockname()[1]
    for host in ("127.0.0.1", "localhost"):
        error = await refused(open_port(f"tcp://{host}:{number}"))
        assert (error.key, error.params["number"]) == ("ports.net_refused", number)


async def test_an_unknown_host_name_is_reported() -> None:
    error = await refused(open_port("tcp://no-such-host.invalid:4001"))
    assert (error.key, error.params["host"]) == ("ports.net_name", "no-such-host.invalid")


async def test_a_silent_network_is_given_up_after_the_timeout(monkeypatch: pytest.MonkeyPatch) -> None:
    async def never(*_: object) -> None:
        await asyncio.sleep(60)

    monkeypatch.setattr(asyncio.get_running_loop(), "sock_connect", never)
    error = await refused(open_port("tcp://127.0.0.1:4001?timeout=0.1"))
    assert (error.key, error.params["seconds"]) == ("ports.net_timeout", 0.1)


async def test_an_unreachable_network_reports_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    async def unreachable(*_: object) -> None:
        raise OSError(101, "Network is unreachable")

    monkeypatch.setattr(asyncio.get_running_loop(), "sock_connect", unreachable)
    error = await refused(open_port("tcp://127.0.0.1:4001"))
    assert (error.key, str(error.params["reason"])) == ("ports.net", "Network is unreachable")


def negotiating(*answers: bytes, then: bytes = b"") -> Handler:
    """Run a server that sends one of ``answers`` after each chunk that it reads, and ``then`` at the end."""

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        for answer in answers:
            await reader.read(1000)
            writer.write(answer)
        writer.write(then)
        while await reader.read(1000):
            pass

    return handle


ACCEPT = bytes((IAC, DO, COM_PORT))


def acknowledged(baud: int = 9600, bits: int = 8, parity: int = 1, stop: int = 1) -> bytes:
    answers = {101: baud.to_bytes(4), 102: bytes((bits,)), 103: bytes((parity,)), 104: bytes((stop,)), 112: b"\x03"}
    return b"".join(subnegotiation(command, value) for command, value in answers.items())


async def test_a_server_that_never_acknowledges_a_setting_does_not_delay_the_opening(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(rfc2217, "NEGOTIATION_TIMEOUT_S", 0.05)
    async with server(negotiating(ACCEPT, subnegotiation(101, (9600).to_bytes(4)))) as number:
        port = open_port(f"rfc2217://127.0.0.1:{number}?baud=9600")
        await port.open(FakeReceiver())
        assert [note.key for note in port_notes(port)] == ["ports.rfc2217_unacknowledged"]
        assert port_notes(port)[0].params["names"] == ("data bits", "parity", "stop bits")
        assert "parity" in port_notes(port)[0].text()
        await port.close()


async def test_a_server_that_sets_another_value_is_rejected_with_both_numbers() -> None:
    async with server(negotiating(ACCEPT, acknowledged(baud=9600))) as number:
        error = await refused(open_port(f"rfc2217://127.0.0.1:{number}?baud=19200"))
        assert error.key == "ports.rfc2217_value"
        assert (error.params["name"], error.params["expected"], error.params["found"]) == ("baud", 19200, 9600)


async def test_a_telnet_server_without_the_option_is_rejected_with_the_raw_link() -> None:
    async with server(negotiating(bytes((IAC, DONT, COM_PORT)))) as number:
        error = await refused(open_port(f"rfc2217://127.0.0.1:{number}"))
        assert error.key == "ports.rfc2217_refused"
        assert f"tcp://127.0.0.1:{number}" in str(error)


async def test_a_raw_server_is_distinguished_from_a_telnet_server_before_any_setting_is_sent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Bytes for a raw server are sent to the bus, so nothing after the first request may be sent."""
    monkeypatch.setattr(rfc2217, "NEGOTIATION_TIMEOUT_S", 0.05)
    got = bytearray()

    async def raw(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(1000):
            got.extend(data)

    async with server(raw) as number:
        assert (await refused(open_port(f"rfc2217://127.0.0.1:{number}"))).key == "ports.rfc2217_silent"
    assert bytes((IAC, SB)) not in got


async def test_a_server_that_hangs_up_while_negotiating_is_reported_at_once() -> None:
    async def hang_up(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(1000)

    async with server(hang_up) as number:
        assert (await refused(open_port(f"rfc2217://127.0.0.1:{number}"))).key == "ports.net"


async def test_a_notice_of_a_bad_byte_becomes_a_line_error() -> None:
    """Parity 4, framing 8, break 16, overrun 2; 'data ready' and 'sent' are no errors."""
    notices = b"".join(subnegotiation(106, bytes((bits,))) for bits in (4, 8, 16, 2, 1, 0x60))
    async with server(negotiating(ACCEPT, acknowledged() + b"dropped", b"a" + notices + b"b")) as number:
        port, sink = open_port(f"rfc2217://127.0.0.1:{number}"), FakeReceiver()
        await port.open(sink)
        port.write(b"go")
        await wait_until(lambda: sink.line_errors == 4 and len(sink.data) == 2)
        assert bytes(sink.data) == b"ab"
        await port.close()


async def test_a_lost_server_is_reported_once_and_the_port_opens_again_with_its_settings() -> None:
    async def short(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(1000)
        writer.write(ACCEPT + bytes((IAC, WILL, 1)))
        await reader.read(1000)
        writer.write(acknowledged() + bytes((IAC, SE)))
        await reader.read(1)

    async with server(short) as number:
        port, sink = open_port(f"rfc2217://127.0.0.1:{number}"), FakeReceiver()
        for times in (1, 2):
            await port.open(sink)
            assert port_notes(port) == ()
            port.write(b"x")
            await wait_until(lambda: len(sink.lost) == times)  # noqa: B023  # awaited here
            with pytest.raises(PortLost):
                port.write(b"x")
