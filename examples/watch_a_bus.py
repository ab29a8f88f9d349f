"""Watch four drives for three seconds and print the bus statistics. 监视四台变频器三秒钟，并打印总线统计。"""

import asyncio

import drivebus


async def main() -> None:
    async with drivebus.open_bus("sim://vc660@1-4", baud=19200) as bus:
        fans = [drivebus.Drive(bus, "vc660", address) for address in range(1, 5)]
        monitors = [fan.monitor(["state", "output_frequency", "output_current"]) for fan in fans]
        await fans[0].run(10.0)
        await asyncio.sleep(3)
        for fan, monitor in zip(fans, monitors, strict=True):
            status = monitor.status()
            print(fan.address, status.state.value, status.readings["output_frequency"].value, "Hz")
            monitor.close()
        print("stopped:", (await drivebus.stop_bus(bus, fans)).confirmed)
        statistics = bus.statistics()
        print(f"load {statistics.load_percent:.0f} %, {statistics.transactions_per_s:.1f} transactions/s")


asyncio.run(main())
