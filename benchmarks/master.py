"""CPU time of a transaction, and use of one bus and of many, each beside its peers in one run."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from statistics import median

from benchmarks.harness import CStations, Figures, run_client

UNPACED_BAUD = 4_000_000
"""Baud rate given to our clients on a pty, where a frame takes no time on the wire: the shortest gap there is."""
UNPACED_PERIOD_S = 0.0005
MANY_BUSES_BAUD = 19_200
MASTER_PEERS = ("drivebus_lines", "drivebus_transact", "pymodbus_async", "bare_asyncio", "libmodbus")
"""drivebus is measured twice: as a master that polls, and with one awaited transaction after the other."""


def transaction_cpu(seconds: float, rounds: int) -> Figures:
    """Measure the CPU microseconds of a transaction (4 registers, RTU, unpaced pty): median of alternating turns."""
    taken: dict[str, list[float]] = {name: [] for name in MASTER_PEERS}
    wrong = 0
    with CStations() as stations:
        for _ in range(rounds):
            for name in MASTER_PEERS:
                baud = UNPACED_BAUD if name.startswith("drivebus") else 115_200
                figures = run_client(name, stations.paths, seconds, baud, UNPACED_PERIOD_S)
                taken[name].append(figures["cpu_s"] / figures["done"] * 1e6)
                wrong += figures["wrong"]
    micros = {name: round(median(values), 1) for name, values in taken.items()}
    ratios = {
        f"{ours}_to_{peer}": round(micros[f"drivebus_{ours}"] / micros[peer], 3)
        for ours in ("lines", "transact")
        for peer in MASTER_PEERS[2:]
    }
    return {"cpu_us": micros, "wrong": wrong, "ratios": ratios}


def one_bus(
    seconds: float, *, baud: int = 19_200, dead: int = 0, late: tuple[int, int] = (0, 0), busy_thread: bool = False
) -> Figures:
    """Measure the share of one bus's legal capacity that each client uses, recorded at the stations."""
    found: Figures = {}
    for name in ("drivebus_lines", "minimalmodbus_client", "bare_asyncio", "pymodbus_async"):
        with CStations(baud=baud, delay_us=2000, dead=dead, late=late) as stations:
            client = run_client(name, stations.paths, seconds, baud, busy_thread=busy_thread)
        keep = ("utilisation", "smallest_gap", "mean_gap", "short_gaps", "requests")
        found[name] = {key: stations.figures[key] for key in keep} | {"wrong": client["wrong"]}
    return found


def many_buses(seconds: float, count: int, processes: int = 1) -> Figures:
    """Measure many buses, beside a bare asyncio loop: use of the wire, share of a core, memory.

    The buses are divided among ``processes``; the figures are their sums.
    """
    found: Figures = {}
    for name in ("drivebus_lines", "bare_asyncio"):
        with (
            CStations(count, baud=MANY_BUSES_BAUD, delay_us=2000) as stations,
            ThreadPoolExecutor(processes) as threads,
        ):
            parts = [stations.paths[number::processes] for number in range(processes)]
            clients = list(threads.map(partial(run_client, name, seconds=seconds, baud=MANY_BUSES_BAUD), parts))
        keep = ("utilisation", "smallest_gap", "mean_gap", "short_gaps", "requests")
        total = {
            key: sum(client[key] for client in clients) for key in ("done", "cpu_s", "peak_kib", "wrong", "failed")
        }
        found[name] = {key: stations.figures[key] for key in keep} | {
            "cores": round(sum(client["cpu_s"] / client["wall_s"] for client in clients), 3),
            "cpu_us": round(total["cpu_s"] / total["done"] * 1e6, 1),
            "peak_mib": round(total["peak_kib"] / 1024, 1),
            "wrong": total["wrong"],
            "failed": total["failed"],
        }
    return found
