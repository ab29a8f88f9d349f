"""Run one drive and stop it. 运行一台变频器，然后停机。 Give your own port URL: python one_pump.py /dev/ttyUSB0"""

import asyncio
import sys

import drivebus


async def main(port_url: str) -> None:
    async with drivebus.open_bus(port_url, baud=19200, format="8E1") as bus:
        pump = drivebus.Drive(bus, "c320", 3)
        print("run:", await pump.run(10.0, wait=True))
        status = await pump.status()
        print("state:", status.state.value, status.readings["output_frequency"].value, "Hz")
        print("stop:", await pump.stop())


asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else "sim://c320@3"))
