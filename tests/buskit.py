"""A small honest station that speaks Modbus RTU, and the four lines on which every rule of the bus is tried."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

from drivebus.bus.core import BusCore
from drivebus.line import LineSettings
from drivebus.message import Ask, Complete, Effect, Lane, Permit, StationLink, StationTiming, WriteClass
from drivebus.protocols import modbus
from drivebus.testing.playbook import Playbook, Wire

LINE = LineSettings(9600)
C = LINE.character_s
CODEC = modbus.RtuCodec()
TIMING = StationTiming(reply_delay_s=0.02, adapter_s=0.02, lateness_s=0.3)
COMMAND = 0x2000
START, STOP = 1, 2


def effect(frame: bytes) -> Effect:
    """Register 2000H moves (1) or stops (2); every other write is a setting."""
    changes = modbus.written(frame)
    if not changes:
        return Effect.NONE
    if changes == (("holding", COMMAND, STOP),):
        return Effect.STOP
    return Effect.MOTION if any(register == COMMAND for _, register, _ in changes) else Effect.SETTING


def link(address: int = 1, timing: StationTiming = TIMING, codec: Any = CODEC, **extra: Any) -> StationLink:
    """A VC660 as the bus sees it: its fence is a loop-back with a nonce."""
    return StationLink(
        address, codec, timing, effect, lambda n: modbus.Loopback(address, 0xA500 + n % 256), extra=extra
    )


def read(address: int = 1, register: int = 0x3000, count: int = 4) -> modbus.ReadRegisters:
    return modbus.ReadRegisters(address, register, count)


def ask_read(address: int = 1, register: int = 0x3000, count: int = 4, **more: Any) -> Ask:
    return Ask(address, read(address, register, count), **more)


def ask_stop(address: int = 1) -> Ask:
    return Ask(address, modbus.WriteRegister(address, COMMAND, STOP), Lane.STOP, WriteClass.ABSOLUTE)


def ask_write(
    core: BusCore, address: int = 1, register: int = 0x2001, value: int = 5000, *, until: float = 60.0,
    write_class: WriteClass = WriteClass.ABSOLUTE, lane: Lane = Lane.COMMAND,
) -> Ask:  # fmt: skip
    """A write with a permit as the gate would give it."""
    acts = Effect.MOTION if register == COMMAND else Effect.SETTING
    permit = Permit(address, acts, write_class, until, core.stations[address].generation)
    return Ask(address, modbus.WriteRegister(address, register, value), lane, write_class, permit, until)


def ask_start(core: BusCore, address: int = 1, **more: Any) -> Ask:
    return ask_write(core, address, COMMAND, START, write_class=WriteClass.EDGE, **more)


@dataclass
class Station:
    """Answers reads with counters, obeys writes, and remembers what it heard."""

    address: int = 1
    delay_s: float = 0.005
    """From the request's last bit to the reply's first."""
    alive: bool = True
    heard: list[tuple[float, Any]] = field(default_factory=list)
    registers: dict[int, int] = field(default_factory=dict)
    answers: int = 0
    started: int = 0

    def answer(self, frame: bytes, ended_at: float) -> bytes | None:
        try:
            verdict = CODEC.decode_request(frame)
        except Exception:
            return None
        if not self.alive or not isinstance(verdict, Complete) or verdict.message.address not in (self.address, 0):
            return None
        self.heard.append((ended_at, verdict.message))
        reply = self._obey(verdict.message)
        return None if verdict.message.address == 0 else CODEC.encode_reply(reply)

    def _obey(self, request: Any) -> Any:
        match request:
            case modbus.ReadRegisters(register=first, count=count):
                self.answers += 1
                values = tuple(self.registers.get(register, self.answers) for register in range(first, first + count))
                return modbus.Registers(self.address, 3, values)
            case modbus.WriteRegister(register=register, value=value):
                self.registers[register] = value
                self.started += register == COMMAND and value == START
                return modbus.Written(self.address, 6, register, value)
            case modbus.Loopback(data=data):
                return modbus.Looped(self.address, data)
            case _:
                raise AssertionError(request)


def whole(reply: bytes, begins_at: float) -> Iterable[tuple[float, bytes]]:
    """The reply in one piece when its last bit is there."""
    return [(begins_at + len(reply) * C, reply)]


def byte_by_byte(reply: bytes, begins_at: float) -> Iterable[tuple[float, bytes]]:
    return [(begins_at + (place + 1) * C, reply[place : place + 1]) for place in range(len(reply))]


Delivery = Callable[[bytes, float], Iterable[tuple[float, bytes]]]


def wire(*stations: Station, deliver: Delivery = whole) -> Wire:
    """Stations on one pair of wires."""

    def answers(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        for station in stations:
            reply = station.answer(frame, ended_at)
            if reply is not None:
                yield from deliver(reply, ended_at + station.delay_s)

    return answers


def lossy(seed: int = 1, share: float = 0.1) -> Delivery:
    """Loses one reply in ten and flips a bit in another one in ten."""
    chance = random.Random(seed)

    def deliver(reply: bytes, begins_at: float) -> Iterable[tuple[float, bytes]]:
        draw = chance.random()
        if draw < share:
            return []
        if draw < 2 * share:
            place = chance.randrange(len(reply))
            spoiled = bytearray(reply)
            spoiled[place] ^= 1 << chance.randrange(8)
            reply = bytes(spoiled)
        return byte_by_byte(reply, begins_at)

    return deliver


def late(seed: int = 1, share: float = 0.1, longest_s: float = 0.25) -> Delivery:
    """One reply in ten comes up to a quarter of a second too late."""
    chance = random.Random(seed)

    def deliver(reply: bytes, begins_at: float) -> Iterable[tuple[float, bytes]]:
        return whole(reply, begins_at + (chance.random() * longest_s if chance.random() < share else 0.0))

    return deliver


LINES: dict[str, Callable[[], Delivery]] = {
    "clean": lambda: whole,
    "byte by byte": lambda: byte_by_byte,
    "lossy": lossy,
    "late": late,
}


def core(*addresses: int, timing: StationTiming = TIMING, paced: bool = True, echo: str = "off") -> BusCore:
    made = BusCore(LINE, paced=paced, echo=echo)
    for address in addresses or (1,):
        made.add(link(address, timing))
    return made


def book(*stations: Station, deliver: Delivery = whole, **options: Any) -> Playbook:
    """A bus with these stations registered and alive on its wire."""
    return Playbook(core(*(station.address for station in stations), **options), wire(*stations, deliver=deliver))
