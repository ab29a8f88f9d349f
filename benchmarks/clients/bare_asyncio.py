"""Bare asyncio client: encode, write, await with a timeout, check the CRC; no gap, no priorities, no other checks."""

from __future__ import annotations

import asyncio
import os
import struct

from common import PATH, REGISTERS, STATIONS, ClientMeter, is_wrong_reply


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


async def main() -> None:
    loop = asyncio.get_running_loop()
    fd = os.open(PATH, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    buffer = bytearray()
    waiting: asyncio.Future[None] | None = None
    want = 5 + 2 * REGISTERS

    def readable() -> None:
        buffer.extend(os.read(fd, 256))
        if waiting is not None and len(buffer) >= want and not waiting.done():
            waiting.set_result(None)

    loop.add_reader(fd, readable)
    meter = ClientMeter()
    while not meter.is_over():
        station, register = 1 + meter.done % STATIONS, meter.done % 50
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
        meter.done += 1
    meter.report()


asyncio.run(main())
