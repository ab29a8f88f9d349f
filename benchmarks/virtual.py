"""Speed of bus traffic in virtual time; as a program: of the simulated bus alone, twice, as one JSON line."""

from __future__ import annotations

import asyncio
import json
import subprocess
import time

from benchmarks.clients.station_configs import station_config
from benchmarks.harness import BENCHMARK_FOLDER, Figures
from drivebus.bus import Bus
from drivebus.bus.commands import DeliverResult, Send
from drivebus.bus.core import BusCore
from drivebus.bus.messages import BusResult
from drivebus.bus.prepared_request import Poll
from drivebus.ports import open_port
from drivebus.protocols.modbus import ModbusRtuCodec, ReadRegisters, RegisterValues
from drivebus.serial_settings import SerialSettings
from drivebus.testing import virtual_time

STATIONS = 31
BUS_SECONDS = 120.0
WARM_BUS_SECONDS = 6_000.0
"""Length of the second run, for which PyPy has compiled what the first one used."""


def bare_core(transactions: int) -> float:
    """Return the transactions a second of the bus core alone: 31 polled stations, each reply at its last bit's time."""
    core, codec, line = BusCore(SerialSettings(19_200), echo="off"), ModbusRtuCodec(), SerialSettings(19_200)
    replies = {}
    for address in range(1, STATIONS + 1):
        core.registry.add(station_config(address, codec, 0.002))
        replies[address] = codec.encode_reply(RegisterValues(address, 3, (address << 8,) * 4))
    done, now, pending = 0, 0.0, core.on_port_open(0.0)
    for address in range(1, STATIONS + 1):
        pending += core.start_polling(address, [Poll(ReadRegisters(address, 0, 4), 0.01)], address, now)
    began = time.perf_counter()
    while done < transactions:
        reply = b""
        for act in pending:
            if type(act) is Send:
                reply = replies[act.data[0]]
            elif type(act) is DeliverResult:
                assert act.result.error is None
                done += 1
        if reply:
            now += 0.002 + line.seconds(8 + len(reply))
            pending = core.on_data(reply, now, 0)
        else:
            assert core.wake_at is not None
            now = core.wake_at
            pending = core.on_timer(now)
    return transactions / (time.perf_counter() - began)


async def _line(seconds: float) -> int:
    received = 0

    def sink(answer: BusResult) -> None:
        nonlocal received
        received += answer.error is None

    async with Bus(open_port(f"sim://vc660@1-{STATIONS}?baud=9600")) as bus:
        for address in range(1, STATIONS + 1):
            bus.add_station(station_config(address, ModbusRtuCodec(), 0.03))
            bus.start_polling(address, [Poll(ReadRegisters(address, 0x3000, 4), 0.05)], sink)
        await asyncio.sleep(seconds)
    return received


def simulated_bus(seconds: float) -> tuple[int, float]:
    """Return the transactions of 31 simulated VC660 with motors on one 9,600-baud bus, and the wall time in seconds."""
    began = time.perf_counter()
    received = virtual_time.run(_line(seconds))
    return received, time.perf_counter() - began


def run_virtual_time(transactions: int = 30_000, seconds: float = BUS_SECONDS) -> Figures:
    """Measure the bus core alone, and a simulated bus (``real_time_factor``), its model and profile loaded before."""
    simulated_bus(1.0)
    received, wall = simulated_bus(seconds)
    return {
        "bare_transactions_per_s": round(bare_core(transactions)),
        "line_transactions_per_s": round(received / wall),
        "real_time_factor": round(seconds / wall, 1),
        "bus_seconds": seconds,
    }


def run_with_pypy(interpreter: str) -> Figures:
    """Return the real-time factors of the simulated bus with this PyPy, which has drivebus installed."""
    command = [interpreter, "-m", "benchmarks.virtual"]
    done = subprocess.run(command, cwd=BENCHMARK_FOLDER.parent, capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout))


def main() -> None:
    factors = [round(seconds / simulated_bus(seconds)[1], 1) for seconds in (BUS_SECONDS, WARM_BUS_SECONDS)]
    print(json.dumps(dict(zip(("first_real_time_factor", "warm_real_time_factor"), factors, strict=True))))


if __name__ == "__main__":
    main()
