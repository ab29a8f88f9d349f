"""``kill -9`` of a whole service process at random points, and checks of the state that its successor finds.

    PYTHONPATH=tests python -m real.kill_service --kills 1000 --write

One service process after the other owns the same line and state directory, receives commands without pause and is
killed at a random moment; the process of the simulated drives records the wire. Checked after every kill: the successor
sends only reads, every answered command is in the audit trail with its outcome, and the trail and the database are
intact.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import random
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivebus.errors import DrivebusError
from drivebus.service.auth.actor import local_actor
from drivebus.service.ipc.client import SocketClient
from drivebus.service.ipc.protocol import SERVICE_SOCKET
from fixtures.child_process import COMMAND, ENVIRONMENT
from real.recorded_bench import RecordedPlant, recorded_plant, wait_until
from verification.reference.effects import RequestEffect
from verification.report import current_commit

LINE = {"model": "vc660", "encoding": "rtu", "addresses": [1, 2], "baud": 38400, "format": "8N1", "ramp_s": 0.3}
RUN_MAX_S = 1.5
"""Longest time from the first command to the kill."""
QUIET_AFTER_START_S = 0.6
"""Time in which a started plant gets no command and must send only reads."""
PLANT_FILE = """
format = 1
[plant]
id = "killed"
title = "Killed"
directory = {directory}
[gateway.web]
enabled = false
[bus.a]
port = {port}
[drive.one]
bus = "a"
address = 1
model = "vc660"
[drive.two]
bus = "a"
address = 2
model = "vc660"
"""
KILL_TEST_ACTOR = local_actor("tester", "kills")
HARMLESS_EFFECTS = (RequestEffect.READ,)
REPORT = Path(__file__).resolve().parents[2] / "docs" / "reports" / "plant-kills.json"


@dataclass
class KillResults:
    """Counts and violations of all kills."""

    kills: int = 0
    answered: int = 0
    violations: list[str] = field(default_factory=list)
    first_poll_s: list[float] = field(default_factory=list)
    """Seconds from the start of each process to its first frame."""
    requests: Counter[str] = field(default_factory=Counter)


class KilledService:
    """Service processes that are started and killed one after the other on one line and state directory."""

    def __init__(self, folder: Path, drives: RecordedPlant, seed: int) -> None:
        self.drives, self.state, self.file = drives, folder / "state", folder / "plant.toml"
        self.rng, self.found = random.Random(seed), KillResults()
        self.file.write_text(PLANT_FILE.format(directory=json.dumps(str(self.state)), port=json.dumps(drives.url())))
        self.answers: list[str] = []
        self.log = folder / "log"

    def run_once(self) -> None:
        """Start a plant, check that it only reads, command its drives, kill it and check what it left."""
        began = time.monotonic()
        process = subprocess.Popen(
            [*COMMAND, "serve", str(self.file), "--without", "web"],
            stdout=subprocess.DEVNULL,
            stderr=self.log.open("wb"),
            env=os.environ | ENVIRONMENT,
        )
        try:
            wait_until(lambda: bool(self.drives.requests(since=began)), f"the first poll (see {self.log})")
            self.found.first_poll_s.append(round(self.drives.requests(since=began)[0].t - began, 3))
            time.sleep(QUIET_AFTER_START_S)
            self._only_reads(began)
            asyncio.run(self._command(process))
        finally:
            process.kill()
            process.wait()
        self.found.kills += 1
        self._check_state()

    def _only_reads(self, began: float) -> None:
        for frame in self.drives.requests(since=began):
            self.found.requests[str(frame.effect)] += 1
            if frame.effect not in HARMLESS_EFFECTS:
                self._violation(f"the restart itself sent {frame.data.hex()}, which is {frame.effect}")

    async def _command(self, process: subprocess.Popen[bytes]) -> None:
        """Send commands for both drives until the kill."""
        client = SocketClient(self.state / SERVICE_SOCKET)
        workers = [asyncio.create_task(self._work(client, drive)) for drive in ("one", "two")]
        await asyncio.sleep(self.rng.uniform(0.0, RUN_MAX_S))
        process.kill()
        for worker in workers:
            worker.cancel()
        await asyncio.gather(*workers, return_exceptions=True)
        with suppress(DrivebusError, OSError):
            await client.close()

    async def _work(self, client: SocketClient, drive: str) -> None:
        number = 0
        while True:
            number += 1
            reason = f"{self.found.kills}-{number}-{self.rng.randrange(10**9)}"
            with suppress(DrivebusError):
                await client.call("waiver.grant", {"drive": drive, "reason": reason}, KILL_TEST_ACTOR)
                self.answers.append(reason)
            with suppress(DrivebusError):
                await client.call("drive.run", {"drive": drive, "frequency_hz": 5.0 + number % 40}, KILL_TEST_ACTOR)
            with suppress(DrivebusError):
                await client.call("drive.stop", {"drive": drive}, KILL_TEST_ACTOR)
            await asyncio.sleep(0.01)

    def _check_state(self) -> None:
        answered, self.answers = self.answers, []
        self.found.answered += len(answered)
        audited = self._audited_waivers()
        for reason in answered:
            if reason not in audited:
                self._violation(f"waiver {reason} was answered and is not in the audit trail as done")
        verified = subprocess.run(
            [*COMMAND, "audit", "verify", str(self.state), "--json"],
            capture_output=True,
            text=True,
            env=os.environ | ENVIRONMENT,
            check=False,
        )
        if verified.returncode != 0:
            self._violation(f"the audit trail is not whole: {verified.stdout[-500:]}{verified.stderr[-500:]}")
        with sqlite3.connect(f"file:{self.state / 'history.db'}?mode=ro", uri=True) as store:
            if store.execute("pragma integrity_check").fetchone() != ("ok",):
                self._violation("the history's database is damaged")

    def _audited_waivers(self) -> set[str]:
        """Return the reasons of the waivers whose outcome in the trail is "done"."""
        lines = [line for file in sorted(self.state.glob("audit*.jsonl")) for line in file.read_text().splitlines()]
        entries: list[dict[str, Any]] = []
        for line in lines:
            with suppress(ValueError):  # the incomplete last line of the killed process
                entries.append(json.loads(line))
        done = [entry for entry in entries if entry.get("what") == "waiver.grant" and entry.get("outcome") == "done"]
        return {entry["params"]["reason"] for entry in done}

    def _violation(self, text: str) -> None:
        self.found.violations.append(f"kill {self.found.kills}: {text}")


def kill_repeatedly(count: int, seed: int, folder: Path) -> KillResults:
    """Start and kill ``count`` plants on one line, one after the other."""
    with recorded_plant(folder, LINE) as drives:
        service = KilledService(folder, drives, seed)
        for number in range(count):
            service.run_once()
            print(f"\r{number + 1}/{count}", end="", file=sys.stderr, flush=True)
    return service.found


def report(found: KillResults, seed: int) -> dict[str, Any]:
    times = sorted(found.first_poll_s)
    return {
        "campaign": "plant-kills",
        "evidence_for": ["I9", "I10"],
        "commit": current_commit(),
        "seed": seed,
        "kills": found.kills,
        "violations": found.violations,
        "upper_bound_95": None if found.violations else f"{3 / max(1, found.kills):.2g}",
        "answered_and_audited": found.answered,
        "frames_of_restarts": dict(found.requests),
        "machine": {"first_poll_s": {"p50": times[len(times) // 2], "max": times[-1]}, "goal_s": 5.0},
    }


def main() -> int:
    options = argparse.ArgumentParser(prog="python -m real.kill_service", description=__doc__)
    options.add_argument("--kills", type=int, default=1000)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--write", action="store_true", help=f"write the report to {REPORT.name}")
    chosen = options.parse_args()
    with tempfile.TemporaryDirectory(prefix="drivebus-kills-") as folder:
        os.environ["XDG_STATE_HOME"] = folder
        found = report(kill_repeatedly(chosen.kills, chosen.seed, Path(folder)), chosen.seed)
    print(json.dumps(found, indent=1))
    if chosen.write:
        REPORT.write_text(json.dumps(found, indent=1) + "\n")
    return int(bool(found["violations"]))


if __name__ == "__main__":
    sys.exit(main())
