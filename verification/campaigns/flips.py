"""Every 1, 2 and 3 bit flip of every vector.

For each frame of the manuals and each codec that may take it, the set of damaged frames that are taken must be the
one that was recorded, and the one that an independent judge enumerates. Where a CRC-16 stands it is empty, for every
vector that is valid as printed. What each check lets through, with and without parity, goes into the figures.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from verification.campaign import Campaign, CampaignRun
from verification.codec_fuzz import bit_flips, check_strength
from verification.codec_fuzz.bit_flips import FLIP_COUNTS, FlipCase
from verification.pool import map_in_order
from verification.reference.modbus import reference_crc

IN_PROCESS_MAX_FLIPS = 2_000_000
"""No more flips than this are done by one process."""
FlipTask = tuple[FlipCase, int]


def run(session: CampaignRun) -> None:
    """All single flips, all double ones, then triple ones of the cases in random order, while the budget lasts."""
    tasks = tuple(_tasks(session))
    results = map_in_order(enumerate_case, tasks, in_process=session.budget <= IN_PROCESS_MAX_FLIPS)
    for (case, bits), (found, disputed) in zip(tasks, results, strict=True):
        _compare_with_record(session, case, bits, found, disputed)
        session.add_trials(case.pattern_count(bits))
    everything = session.trials >= FULL_BUDGET
    session.figures["cases"] = len({case.name for case, _ in tasks})
    session.figures["undetected"] = check_strength.undetected_shares(3 if everything else 2)


def _tasks(session: CampaignRun) -> Iterator[FlipTask]:
    every, planned = list(bit_flips.recorded_cases()), 0
    for bits in FLIP_COUNTS:
        if bits == max(FLIP_COUNTS):
            session.rng("order").shuffle(every)
        for case in every:
            if planned >= session.budget:
                return
            planned += case.pattern_count(bits)
            yield case, bits


def enumerate_case(task: FlipTask) -> tuple[list[str], list[str]]:
    """One case; called in any process."""
    return bit_flips.accepted_flips(*task)


def _compare_with_record(
    session: CampaignRun, case: FlipCase, bits: int, found: list[str], disputed: list[str]
) -> None:
    known = bit_flips.recorded_cases()[case][str(bits)]
    now: dict[str, Any] = bit_flips.flips_digest(found)
    message = f"{case.name}, {bits} bits"
    session.trace(f"{message}: {now}")
    session.count(f"{case.codec} {case.role}: {bits} bits tried", case.pattern_count(bits))
    session.count(f"{case.codec} {case.role}: {bits} bits accepted", len(found))
    if now != known:
        session.violation(f"{message}: {now}, recorded {known}")
    if disputed:
        session.violation(f"{message}: codec and judge disagree on {len(disputed)}, first {disputed[:3]}")
    if found and case.codec.endswith("rtu") and reference_crc(case.frame) == 0:
        session.violation(f"{message}: {len(found)} pass a CRC-16, first {found[:3]}")


def _sizes() -> dict[int, int]:
    return {bits: sum(case.pattern_count(bits) for case in bit_flips.recorded_cases()) for bits in FLIP_COUNTS}


FULL_BUDGET = sum(_sizes().values())
CAMPAIGN = Campaign(
    name="flips",
    summary={"en": "Every 1, 2 and 3 bit flip of every vector.", "zh": "每个样例帧的所有 1、2、3 位翻转。"},
    unit="damaged frames",
    evidence_for=(
        "T11",
        "T21",
    ),
    full_budget=FULL_BUDGET,
    ci_budget=_sizes()[1] + _sizes()[2] + 200_000,
    run=run,
)
