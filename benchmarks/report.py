"""Report page of one run; ratios to peers, because absolute figures depend on the machine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from benchmarks.harness import Figures

Row = tuple[str, str, object]
"""What was measured, its goal, and the figure."""

REPORT_HEAD = """# Benchmarks

Written by `make bench ARGS=--write`: every ratio from one run on one machine, peers beside us. Commit {commit}.

"""
COLUMNS_NOTE = (
    "\nGaps are in characters, measured at the stations. “wrong”: accepted values that belong to another request.\n"
)
CLIENT_TABLES = {
    "line": "One bus, 19,200 baud, every station alive",
    "line_115200": "One bus, 115,200 baud",
    "one_dead": "One of 31 stations dead",
    "late": "Two replies in a hundred 150 ms late",
    "busy_thread": "One bus, a second thread of the program computes all the time",
}
CLIENT_COLUMNS = ("utilisation", "smallest_gap", "mean_gap", "short_gaps", "requests", "wrong")
CODEC_DIRECTIONS = ("encode_request", "decode_reply", "decode_request", "encode_reply")


def markdown(found: Figures) -> str:
    """Return the report page."""
    rows = [*_cpu_rows(found["cpu"]["ratios"]), *_one_bus_rows(found), *_many_buses_rows(found), *_other_rows(found)]
    page = REPORT_HEAD.format(commit=found["commit"]) + _table(("what", "goal", "measured"), rows) + COLUMNS_NOTE
    for part, title in CLIENT_TABLES.items():
        page += f"\n## {title}\n\n" + _client_table(found[part])
    return page + "\n## Codecs, frames a second\n\n" + _codec_table(found["codecs"]["frames_per_s"])


def _cpu_rows(ratios: Figures) -> Iterator[Row]:
    for way, how in (("lines", "polling"), ("transact", "awaited one by one")):
        yield f"CPU a transaction, {how} / pymodbus async", "≤ 0.6", ratios[f"{way}_to_pymodbus_async"]
        yield f"CPU a transaction, {how} / bare asyncio loop", "reported", ratios[f"{way}_to_bare_asyncio"]
        yield f"CPU a transaction, {how} / libmodbus", "reported", ratios[f"{way}_to_libmodbus"]


def _one_bus_rows(found: Figures) -> Iterator[Row]:
    slow, fast, dead = (found[part]["drivebus_lines"] for part in ("line", "line_115200", "one_dead"))
    shown = "{utilisation}, smallest gap {smallest_gap}"
    yield "use of a 19,200-baud bus, 31 stations", "≥ 0.98, no gap < 3.5", shown.format(**slow)
    yield "the same at 115,200 baud", "≥ 0.96", shown.format(**fast)
    yield "the same with 1 of 31 dead", "≥ 0.90", dead["utilisation"]


def _many_buses_rows(found: Figures) -> Iterator[Row]:
    for part, buses, use, cores in (
        ("lines_64", "64 buses × 31 drives", "≥ 0.98", "≤ 0.5"),
        ("lines_128", "128 buses × 31 drives", "≥ 0.97", "reported"),
        ("lines_128_two_processes", "the same in two processes", "≥ 0.97", "reported"),
    ):
        many, bare = (found[part][name] for name in ("drivebus_lines", "bare_asyncio"))
        used = f"{many['utilisation']}, short gaps {many['short_gaps']} (bare asyncio loop {bare['utilisation']})"
        yield f"{buses}, use of the wire", f"{use}, no short gap", used
        yield f"{buses}, cores", cores, f"{many['cores']}, {many['peak_mib']} MiB (bare asyncio loop {bare['cores']})"


def _other_rows(found: Figures) -> Iterator[Row]:
    wrong = sum(part["drivebus_lines"]["wrong"] for part in found.values() if "drivebus_lines" in part)
    virtual, pypy = found["virtual"], found.get("virtual_pypy")
    yield "RTU request + reply / pymodbus' framer", "≤ 0.5", found["codecs"]["ratio_to_pymodbus"]
    yield "late replies accepted by drivebus, all runs", "0", wrong + found["cpu"]["wrong"]
    yield "pure core, transactions a second", "≥ 10,000", virtual["bare_transactions_per_s"]
    yield "31 simulated drives on one bus, times real time", "≥ 1,000", virtual["real_time_factor"]
    if pypy is not None:
        factors = f"{pypy['warm_real_time_factor']} (the first 120 s: {pypy['first_real_time_factor']})"
        yield "the same with PyPy, once it is warm", "≥ 1,000", factors
    slowest = max(ms for steps in found["motors"].values() for ms in steps.values())
    yield "1,000 simulated motors, one step", "≤ 20 ms", f"{slowest} ms"


def _client_table(clients: Figures) -> str:
    titles = ("client", *(name.replace("_", " ") for name in CLIENT_COLUMNS))
    return _table(titles, [(name, *(found[key] for key in CLIENT_COLUMNS)) for name, found in clients.items()])


def _codec_table(frames_per_s: Figures) -> str:
    rows = [(name, *(f"{ways[way]:,}" for way in CODEC_DIRECTIONS)) for name, ways in frames_per_s.items()]
    return _table(("encoding", *CODEC_DIRECTIONS), rows)


def _table(titles: tuple[str, ...], rows: Sequence[tuple[object, ...]]) -> str:
    lines = [titles, ("---",) * len(titles), *rows]
    return "".join("| " + " | ".join(map(str, line)) + " |\n" for line in lines)
