"""``failures``: the n-th call fails, for n = 1, 2, … until a run comes through clean, seam by seam.

Seams: the port (open, write, delivery, close; all families), the store of counts (each call of the system to its
files; the program killed there; the power cut there), a capture, profiles, the catalogues of sentences, kernel timers,
and a bus's own clock that stands still. Each time a user's whole story is lived through the failure: no hang, no torn
file, no error that is not ours, stops go, and afterwards everything works again.

The budget is how many calls of each seam fail: where it has more, so many are drawn, and one error for each.
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
from verification.drive_variants import DRIVE_VARIANTS, DriveVariant
from verification.fault_injection import file_failures as files
from verification.fault_injection.clock_failures import fail_kernel_timers, stall_clock
from verification.fault_injection.faulty_disk import FaultyDisk
from verification.fault_injection.faulty_port import failure_modes
from verification.fault_injection.port_failures import PortFailureScenario

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
    session: CampaignRun, seam: str, ways_of: Sequence[Sequence[FailureMode]]
) -> list[tuple[int, FailureMode]]:
    """Which calls fail, and how: all in every way, or as many as the budget allows, each in one."""
    total, budget = len(ways_of), session.budget
    session.figures[seam] = {"calls": total, "failed": min(total, budget)}
    if total <= budget:
        return [(nth, way) for nth, found in enumerate(ways_of, 1) for way in found]
    chance = session.rng(seam)
    return [(nth, chance.choice(ways_of[nth - 1])) for nth in sorted(chance.sample(range(1, total + 1), budget))]


def fail_port_calls(session: CampaignRun, kind: DriveVariant) -> None:
    def story(nth: int = 0, error: str = "EIO", late: bool = False) -> PortFailureScenario:
        name = f"{kind.name}/{nth}/{error}" + ("/sent" if late else "")
        found = PortFailureScenario(session, kind, name)
        row.append(found.run_with_failure(nth, error, late))
        return found

    row: list[list[str]] = []
    story()
    for nth, (error, late) in _failing_calls(session, f"port {kind.name}", [failure_modes(call) for call in row[0]]):
        if not story(nth, error, late).port.failed:
            session.violation(f"{kind.name}: call {nth} of the port never came")
        session.add_trials()
    if story(len(row[0]) + 1).port.failed:
        session.violation(f"{kind.name}: the run after the last call was not clean")


def fail_file_calls(
    session: CampaignRun, seam: str, errors: Sequence[dict[str, Any]], play: FailingRun, place: Path | None = None
) -> None:
    """Files in ``place``, else in a new folder for each run."""

    def played(nth: int, **how: Any) -> FaultyDisk:
        with TemporaryDirectory() as folder:
            found = FaultyDisk(place or Path(folder), nth, **how)
            play(found)
        return found

    calls = played(0).calls
    for nth, how in _failing_calls(session, seam, [errors] * calls):
        found = played(nth, **how)
        session.trace(f"{seam} {nth} {how.get('error') or 'killed'}: {found.failed}")
        session.count(f"{seam}: {found.failed} failed")
        if not found.failed:
            session.violation(f"{seam}: call {nth} never came")
        session.add_trials()
    if played(calls + 1, **errors[0]).failed:
        session.violation(f"{seam}: the run after the last call was not clean")


def fail_counted_calls(session: CampaignRun, seam: str, play: Callable[[CampaignRun, int], int]) -> None:
    """A seam that fails in one way only."""
    calls = play(session, 0)
    for nth, _ in _failing_calls(session, seam, [(None,)] * calls):
        play(session, nth)
        session.trace(f"{seam} {nth}")
        session.add_trials()


def run(session: CampaignRun) -> None:
    """Every seam; two for the store, as a killed program and a cut power leave different files."""
    for kind in DRIVE_VARIANTS:
        fail_port_calls(session, kind)
    clean: list[str] = []
    records: list[bytes] = []
    fail_file_calls(session, "store", STORE_FAILURES, partial(files.fail_store, session))
    fail_file_calls(session, "store, power cut", (KILL_MODE,), partial(files.fail_store, session, power=True))
    fail_file_calls(session, "capture", CAPTURE_FAILURES, lambda one: files.fail_capture(session, one, clean, records))
    fail_file_calls(session, "profiles", READ_FAILURES, partial(files.fail_profile, session), files.PROFILES)
    fail_file_calls(session, "sentences", READ_FAILURES, partial(files.fail_catalogue, session), files.SENTENCES)
    fail_counted_calls(session, "kernel timers", fail_kernel_timers)
    fail_counted_calls(session, "still clock", stall_clock)


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
    ci_budget=8,
    run=run,
)
