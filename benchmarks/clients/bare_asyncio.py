"""Bare asyncio client: encode, write, await with a timeout, check the CRC; no priorities, no other checks.

PATH is a comma-separated list. One bus is used without a gap; many buses, a task each, sleep the gap of 3.5 characters.
"""

from __future__ import annotations

import asyncio
import os
import struct

from common import BAUD, PATH, REGISTERS, STATIONS, ClientMeter, is_wrong_reply

from drivebus.serial_settings import SerialSettings

PATHS = PATH.split(",")
SILENCE_S = SerialSettings(BAUD).seconds(3.5) if len(PATHS) > 1 else 0.0


def table() -> list[int]:
    rows = []
    for byte in range(256):
        for _ in range(8):
            byte = byte >> 1 ^ 0xA001 if byte & 1 else byte >> 1
        rows.append(byte)
    return rows


TABLE = table()


def crc(data: bytes) -> int:
    value = 0xFFFF
    for byte in data:
        value = value >> 8 ^ TABLE[(value ^ byte) & 255]
    return value


async def use_bus(path: str, meter: ClientMeter) -> None:
    loop = asyncio.get_running_loop()
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    buffer = bytearray()
    waiting: asyncio.Future[None] | None = None
    want = 5 + 2 * REGISTERS
    done = 0

    def readable() -> None:
        buffer.extend(os.read(fd, 256))
        if waiting is not None and len(buffer) >= want and not waiting.done():
            waiting.set_result(None)

    loop.add_reader(fd, readable)
    while not meter.is_over():
        if SILENCE_S:
            await asyncio.sleep(SILENCE_S)
        station, register = 1 + done % STATIONS, done % 50
        head = struct.pack(">BBHH", station, 3, register, REGISTERS)
        buffer.clear()
        waiting = loop.create_future()
        os.write(fd, head + struct.pack("<H", crc(head)))
        try:
            await asyncio.wait_for(waiting, 0.1)
            body = bytes(buffer[:-2])
            if crc(body) != struct.unpack("<H", buffer[-2:])[0]:
                meter.failed += 1
            else:
                meter.wrong += is_wrong_reply(station, register, struct.unpack(f">{REGISTERS}H", body[3:]))
        except TimeoutError:
            meter.failed += 1
        done += 1
        meter.done += 1


async def main() -> None:
    meter = ClientMeter()
    await asyncio.gather(*(use_bus(path, meter) for path in PATHS))
    meter.report()


asyncio.run(main())
