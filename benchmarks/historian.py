"""The historian beside a plain table of rows: ``python -m benchmarks.historian`` (15 minutes; ``--small``: one minute).

``writing``: samples a second and bytes a sample, through the historian (journal, rollups and blocks, every batch
synced) and as rows into sqlite3 with the same batches and syncs. ``loop``: lateness of a 5 ms timer in the same process
while the historian writes one plant's samples, and while it writes as fast as it can. ``trends``: queries of random
spans over two days of raw values and a year of rollups of 12 drives with 10 signals; the files are in the page cache.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import math
import random
import sqlite3
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from benchmarks.__main__ import PROJECT_FOLDER, current_commit
from benchmarks.harness import Figures
from drivebus.service.api.operations.history import TrendParams
from drivebus.service.config.model import HistoryConfig
from drivebus.service.historian import Historian
from drivebus.service.historian.blocks import encode_points
from drivebus.service.historian.points import DAY_MS, HOUR_MS, MINUTE_MS, RESOLUTIONS, Points, ResolutionLevel
from drivebus.service.historian.store import Block, Compaction
from drivebus.service.live.views import Sample
from drivebus.values import Quality

TAGS = [f"drive-{drive}.signal_{signal}" for drive in range(12) for signal in range(10)]
START_MS = 1_767_225_600_000
"""Time of the first sample: 2026-01-01 00:00 UTC."""
BATCH = 50_000
POOL = 100_000


class GeneratedValues:
    """Samples like those of drives: slow changes with noise, two decimals, times with some milliseconds of jitter."""

    def __init__(self, seed: int) -> None:
        self.chance = random.Random(seed)
        gauss = self.chance.gauss
        self.pool = [round(30 + 15 * math.sin(n / 700) + gauss(0, 0.15), 2) for n in range(POOL)]
        self.jitter = [self.chance.randint(-4, 4) for _ in range(POOL)]
        self.places = [self.chance.randrange(POOL) for _ in TAGS]
        self.starts = [START_MS + self.chance.randrange(1000) for _ in TAGS]

    def samples(self, seconds: Sequence[int]) -> list[Sample]:
        """Return the samples of every tag, second by second."""
        pool, jitter, good = self.pool, self.jitter, Quality.GOOD
        return [
            Sample(tag, start + 1000 * second + jitter[(place + second) % POOL], pool[(place + second) % POOL], good)
            for second in seconds
            for tag, place, start in zip(TAGS, self.places, self.starts, strict=True)
        ]

    def batches(self, seconds: int) -> Iterator[list[Sample]]:
        step = BATCH // len(TAGS)
        for at in range(0, seconds, step):
            yield self.samples(range(at, min(at + step, seconds)))


def files_bytes(folder: Path) -> int:
    return sum(file.stat().st_size for file in folder.iterdir())


class TimerLateness:
    """Lateness of a 5 ms timer in this event loop."""

    async def __aenter__(self) -> TimerLateness:
        self.late_ms: list[float] = []
        self._task = asyncio.create_task(self._run())
        return self

    async def __aexit__(self, *_: object) -> None:
        self._task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self._task

    async def _run(self) -> None:
        while True:
            due = time.perf_counter() + 0.005
            await asyncio.sleep(0.005)
            self.late_ms.append(1000 * (time.perf_counter() - due))

    def figures(self) -> Figures:
        late = sorted(self.late_ms)
        return {"p50_ms": percentile(late, 0.5), "p99_ms": percentile(late, 0.99), "largest_ms": round(late[-1], 1)}


def percentile(values: list[float], share: float) -> float:
    return round(values[min(len(values) - 1, int(share * len(values)))], 2)


class UsageTimer:
    """Wall and processor seconds of the code in its ``with`` blocks."""

    wall_s = cpu_s = 0.0

    def __enter__(self) -> None:
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def __exit__(self, *_: object) -> None:
        self.wall_s += time.perf_counter() - self._wall
        self.cpu_s += time.process_time() - self._cpu

    def figures(self, folder: Path, count: int) -> Figures:
        """Return the figures; processor time a sample is the more reliable one on a busy machine."""
        return {
            "samples": count,
            "samples_per_s": round(count / self.wall_s),
            "cpu_us_per_sample": round(1e6 * self.cpu_s / count, 2),
            "bytes_per_sample": round(files_bytes(folder) / count, 2),
        }


async def measure_historian(folder: Path, values: GeneratedValues, seconds: int) -> Figures:
    timer, count = UsageTimer(), 0
    historian = Historian(HistoryConfig(), folder)
    await historian.open()
    for batch in values.batches(seconds):
        with timer:
            await historian.import_samples(batch)
        count += len(batch)
    with timer:
        await historian._on_writer_thread(historian.writer.compact_all)
    await historian.close()
    return timer.figures(folder, count)


async def measure_plain_table(folder: Path, values: GeneratedValues, seconds: int) -> Figures:
    timer, count = UsageTimer(), 0
    database = sqlite3.connect(folder / "rows.db", isolation_level=None)
    for pragma in ("journal_mode = WAL", "synchronous = FULL"):
        database.execute(f"PRAGMA {pragma}")
    columns = "tag INTEGER, ts INTEGER, value REAL, quality INTEGER, PRIMARY KEY (tag, ts)"
    database.execute(f"CREATE TABLE sample ({columns}) WITHOUT ROWID")
    ids = {tag: n for n, tag in enumerate(TAGS)}
    for batch in values.batches(seconds):
        with timer:
            database.execute("BEGIN")
            rows = ((ids[sample.tag], sample.time_ms, sample.value, 0) for sample in batch)
            database.executemany("INSERT INTO sample VALUES (?, ?, ?, ?)", rows)
            database.execute("COMMIT")
        count += len(batch)
    database.close()
    return timer.figures(folder, count)


async def measure_lateness(values: GeneratedValues, seconds: int) -> Figures:
    """Measure the lateness of the loop beside the writer's thread; ``idle`` is the same loop without a historian."""
    found: Figures = {}
    async with TimerLateness() as late:
        await asyncio.sleep(seconds)
    found["idle"] = late.figures()
    for name, step in (("one_plant", 1), ("as_fast_as_it_can", BATCH // len(TAGS))):
        with tempfile.TemporaryDirectory() as folder:
            pieces = [values.samples(range(at, at + step)) for at in range(0, step * 40, step)]
            async with Historian(HistoryConfig(), Path(folder)) as historian, TimerLateness() as late:
                until = time.perf_counter() + seconds
                while time.perf_counter() < until:
                    historian.append(pieces[len(late.late_ms) % len(pieces)])
                    await (asyncio.sleep(1.0) if step == 1 else historian._on_writer_thread(historian.writer.run_cycle))
            found[name] = late.figures()
    return found


async def write_year_of_rollups(historian: Historian, values: GeneratedValues, days: int) -> Figures:
    """Write the rollups of the days before the samples, as the writer would have written them."""
    ids = list(historian.queries.tag_ids(TAGS).values())
    counts = {ResolutionLevel.MINUTE: 0, ResolutionLevel.HOUR: 0}

    def write() -> None:
        for level, per_point in ((ResolutionLevel.MINUTE, 60), (ResolutionLevel.HOUR, 3600)):
            grain = RESOLUTIONS[level]
            first = (START_MS - days * DAY_MS) // grain.partition_ms * grain.partition_ms
            for start in range(first, START_MS, grain.partition_ms):
                blocks = [_rollup(level, tag, start, per_point, values) for tag in ids]
                blocks = [block for block in blocks if block is not None]
                counts[level] += len(blocks) * (min(start + grain.partition_ms, START_MS) - start) // grain.width_ms
                historian.writer._store.compact([_put(block) for block in blocks], START_MS, None)

    def _put(block: Block) -> Compaction:
        # the number up to which the tag is compacted already: its samples stay, only the block is added
        return Compaction(block.tag, historian.writer.open_blocks.next_number(block.tag), [block])

    begun = time.perf_counter()
    await historian._on_writer_thread(write)
    return {
        "minute_rows": counts[ResolutionLevel.MINUTE],
        "hour_rows": counts[ResolutionLevel.HOUR],
        "rows_per_s": round(sum(counts.values()) / (time.perf_counter() - begun)),
    }


def _rollup(level: ResolutionLevel, tag: int, start: int, per_point: int, values: GeneratedValues) -> Block | None:
    grain = RESOLUTIONS[level]
    end = min(start + grain.partition_ms, START_MS)
    if level is ResolutionLevel.HOUR and end == START_MS:
        return None  # the block that contains the first hours of the samples
    times = range(start, end, grain.width_ms)
    place = values.chance.randrange(POOL - 2 * len(times))
    middle = values.pool[place : place + len(times)]
    noise = values.pool[place + 1 : place + len(times) + 1]
    means = [value + other / 977 for value, other in zip(middle, noise, strict=True)]
    points = Points(
        time=times,
        count=[per_point] * len(times),
        low=[round(value - 0.4, 2) for value in middle],
        mean=means,
        high=[round(value + 0.5, 2) for value in middle],
        quality=bytes(len(times)),
    )
    return Block(level, tag, start, 0, encode_points(points))


SPANS_MS = {
    "1 min": MINUTE_MS,
    "10 min": 10 * MINUTE_MS,
    "1 h": HOUR_MS,
    "8 h": 8 * HOUR_MS,
    "16 h": 16 * HOUR_MS,
    "2 d": 2 * DAY_MS,
    "7 d": 7 * DAY_MS,
    "40 d": 40 * DAY_MS,
    "120 d": 120 * DAY_MS,
    "365 d": 365 * DAY_MS,
}


async def measure_trends(historian: Historian, chance: random.Random, end_ms: int, turns: int) -> Figures:
    found: Figures = {}
    for name, span in SPANS_MS.items():
        found[name] = {}
        for signals in (1, 10):
            taken = []
            for _ in range(turns):
                last = end_ms - (chance.randrange(max(1, 2 * DAY_MS - span)) if span < 2 * DAY_MS else 0)
                tags = chance.sample(TAGS, signals)
                params = TrendParams(tags=tags, from_ms=last - span, to_ms=last, points=1000)
                begun = time.perf_counter()
                answer = await historian.queries.trend(params)
                taken.append(1000 * (time.perf_counter() - begun))
            taken.sort()
            lengths = [len(series["t"]) for series in answer["series"].values()]
            found[name] |= {
                "resolution": answer["resolution"],
                "points": max(lengths),
                f"p50_ms_of_{signals}": percentile(taken, 0.5),
                f"p99_ms_of_{signals}": percentile(taken, 0.99),
            }
    return found


async def writing(values: GeneratedValues, *, small: bool) -> Figures:
    found: Figures = {}
    writers: dict[str, Callable[[Path, GeneratedValues, int], Any]] = {
        "drivebus": measure_historian,
        "rows": measure_plain_table,
    }
    for name, measure in writers.items():
        with tempfile.TemporaryDirectory() as folder:
            found[name] = await measure(Path(folder), values, 2_000 if small else 20_000)
    for figure in ("samples_per_s", "cpu_us_per_sample", "bytes_per_sample"):
        found[f"{figure}_to_rows"] = round(found["drivebus"][figure] / found["rows"][figure], 3)
    return found


async def loop(values: GeneratedValues, *, small: bool) -> Figures:
    return await measure_lateness(values, 5 if small else 60)


async def trends(values: GeneratedValues, *, small: bool) -> Figures:
    seconds, days = (2_000, 20) if small else (2 * 86_400, 363)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        found: Figures = {"two_days": await measure_historian(folder, values, seconds)}
        async with Historian(HistoryConfig(), folder) as historian:
            found["year"] = await write_year_of_rollups(historian, values, days)
            found["year"]["file_mb"] = round(files_bytes(folder) / 1e6)
            found["spans"] = await measure_trends(
                historian, values.chance, START_MS + 1000 * seconds, 5 if small else 50
            )
    return found


PARTS: dict[str, Callable[..., Any]] = {"writing": writing, "loop": loop, "trends": trends}


def main() -> None:
    options = argparse.ArgumentParser(prog="python -m benchmarks.historian", description=__doc__)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--small", action="store_true", help="a hundredth of the samples")
    options.add_argument("--part", choices=PARTS, help="measure only this part; the report keeps the others")
    options.add_argument("--write", action="store_true", help="write docs/reports/historian.json")
    chosen = options.parse_args()
    report = PROJECT_FOLDER / "docs" / "reports" / "historian.json"
    figures = json.loads(report.read_text()) if chosen.part and report.exists() else {}
    for name in [chosen.part] if chosen.part else PARTS:
        found = asyncio.run(PARTS[name](GeneratedValues(chosen.seed), small=chosen.small))
        figures[name] = {"commit": current_commit(), "seed": chosen.seed, "small": chosen.small} | found
        print(name, json.dumps(figures[name], indent=1), flush=True)
    if chosen.write:
        report.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
