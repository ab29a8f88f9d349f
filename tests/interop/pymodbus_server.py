"""A pymodbus serial server: PATH ADDRESS rtu|ascii. The same tables as libmodbus_server.c; prints "ready"."""

from __future__ import annotations

import asyncio
import sys

from pymodbus import FramerType
from pymodbus.server import ModbusSerialServer
from pymodbus.simulator import DataType, SimData, SimDevice


async def serve(path: str, address: int, framer: str) -> None:
    coils = SimData(0, values=[n % 3 == 0 for n in range(128)], datatype=DataType.BITS)
    inputs = SimData(0, values=[n % 2 == 1 for n in range(128)], datatype=DataType.BITS)
    holding = SimData(0, values=[1000 + n for n in range(128)], datatype=DataType.REGISTERS)
    words = SimData(0, values=[2000 + n for n in range(128)], datatype=DataType.REGISTERS)
    device = SimDevice(address, ([coils], [inputs], [holding], [words]))
    server = ModbusSerialServer(device, framer=FramerType(framer), port=path, baudrate=115200)
    await server.serve_forever(background=True)
    print("ready", flush=True)
    await server.serving


asyncio.run(serve(sys.argv[1], int(sys.argv[2]), sys.argv[3]))
