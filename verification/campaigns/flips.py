"""``flips``: every 1, 2 and 3 bit flip of every worked frame.

For each frame and each codec that may decode it, the set of accepted damaged frames must be the recorded one and the
one of the reference codec. Under a CRC-16 it must be empty for every frame that is valid as printed. The figures give
what each check lets through, with and without parity.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from verification.campaign import Campaign, CampaignRun, map_in_order
from verification.codec_fuzz import bit_flips
from verification.codec_fuzz.bit_flips import FLIP_COUNTS, FlipCase
from verification.reference.modbus import reference_crc

IN_PROCESS_MAX_FLIPS = 2_000_000
"""Largest number of flips for one process."""
FlipTask = tuple[FlipCase, int]


def run(campaign_run: CampaignRun) -> None:
    """Try all single flips, all double flips, then triple flips of the cases in random order, within the budget."""
    tasks = tuple(_tasks(campaign_run))
    results = map_in_order(enumerate_case, tasks, in_process=campaign_run.budget <= IN_PROCESS_MAX_FLIPS)
    for (case, bits), (found, disputed) in zip(tasks, results, strict=True):
        _compare_with_record(campaign_run, case, bits, found, disputed)
        campaign_run.add_trials(case.pattern_count(bits))
    everything = campaign_run.trials >= FULL_BUDGET
    campaign_run.figures["cases"] = len({case.name for case, _ in tasks})
    campaign_run.figures["undetected"] = bit_flips.undetected_shares(3 if everything else 2)


def _tasks(campaign_run: CampaignRun) -> Iterator[FlipTask]:
    every, planned = [case for case in bit_flips.recorded_cases() if campaign_run.covers(case.codec)], 0
    for bits in FLIP_COUNTS:
        if bits == max(FLIP_COUNTS):
            campaign_run.rng("order").shuffle(every)
        for case in every:
            if planned >= campaign_run.budget:
                return
            planned += case.pattern_count(bits)
            yield case, bits


def enumerate_case(task: FlipTask) -> tuple[list[str], list[str]]:
    """Enumerate one case, in any process."""
    return bit_flips.accepted_flips(*task)


def _compare_with_record(
    campaign_run: CampaignRun, case: FlipCase, bits: int, found: list[str], disputed: list[str]
) -> None:
    known = bit_flips.recorded_cases()[case][str(bits)]
    now: dict[str, Any] = bit_flips.flips_digest(found)
    message = f"{case.name}, {bits} bits"
    campaign_run.trace(f"{message}: {now}")
    campaign_run.count(f"{case.codec} {case.role}: {bits} bits tried", case.pattern_count(bits))
    campaign_run.count(f"{case.codec} {case.role}: {bits} bits accepted", len(found))
    if now != known:
        campaign_run.violation(f"{message}: {now}, recorded {known}")
    if disputed:
        campaign_run.violation(f"{message}: codec and reference disagree on {len(disputed)}, first {disputed[:3]}")
    if found and case.codec.endswith("rtu") and reference_crc(case.frame) == 0:
        campaign_run.violation(f"{message}: {len(found)} pass a CRC-16, first {found[:3]}")


def _sizes() -> dict[int, int]:
    return {bits: sum(case.pattern_count(bits) for case in bit_flips.recorded_cases()) for bits in FLIP_COUNTS}


FULL_BUDGET = sum(_sizes().values())
CAMPAIGN = Campaign(
    name="flips",
    summary={"en": "Every 1, 2 and 3 bit flip of every worked frame.", "zh": "每个示例帧的所有 1、2、3 位翻转。"},
    unit="damaged frames",
    evidence_for=(
        "T11",
        "T21",
    ),
    full_budget=FULL_BUDGET,
    ci_budget=_sizes()[1] + _sizes()[2],
    run=run,
)
