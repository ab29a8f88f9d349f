"""CPU time of a transaction, and use of one bus and of many in one process, each beside its peers in one run."""

from __future__ import annotations

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
                figures = run_client(name, stations, seconds, baud, UNPACED_PERIOD_S)
                taken[name].append(figures["cpu_s"] / figures["done"] * 1e6)
                wrong += figures["wrong"]
    micros = {name: round(median(values), 1) for name, values in taken.items()}
    ratios = {
        f"{ours}_to_{peer}": round(micros[f"drivebus_{ours}"] / micros[peer], 3)
        for ours in ("lines", "transact")
        for peer in MASTER_PEERS[2:]
    }
    return {"cpu_us": micros, "wrong": wrong, "ratios": ratios}


def one_bus(seconds: float, *, baud: int = 19_200, dead: int = 0, late: tuple[int, int] = (0, 0)) -> Figures:
    """Measure the share of one bus's legal capacity that each client uses, recorded at the stations."""
    found: Figures = {}
    for name in ("drivebus_lines", "minimalmodbus_client", "bare_asyncio", "pymodbus_async"):
        with CStations(baud=baud, delay_us=2000, dead=dead, late=late) as stations:
            client = run_client(name, stations, seconds, baud)
        keep = ("utilisation", "smallest_gap", "mean_gap", "short_gaps", "requests")
        found[name] = {key: stations.figures[key] for key in keep} | {"wrong": client["wrong"]}
    return found


def many_buses(seconds: float, count: int) -> Figures:
    """Measure many buses in one process, beside a bare asyncio loop: use of the wire, share of a core, memory."""
    found: Figures = {}
    for name in ("drivebus_lines", "bare_asyncio"):
        with CStations(count, baud=MANY_BUSES_BAUD, delay_us=2000) as stations:
            client = run_client(name, stations, seconds, MANY_BUSES_BAUD)
        keep = ("utilisation", "smallest_gap", "mean_gap", "short_gaps", "requests")
        found[name] = {key: stations.figures[key] for key in keep} | {
            "cores": round(client["cpu_s"] / client["wall_s"], 3),
            "cpu_us": round(client["cpu_s"] / client["done"] * 1e6, 1),
            "peak_mib": round(client["peak_kib"] / 1024, 1),
            "wrong": client["wrong"],
            "failed": client["failed"],
        }
    return found
