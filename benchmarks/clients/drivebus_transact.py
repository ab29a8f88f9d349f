"""drivebus with one awaited transaction after the other and every check."""

from __future__ import annotations

import asyncio

from common import BAUD, PATH, REGISTERS, REPLY_DELAY_S, STATIONS, ClientMeter, is_wrong_reply
from station_configs import station_config

from drivebus.bus import Bus
from drivebus.bus.messages import BusRequest, RequestPriority
from drivebus.ports import open_port
from drivebus.protocols.modbus import ModbusRtuCodec, ReadRegisters


async def main() -> None:
    codec = ModbusRtuCodec()
    port = open_port(PATH, baud=BAUD, format="8N1", echo="off")
    async with Bus(port) as bus:
        for address in range(1, STATIONS + 1):
            bus.add_station(station_config(address, codec, REPLY_DELAY_S or 0.02))
        meter = ClientMeter()
        while not meter.is_over():
            station, register = 1 + meter.done % STATIONS, meter.done % 50
            answer = await bus.transact(
                BusRequest(
                    station=station,
                    request=ReadRegisters(station, register, REGISTERS),
                    priority=RequestPriority.PARAMETER,
                )
            )
            if answer.error is not None:
                meter.failed += 1
            else:
                meter.wrong += is_wrong_reply(station, register, answer.reply.values)
            meter.done += 1
        meter.report()


asyncio.run(main())
