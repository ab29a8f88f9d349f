"""Report page of one run; ratios to peers, because absolute figures depend on the machine."""

from __future__ import annotations

from benchmarks.harness import Figures

REPORT_HEAD = """# Benchmarks

Written by `make bench ARGS=--write`: every ratio from one run on one machine, peers beside us. Commit {commit}.

| what | goal | measured |
| --- | --- | --- |
"""


CODEC_DIRECTIONS = ("encode_request", "decode_reply", "decode_request", "encode_reply")


def _report_row(what: str, goal: str, measured: object) -> str:
    return f"| {what} | {goal} | {measured} |\n"


def _client_table(title: str, figures: Figures) -> str:
    lines = [
        f"\n## {title}\n\n",
        "| client | utilisation | smallest gap | mean gap | short gaps | requests | wrong |\n",
    ]
    lines.append("| --- | --- | --- | --- | --- | --- | --- |\n")
    for name, found in figures.items():
        cells = (
            name,
            *(found[key] for key in ("utilisation", "smallest_gap", "mean_gap", "short_gaps", "requests", "wrong")),
        )
        lines.append("| " + " | ".join(str(cell) for cell in cells) + " |\n")
    return "".join(lines)


def markdown(found: Figures) -> str:
    """Return the report page."""
    cpu, line, dead = found["cpu"], found["line"], found["one_dead"]
    ours, ours_dead = line["drivebus_lines"], dead["drivebus_lines"]
    wrong = sum(part["drivebus_lines"]["wrong"] for part in found.values() if "drivebus_lines" in part)
    page = REPORT_HEAD.format(commit=found["commit"])
    for way, how in (("lines", "polling"), ("transact", "awaited one by one")):
        ratio = cpu["ratios"]
        page += _report_row(f"CPU a transaction, {how} / pymodbus async", "≤ 0.6", ratio[f"{way}_to_pymodbus_async"])
        page += _report_row(
            f"CPU a transaction, {how} / bare asyncio loop", "reported", ratio[f"{way}_to_bare_asyncio"]
        )
        page += _report_row(f"CPU a transaction, {how} / libmodbus", "reported", ratio[f"{way}_to_libmodbus"])
    page += _report_row(
        "use of a 19,200-baud bus, 31 stations",
        "≥ 0.98, no gap < 3.5",
        f"{ours['utilisation']}, smallest gap {ours['smallest_gap']}",
    )
    fast = found["line_115200"]["drivebus_lines"]
    page += _report_row(
        "the same at 115,200 baud", "≥ 0.96", f"{fast['utilisation']}, smallest gap {fast['smallest_gap']}"
    )
    page += _report_row("the same with 1 of 31 dead", "≥ 0.90", ours_dead["utilisation"])
    for table, buses, use, cores in (
        ("lines_64", "64 buses × 31 drives", "≥ 0.98", "≤ 0.5"),
        ("lines_128", "128 buses × 31 drives", "≥ 0.97", "reported"),
        ("lines_128_two_processes", "the same in two processes", "≥ 0.97", "reported"),
    ):
        many, bare = (found[table][name] for name in ("drivebus_lines", "bare_asyncio"))
        page += _report_row(
            f"{buses}, use of the wire",
            f"{use}, no short gap",
            f"{many['utilisation']}, short gaps {many['short_gaps']} (bare asyncio loop {bare['utilisation']})",
        )
        page += _report_row(
            f"{buses}, cores",
            cores,
            f"{many['cores']}, {many['peak_mib']} MiB (bare asyncio loop {bare['cores']})",
        )
    page += _report_row("RTU request + reply / pymodbus' framer", "≤ 0.5", found["codecs"]["ratio_to_pymodbus"])
    page += _report_row("late replies accepted by drivebus, all runs", "0", wrong + cpu["wrong"])
    page += _report_row("pure core, transactions a second", "≥ 10,000", found["virtual"]["bare_transactions_per_s"])
    page += _report_row(
        "31 simulated drives on one bus, times real time", "≥ 1,000", found["virtual"]["real_time_factor"]
    )
    if "virtual_pypy" in found:
        factors = found["virtual_pypy"]
        page += _report_row(
            "the same with PyPy, once it is warm",
            "≥ 1,000",
            f"{factors['warm_real_time_factor']} (the first 120 s: {factors['first_real_time_factor']})",
        )
    slowest = max(ms for steps in found["motors"].values() for ms in steps.values())
    page += _report_row("1,000 simulated motors, one step", "≤ 20 ms", f"{slowest} ms")
    page += (
        "\nGaps are in characters, measured at the stations. “wrong”: accepted values that belong to another request.\n"
    )
    page += _client_table("One bus, 19,200 baud, every station alive", line)
    page += _client_table("One bus, 115,200 baud", found["line_115200"])
    page += _client_table("One of 31 stations dead", dead)
    page += _client_table("Two replies in a hundred 150 ms late", found["late"])
    page += _client_table("One bus, a second thread of the program computes all the time", found["busy_thread"])
    page += (
        "\n## Codecs, frames a second\n\n| encoding | "
        + " | ".join(CODEC_DIRECTIONS)
        + " |\n|"
        + " --- |" * (len(CODEC_DIRECTIONS) + 1)
        + "\n"
    )
    for name, ways in found["codecs"]["frames_per_s"].items():
        page += f"| {name} | " + " | ".join(f"{ways[way]:,}" for way in CODEC_DIRECTIONS) + " |\n"
    return page
