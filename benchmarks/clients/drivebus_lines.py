"""drivebus polling many buses in one process as fast as the wire allows; PATH is a comma-separated list."""

from __future__ import annotations

import asyncio
import sys

from common import BAUD, PATH, REGISTERS, SECONDS, STATIONS, ClientMeter, is_wrong_reply
from station_configs import station_config

from drivebus.bus import Bus
from drivebus.bus.messages import BusResult
from drivebus.bus.prepared_request import Poll
from drivebus.ports import open_port
from drivebus.protocols.modbus import ModbusRtuCodec, ReadRegisters
from drivebus.service.process.tuning import relax_gc

DELAY_S = 0.002
PERIOD_S = float(sys.argv[5]) if len(sys.argv) > 5 else 0.01
"""Poll period: shorter than the wire allows, so that a poll is always due."""


async def main() -> None:
    codec = ModbusRtuCodec()
    buses = [Bus(open_port(path, baud=BAUD, format="8N1", echo="off")) for path in PATH.split(",")]
    meter: ClientMeter | None = None

    def sink(answer: BusResult) -> None:
        if meter is None:
            return
        meter.done += 1
        request = answer.bus_request.request
        if answer.error is not None:
            meter.failed += 1
        else:
            meter.wrong += is_wrong_reply(request.address, request.register, answer.reply.values)

    for bus in buses:
        for address in range(1, STATIONS + 1):
            bus.add_station(station_config(address, codec, DELAY_S))
            polls = [
                Poll(ReadRegisters(address, register, REGISTERS), PERIOD_S) for register in (address, address + 50)
            ]
            bus.start_polling(address, polls, sink)
    relax_gc()  # as the service does
    await asyncio.gather(*(bus.open() for bus in buses))
    await asyncio.sleep(1.0)
    meter = ClientMeter()
    await asyncio.sleep(SECONDS)
    meter.report()
    for bus in buses:
        await bus.close()


asyncio.run(main())
