"""Line with one misbehaving drive: a port of its own, and the record of every request and of the bytes after it."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field, replace
from random import Random

from drivebus.errors import ProtocolError
from drivebus.protocols.codec import Codec, Complete, CompleteIfSilent
from drivebus.serial_settings import SerialSettings
from drivebus.types import Capabilities, EchoSetting, Receiver
from verification.statements.drive_physics import DrivePhysics
from verification.statements.reaction import Reaction, StationModel

LINE_FAULTS = ("silent", "before", "after", "doubled", "foreign", "late", "cut", "damaged")
MAX_LATENESS_S = 0.7


@dataclass(slots=True, kw_only=True)
class Exchange:
    """Request of the master and what the drive did."""

    request: bytes
    at: float
    """End of the last bit of the request, in seconds."""
    reaction: Reaction | None
    """None: no frame for this drive."""
    line_fault: str = ""
    reply: bytes = b""
    """Reply as the drive made it, without what the line did to it."""
    stray: bytes = b""
    reply_at: float = float("inf")
    """End of the last byte."""

    @property
    def is_clean(self) -> bool:
        """Whether exactly the reply followed."""
        return self.reaction is not None and not self.line_fault and bool(self.reply)


@dataclass(slots=True, kw_only=True)
class LinePlan:
    """Faults of the line and rejections of the drive; ``share`` of the replies have one of the faults."""

    line_faults: tuple[str, ...]
    share: float
    refuses: frozenset[str]
    echoes: bool
    silent_after: int
    """Number of requests after which the drive is silent."""


@dataclass(slots=True, kw_only=True)
class FakeLine:
    """Port of the master, with the drive behind it."""

    station: StationModel
    address: int
    codec: Codec
    settings: SerialSettings
    physics: DrivePhysics
    plan: LinePlan
    rng: Random
    echo: EchoSetting
    capabilities: Capabilities = field(default_factory=lambda: Capabilities(has_line_timing=True))
    exchanges: list[Exchange] = field(default_factory=list)
    deliveries: list[tuple[float, bytes]] = field(default_factory=list)
    """Bytes of the drive that reached the master, with the time of the last one."""
    receiver: Receiver | None = None
    free_at: float = 0.0

    identity = "memory:statements"
    url = "memory://statements"

    def __post_init__(self) -> None:
        self.physics.memory.update(self.station.preset)

    async def open(self, receiver: Receiver) -> None:
        self.receiver = receiver

    async def close(self) -> None:
        self.receiver = None

    def write(self, data: bytes, /) -> None:
        """Transmit a request of the master."""
        loop = asyncio.get_running_loop()
        loop.call_at(loop.time() + len(data) * self.settings.character_s, self._on_request, data)

    def _on_request(self, data: bytes) -> None:
        now = asyncio.get_running_loop().time()
        if self.plan.echoes and self.receiver is not None:
            self.receiver.data_received(data)
        self.physics.advance(now)
        exchange = Exchange(request=data, at=now, reaction=None)
        self.exchanges.append(exchange)
        try:
            found = self.codec.decode_request(data)
        except ProtocolError:
            return
        if not isinstance(found, Complete | CompleteIfSilent):
            return
        message = found.message
        if self.codec.address_of(getattr(message, "request", message)) != self.address:
            return
        if len(self.exchanges) > self.plan.silent_after:
            exchange.line_fault = "silent"
            return
        exchange.reaction = reaction = self.station.react(self.physics, message, self.plan.refuses)
        exchange.reply = self.codec.encode_reply(reaction.reply)
        self._transmit(exchange, now)

    def _transmit(self, exchange: Exchange, now: float) -> None:
        """Send the reply with the fault of the line, where one is due."""
        plan, rng, reply = self.plan, self.rng, exchange.reply
        fault = rng.choice(plan.line_faults) if plan.line_faults and rng.random() < plan.share else ""
        exchange.line_fault = fault
        delay_s, data = max(0.004, 5 * self.settings.character_s), reply
        line_errors = 0
        if fault == "silent":
            return
        if fault in ("before", "after"):
            exchange.stray = rng.randbytes(rng.randrange(1, 6))
            data = exchange.stray + reply if fault == "before" else reply + exchange.stray
        elif fault == "doubled":
            data = reply + reply
        elif fault == "foreign":
            assert exchange.reaction is not None
            data = self.codec.encode_reply(replace(exchange.reaction.reply, address=self.address + 1))
        elif fault == "late":
            delay_s += rng.uniform(0.1, MAX_LATENESS_S)
        elif fault == "cut":
            data = reply[: rng.randrange(1, len(reply))]
        elif fault == "damaged":
            place = rng.randrange(len(reply))
            line_errors = int(self.settings.parity != "N")  # one flipped bit is a parity error
            data = reply[:place] + bytes((reply[place] ^ 1 << rng.randrange(8),)) + reply[place + 1 :]
        exchange.reply_at = max(now + delay_s, self.free_at) + len(data) * self.settings.character_s
        self.free_at = exchange.reply_at
        asyncio.get_running_loop().call_at(exchange.reply_at, self._deliver, data, line_errors)

    def _deliver(self, data: bytes, line_errors: int) -> None:
        if self.receiver is not None:
            self.deliveries.append((asyncio.get_running_loop().time(), data))
            self.receiver.data_received(data, line_errors)
