"""pymodbus' async serial client, as its own documentation uses it."""

from __future__ import annotations

import asyncio

from common import BAUD, PATH, REGISTERS, STATIONS, ClientMeter, is_wrong_reply
from pymodbus import ModbusException
from pymodbus.client import AsyncModbusSerialClient


async def main() -> None:
    client = AsyncModbusSerialClient(PATH, baudrate=BAUD)
    await client.connect()
    meter = ClientMeter()
    while not meter.is_over():
        station, register = 1 + meter.done % STATIONS, meter.done % 50
        try:
            reply = await client.read_holding_registers(register, count=REGISTERS, device_id=station)
        except ModbusException:
            meter.failed += 1
            if not client.connected:
                await client.connect()
        else:
            meter.failed += reply.isError()
            meter.wrong += not reply.isError() and is_wrong_reply(station, register, reply.registers)
        meter.done += 1
    meter.report()
    client.close()


asyncio.run(main())
