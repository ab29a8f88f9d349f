"""RFC 2217 and raw TCP against independent servers: ser2net and pyserial's, each over a pty."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivebus.ports import open_port
from drivebus.ports.base import port_notes
from fixtures.receiver import FakeReceiver, wait_until
from peers import need_module, need_program
from ports.conftest import Pty

EVERY_BYTE = bytes(range(256)) + b"\xff\xff\xff\x00\xff"

PYSERIAL_SERVER = """
import socket, sys, threading
import serial, serial.rfc2217

class NoModem(serial.Serial):  # a pty has no modem lines
    cts = dsr = ri = cd = property(lambda self: False)
    def _update_rts_state(self): pass
    def _update_dtr_state(self): pass

port = NoModem(sys.argv[1], timeout=0.05)
listening = socket.create_server(("127.0.0.1", 0))
print(listening.getsockname()[1], flush=True)
while True:
    client, _ = listening.accept()
    lock = threading.Lock()
    class Connection:
        def write(self, data):
            with lock:
                client.sendall(data)
    manager = serial.rfc2217.PortManager(port, Connection())
    def to_network():
        while True:
            data = port.read(port.in_waiting or 1)
            if data:
                Connection().write(b"".join(manager.escape(data)))
    threading.Thread(target=to_network, daemon=True).start()
    while True:
        data = client.recv(1024)
        if not data:
            break
        port.write(b"".join(manager.filter(data)))
"""


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


@pytest.fixture
def ser2net(pty: Pty, tmp_path: Path) -> Iterator[tuple[int, int]]:
    """A ser2net with RFC 2217 on one port and raw TCP on another, one pty each time."""
    program = need_program("ser2net", "ser2net")
    telnet, raw = free_port(), free_port()
    (tmp_path / "ser2net.yaml").write_text(
        "%YAML 1.1\n---\n"
        + "".join(
            f"connection: &{name}\n  accepter: {accepter}\n  connector: serialdev,{pty.path},9600n81,local\n"
            for name, accepter in (("a", f"telnet(rfc2217),tcp,127.0.0.1,{telnet}"), ("b", f"tcp,127.0.0.1,{raw}"))
        )
    )
    with subprocess.Popen(
        [program, "-n", "-d", "-u", "-c", str(tmp_path / "ser2net.yaml")],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    ) as child:
        for number in (telnet, raw):
            wait_for(number, child)
        yield telnet, raw
        child.terminate()


def wait_for(number: int, child: subprocess.Popen[bytes]) -> None:
    """Wait for the listening socket without connecting: a serial server accepts one client only."""
    listening = f":{number:04X} 00000000:0000 0A"
    for _ in range(6000):
        if listening in Path("/proc/net/tcp").read_text():
            return
        if child.poll() is not None and child.stdout is not None:
            pytest.fail(child.stdout.read().decode())
        time.sleep(0.01)
    pytest.fail(f"nothing listens on {number}")


async def both_ways(link: str, pty: Pty) -> None:
    port, sink = open_port(link), FakeReceiver()
    await port.open(sink)
    got = bytearray()
    port.write(EVERY_BYTE)
    async with asyncio.timeout(60):
        while len(got) < len(EVERY_BYTE):
            got += pty.read()
            await asyncio.sleep(0.005)
    assert bytes(got) == EVERY_BYTE
    pty.send(EVERY_BYTE)
    await wait_until(lambda: len(sink.data) >= len(EVERY_BYTE))
    assert (bytes(sink.data), sink.line_errors, sink.lost) == (EVERY_BYTE, 0, [])
    assert port_notes(port) == ()
    await port.close()


async def test_ser2net_accepts_the_serial_settings_and_every_byte(pty: Pty, ser2net: tuple[int, int]) -> None:
    await both_ways(f"rfc2217://127.0.0.1:{ser2net[0]}?baud=19200&format=8N2", pty)
    speed, cflag = termios.tcgetattr(pty.master)[5], termios.tcgetattr(pty.master)[2]
    assert speed == termios.B19200
    assert cflag & termios.CSTOPB


async def test_raw_ser2net_transports_every_byte(pty: Pty, ser2net: tuple[int, int]) -> None:
    await both_ways(f"tcp://127.0.0.1:{ser2net[1]}", pty)


async def test_raw_ser2net_is_not_accepted_as_rfc2217_server(pty: Pty, ser2net: tuple[int, int]) -> None:
    from drivebus.errors import PortUnavailable

    with pytest.raises(PortUnavailable) as caught:
        await open_port(f"rfc2217://127.0.0.1:{ser2net[1]}").open(FakeReceiver())
    assert caught.value.key == "ports.rfc2217_silent"


@pytest.fixture
def pyserial_server(pty: Pty) -> Iterator[int]:
    need_module("serial", "pyserial")
    with subprocess.Popen([sys.executable, "-c", PYSERIAL_SERVER, pty.path], stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        yield int(child.stdout.readline())
        child.kill()


async def test_the_server_of_pyserial_accepts_the_serial_settings_and_every_byte(
    pty: Pty, pyserial_server: int
) -> None:
    await both_ways(f"rfc2217://127.0.0.1:{pyserial_server}?baud=38400&format=8N2", pty)
    assert termios.tcgetattr(pty.master)[5] == termios.B38400
