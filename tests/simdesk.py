"""A host for tests of simulated drives: writes frames to a sim:// port and collects what comes back. No opinion."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar

from drivebus.message import Codec, Complete, CompleteIfSilent
from drivebus.ports import open_port
from drivebus.protocols import dzb, modbus, sifang
from drivebus.sim.station import Station
from drivebus.testing.virtual import run

T = TypeVar("T")

_CODECS: dict[str, Codec] = {
    "c320": sifang.SifangCodec(),
    "dzb100": dzb.DzbCodec(),
    "vc660": modbus.RtuCodec(),
    "df800": modbus.RtuCodec("short"),
}


class Desk:
    """One host on a bench. Time is the running (virtual) loop's."""

    def __init__(self, url: str, codec: Codec | None = None) -> None:
        self.port: Any = open_port(url)
        self.codec = codec or _CODECS[self.port.bench.stations[0].family]
        self.heard: list[tuple[float, bytes, int]] = []
        self.lost: list[Exception] = []

    async def __aenter__(self) -> Desk:
        await self.port.open(self)
        await asyncio.sleep(0.1)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.port.close()

    def data_received(self, data: bytes, marks: int = 0) -> None:
        self.heard.append((asyncio.get_running_loop().time(), data, marks))

    def port_lost(self, error: Exception) -> None:
        self.lost.append(error)

    @property
    def bench(self) -> Any:
        return self.port.bench

    def station(self, address: int = 1) -> Any:
        found: Station = self.bench.station(address)
        return found

    async def raw(self, frame: bytes, wait_s: float = 0.5) -> bytes:
        """Send bytes, wait, and give everything that came."""
        self.heard.clear()
        self.port.write(frame)
        await asyncio.sleep(wait_s)
        return b"".join(data for _, data, _ in self.heard)

    async def ask(self, request: Any, wait_s: float = 0.5) -> Any:
        """Send a request; its reply as the codec reads it, or None for silence."""
        data = await self.raw(self.codec.encode_request(request), wait_s)
        if not data:
            return None
        verdict = self.codec.decode_reply(request, data)
        assert isinstance(verdict, Complete | CompleteIfSilent)
        assert verdict.size == len(data)
        return verdict.message


def story(coroutine: Coroutine[Any, Any, T]) -> T:
    """Run a story in virtual time."""
    return run(coroutine)
