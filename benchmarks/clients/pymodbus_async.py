"""pymodbus' async serial client, as its own documentation uses it.

Where the reply delay is given, its timeout is that of drivebus and it does not retry: the way to most answers. A
further argument makes it keep the silence of 3.5 characters before each request, which it does not keep by itself.
"""

from __future__ import annotations

import asyncio
import sys
import time

from common import BAUD, PATH, REGISTERS, REPLY_DELAY_S, STATIONS, ClientMeter, is_wrong_reply
from pymodbus import ModbusException
from pymodbus.client import AsyncModbusSerialClient
from station_configs import station_config

from drivebus.protocols.modbus import ModbusRtuCodec
from drivebus.serial_settings import SerialSettings

REPLY_BYTES, REQUEST_BYTES = 5 + 2 * REGISTERS, 8
SILENCE_S = SerialSettings(BAUD).seconds(3.5) if len(sys.argv) > 7 else 0.0


def make_client() -> AsyncModbusSerialClient:
    if REPLY_DELAY_S is None:
        return AsyncModbusSerialClient(PATH, baudrate=BAUD)
    line = SerialSettings(BAUD)
    timeout_s = station_config(1, ModbusRtuCodec(), REPLY_DELAY_S).timing.timeout_s(line, REPLY_BYTES)
    return AsyncModbusSerialClient(PATH, baudrate=BAUD, timeout=line.seconds(REQUEST_BYTES) + timeout_s, retries=0)


async def main() -> None:
    client = make_client()
    await client.connect()
    meter = ClientMeter()
    while not meter.is_over():
        silent_until = time.perf_counter() + SILENCE_S
        while time.perf_counter() < silent_until:
            pass  # a sleep of the event loop is longer than this silence
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
