"""drivebus, one awaited transaction after the other, every check on."""

from __future__ import annotations

import asyncio

from common import BAUD, PATH, REGISTERS, STATIONS, Meter, wrong
from links import link

from drivebus.bus import Bus
from drivebus.message import Ask, Lane
from drivebus.ports import open_port
from drivebus.protocols.modbus import ReadRegisters, RtuCodec


async def main() -> None:
    codec = RtuCodec()
    port = open_port(PATH, baud=BAUD, format="8N1", echo="off")
    async with Bus(port) as bus:
        for address in range(1, STATIONS + 1):
            bus.add(link(address, codec, 0.02))
        meter = Meter()
        while not meter.over():
            station, register = 1 + meter.done % STATIONS, meter.done % 50
            answer = await bus.transact(Ask(station, ReadRegisters(station, register, REGISTERS), Lane.PARAMETER))
            if answer.error is not None:
                meter.failed += 1
            else:
                meter.wrong += wrong(station, register, answer.reply.values)
            meter.done += 1
        meter.report()


asyncio.run(main())
