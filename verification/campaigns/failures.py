"""``failures``: the n-th call fails, for n = 1, 2, … until a run has no failure.

Targets: the port (open, write, delivery, close; all variants), the store of save counts (errors, kill, power cut), a
capture, profiles, message catalogues, kernel timers, and the bus clock. A user's commands run through each failure:
nothing hangs, no file is torn, no foreign error escapes, stops are sent, and afterwards everything works.

The budget is the number of failing calls of each target; where a target has more calls, that many are drawn, with one
error each.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from verification.campaign import Campaign, CampaignRun
from verification.drive_variants import DriveVariant
from verification.families.registry import variants_for
from verification.fault_injection import faulty_disk as files
from verification.fault_injection.clocks import fail_kernel_timers, stall_clock
from verification.fault_injection.faulty_disk import FaultyDisk
from verification.fault_injection.faulty_port import PortFailureScenario, failure_modes

COVERED = variants_for("failures")
FailureMode = TypeVar("FailureMode")
FailingRun = Callable[[FaultyDisk], None]


def _os_errors(*names: str) -> tuple[dict[str, Any], ...]:
    return tuple({"error": OSError(code, os.strerror(code))} for code in (getattr(errno, name) for name in names))


KILL_MODE: dict[str, Any] = {"error": None}
SHORT_WRITE_MODE: dict[str, Any] = {"error": None, "short": True}
STORE_FAILURES = (*_os_errors("ENOSPC", "EIO", "EROFS", "EACCES"), KILL_MODE)
CAPTURE_FAILURES = (*_os_errors("ENOSPC", "EIO"), KILL_MODE, SHORT_WRITE_MODE)
READ_FAILURES = _os_errors("EIO", "EACCES", "EMFILE")


def _failing_calls(
    campaign_run: CampaignRun, target: str, modes_of_calls: Sequence[Sequence[FailureMode]]
) -> list[tuple[int, FailureMode]]:
    """Return the failing calls and their modes: all calls in every mode, or a random choice within the budget."""
    total, budget = len(modes_of_calls), campaign_run.budget
    campaign_run.figures[target] = {"calls": total, "failed": min(total, budget)}
    if total <= budget:
        return [(nth, mode) for nth, found in enumerate(modes_of_calls, 1) for mode in found]
    rng = campaign_run.rng(target)
    return [(nth, rng.choice(modes_of_calls[nth - 1])) for nth in sorted(rng.sample(range(1, total + 1), budget))]


def fail_port_calls(campaign_run: CampaignRun, variant: DriveVariant) -> None:
    def trial(nth: int = 0, error: str = "EIO", *, sends_anyway: bool = False) -> PortFailureScenario:
        name = f"{variant.name}/{nth}/{error}" + ("/sent" if sends_anyway else "")
        found = PortFailureScenario(campaign_run, variant, name)
        calls_of_runs.append(found.run_with_failure(nth, error, sends_anyway=sends_anyway))
        return found

    calls_of_runs: list[list[str]] = []
    trial()
    for nth, (error, sends_anyway) in _failing_calls(
        campaign_run, f"port {variant.name}", [failure_modes(call) for call in calls_of_runs[0]]
    ):
        if not trial(nth, error, sends_anyway=sends_anyway).port.failed:
            campaign_run.violation(f"{variant.name}: call {nth} of the port never came")
        campaign_run.add_trials()
    if trial(len(calls_of_runs[0]) + 1).port.failed:
        campaign_run.violation(f"{variant.name}: the run after the last call was not clean")


def fail_file_calls(
    campaign_run: CampaignRun,
    target: str,
    errors: Sequence[dict[str, Any]],
    play: FailingRun,
    place: Path | None = None,
) -> None:
    """Let the file calls fail, in ``place`` or in a new folder for each run."""

    def played(nth: int, **failure: Any) -> FaultyDisk:
        with TemporaryDirectory() as folder:
            found = FaultyDisk(place or Path(folder), nth, **failure)
            play(found)
        return found

    calls = played(0).calls
    for nth, failure in _failing_calls(campaign_run, target, [errors] * calls):
        found = played(nth, **failure)
        campaign_run.trace(f"{target} {nth} {failure.get('error') or 'killed'}: {found.failed}")
        campaign_run.count(f"{target}: {found.failed} failed")
        if not found.failed:
            campaign_run.violation(f"{target}: call {nth} never came")
        campaign_run.add_trials()
    if played(calls + 1, **errors[0]).failed:
        campaign_run.violation(f"{target}: the run after the last call was not clean")


def fail_counted_calls(campaign_run: CampaignRun, target: str, play: Callable[[CampaignRun, int], int]) -> None:
    """Let the calls of a target fail that has only one failure mode."""
    calls = play(campaign_run, 0)
    for nth, _ in _failing_calls(campaign_run, target, [(None,)] * calls):
        play(campaign_run, nth)
        campaign_run.trace(f"{target} {nth}")
        campaign_run.add_trials()


def run(campaign_run: CampaignRun) -> None:
    """Run every target; the store twice, as a kill and a power cut leave different files."""
    for variant in COVERED:
        fail_port_calls(campaign_run, variant)
    clean: list[str] = []
    records: list[bytes] = []
    fail_file_calls(campaign_run, "store", STORE_FAILURES, partial(files.fail_store, campaign_run))
    fail_file_calls(campaign_run, "store, power cut", (KILL_MODE,), partial(files.fail_store, campaign_run, power=True))
    fail_file_calls(
        campaign_run, "capture", CAPTURE_FAILURES, lambda disk: files.fail_capture(campaign_run, disk, clean, records)
    )
    fail_file_calls(campaign_run, "profiles", READ_FAILURES, partial(files.fail_profile, campaign_run), files.PROFILES)
    fail_file_calls(
        campaign_run, "sentences", READ_FAILURES, partial(files.fail_catalogue, campaign_run), files.SENTENCES
    )
    fail_counted_calls(campaign_run, "kernel timers", fail_kernel_timers)
    fail_counted_calls(campaign_run, "still clock", stall_clock)


CAMPAIGN = Campaign(
    name="failures",
    summary={"en": "The n-th call fails, for every n.", "zh": "第 n 次调用失败，遍历每个 n。"},
    unit="calls",
    evidence_for=(
        "I6",
        "I8",
        "I10",
    ),
    full_budget=10_000,
    ci_budget=4,
    run=run,
)
