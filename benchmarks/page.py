"""The page in Chromium with 300 tiles that change once a second: ``python -m benchmarks.page`` (half a minute).

A hub, the real web process and Debian's headless Chromium run on one machine without graphics hardware. ``load``: bytes
over the wire and milliseconds from the request of the page to the first and to the last tile, the median of three
visits with an empty cache; ``reload``: the same with a full one. ``frames``: milliseconds between two frames of the
screen while all tiles change (16.7 at 60 Hz). ``busy_ms_per_s``: working time of the page's thread; ``cpu_ms_per_s``:
processor time of the page's process. ``busy``: the machine's load at the start; figures of a busy machine are upper
bounds.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks import web
from benchmarks.__main__ import current_commit, print_figures
from drivebus.types import Json

FRAME_TIMES_SCRIPT = """(seconds) => new Promise((done) => {
  const found = []; const begun = performance.now(); let last = begun;
  const step = () => {
    const now = performance.now(); found.push(now - last); last = now;
    if (now - begun < seconds * 1000) requestAnimationFrame(step); else done(found);
  };
  requestAnimationFrame(step);
})"""
TILE_TIMES_SCRIPT = """(() => {
  const step = () => {
    const tiles = document.getElementsByClassName('tile').length;
    if (tiles > 0) window.firstTile ??= performance.now();
    if (tiles >= DRIVES) window.everyTile = performance.now(); else requestAnimationFrame(step);
  };
  requestAnimationFrame(step);
})()"""
"""Script: times since the request of the page at which its tiles exist, looked for in each frame of the screen."""
BROWSER = "/usr/bin/chromium-headless-shell"  # of Debian, as the tests of the page use
VISITS = 3
CHANGE_TIMES_SCRIPT = """(seconds) => new Promise((done) => {
  const ids = new Set(); let n = 0;
  const watch = new MutationObserver((all) => { for (const one of all) {
    const link = (one.target.parentElement ?? one.target).closest?.('[data-drive]');
    if (link) { ids.add(link.dataset.drive); n += 1; }
  } });
  watch.observe(document.querySelector('.fleet'), { characterData: true, childList: true, subtree: true });
  setTimeout(() => { watch.disconnect(); done({ tiles: ids.size, changes: n }); }, seconds * 1000);
})"""


class TiledFleet(web.SyntheticService):
    """Drives with the signals that a tile shows: output frequency and output current, and eight others."""

    async def call(self, operation: str, params: Json, actor: Any) -> Json:
        return {"tags": []}

    async def publish(self) -> None:
        plain = {"title": {"en": "Benchmark", "zh": "基准"}, "state": "running", "audit_ok": True, "history_ok": True}
        self.hub.publish("plant", {"id": "bench", **plain})
        begun, turn = time.monotonic(), 0
        while True:
            time_ms = time.time_ns() // 1_000_000
            hertz = round(25 + math.sin(turn / 100), 2)
            values = {"output_frequency": (hertz, "Hz"), "output_current": (round(hertz / 10, 2), "A")}
            values |= {f"signal_{number}": (turn % 100, "") for number in range(8)}
            name = self.names[turn % len(self.names)]
            signals = {
                signal: {"value": value, "unit": unit, "quality": "good", "reason": None, "source_time_ms": time_ms}
                for signal, (value, unit) in values.items()
            }
            self.hub.publish(f"drives/{name}", {**web.constant_fields(name), "signals": signals})
            turn += 1
            await asyncio.sleep(max(0.0, begun + turn / len(self.names) - time.monotonic()))


async def plant(directory: Path, drives: int) -> None:
    from drivebus.service.ipc.server import SocketServer

    fleet = TiledFleet(drives)
    await SocketServer(fleet, directory / "plant.sock").open()
    print("ready", flush=True)
    await fleet.publish()


@contextmanager
def hub(directory: str, drives: int) -> Iterator[None]:
    words = [sys.executable, "-m", "benchmarks.page", "--plant", directory, "--drives", str(drives)]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        process.stdout.readline()
        yield
    finally:
        process.kill()
        process.communicate()


def issue_login_code(directory: str) -> str:
    from drivebus.service.auth.service import AuthService

    return asyncio.run(AuthService(Path(directory)).issue_code("bench", 600.0))


def browser_figures(port: str, login_codes: list[str], drives: int, seconds: float) -> Json:
    """Open the page in a browser, once for each login code, and return its figures."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=BROWSER, args=["--no-sandbox", "--disable-gpu"])
        visits = []
        for code in login_codes:
            page = browser.new_page(viewport={"width": 1440, "height": 900})
            page.add_init_script(TILE_TIMES_SCRIPT.replace("DRIVES", str(drives)))
            wire = page.context.new_cdp_session(page)
            wire.send("Network.enable")
            sizes: list[int] = []
            wire.on("Network.loadingFinished", lambda event, sizes=sizes: sizes.append(event["encodedDataLength"]))
            page.goto(f"http://127.0.0.1:{port}/#login={code}")
            visits.append(_tile_times(page))
            page.wait_for_timeout(2000)
            if code is not login_codes[-1]:
                page.close()
        load: Json = {"kibibytes": round(sum(sizes) / 1024, 1), "files": len(sizes)}
        load |= {name: sorted(visit[name] for visit in visits)[len(visits) // 2] for name in visits[0]}
        page.reload()
        found: Json = {"load": load, "reload": _tile_times(page)}
        page.wait_for_timeout(3000)
        wire.send("Performance.enable")
        before, cpu_before_s = _thread_work(wire), _renderer_cpu_s(browser)
        frames = [milliseconds / 1000 for milliseconds in page.evaluate(FRAME_TIMES_SCRIPT, seconds)]
        after, cpu_after_s = _thread_work(wire), _renderer_cpu_s(browser)
        found |= {"frames": {"count": len(frames), "ms": _spread(frames)}}
        found["in_two_seconds"] = page.evaluate(CHANGE_TIMES_SCRIPT, 2.0)
        found["busy_ms_per_s"] = round(1000 * (after["TaskDuration"] - before["TaskDuration"]) / seconds, 1)
        found["cpu_ms_per_s"] = round(1000 * (cpu_after_s - cpu_before_s) / seconds, 1)
        found["heap_mebibytes"] = round(after["JSHeapUsedSize"] / 2**20, 1)
        browser.close()
        return found


def _tile_times(page: Any) -> Json:
    page.wait_for_function("() => window.everyTile")
    first, every = page.evaluate("[window.firstTile, window.everyTile]")
    return {"first_tile_ms": round(first), "every_tile_ms": round(every)}


def _renderer_cpu_s(browser: Any) -> float:
    processes = browser.new_browser_cdp_session().send("SystemInfo.getProcessInfo")["processInfo"]
    return float(sum(process["cpuTime"] for process in processes if process["type"] == "renderer"))


def _thread_work(wire: Any) -> dict[str, float]:
    return {metric["name"]: metric["value"] for metric in wire.send("Performance.getMetrics")["metrics"]}


def _spread(seconds: list[float]) -> Json:
    known = sorted(seconds)
    return web.spread(seconds) | {"p95": round(1000 * known[int(0.95 * len(known))], 1)}


def measure_page(drives: int, seconds: float) -> Json:
    found: Json = {"commit": current_commit(), "drives": drives, "busy": round(os.getloadavg()[0], 2)}
    with tempfile.TemporaryDirectory() as directory, hub(directory, drives), web.child("--web", directory) as (_, port):
        codes = [issue_login_code(directory) for _ in range(VISITS)]
        return found | browser_figures(port, codes, drives, seconds)


def main() -> None:
    options = argparse.ArgumentParser(prog="python -m benchmarks.page", description=__doc__)
    options.add_argument("--drives", type=int, default=300)
    options.add_argument("--seconds", type=float, default=10.0, help="of watching frames")
    options.add_argument("--write", action="store_true", help="write docs/reports/page.json")
    options.add_argument("--plant", help=argparse.SUPPRESS)
    chosen = options.parse_args()
    if chosen.plant:
        asyncio.run(plant(Path(chosen.plant), chosen.drives))
        return
    print_figures(measure_page(chosen.drives, chosen.seconds), "page.json", write=chosen.write)


if __name__ == "__main__":
    main()
