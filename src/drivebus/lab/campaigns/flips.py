"""Every 1, 2 and 3 bit flip of every vector (G03).

For each frame of the manuals and each codec that may take it, the set of damaged frames that are taken must be the
one that was recorded, and the one that an independent judge enumerates. Where a CRC-16 stands it is empty, for every
vector that is valid as printed. What each check lets through, with and without parity, goes into the figures.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from drivebus.lab.campaign import Campaign, Session
from drivebus.lab.codecs import flipset, strength
from drivebus.lab.codecs.flipset import BITS, Case
from drivebus.lab.codecs.judges.modbus import crc
from drivebus.lab.crew import in_order

ALONE = 2_000_000
"""No more flips than this are done by one process."""
Task = tuple[Case, int]


def run(session: Session) -> None:
    """All single flips, all double ones, then triple ones of the cases in random order, while the budget lasts."""
    tasks = tuple(_tasks(session))
    results = in_order(enumerated, tasks, alone=session.budget <= ALONE)
    for (case, bits), (found, disputed) in zip(tasks, results, strict=True):
        _judge(session, case, bits, found, disputed)
        session.did(case.tried(bits))
    everything = session.trials >= FULL
    session.figures["cases"] = len({case.name for case, _ in tasks})
    session.figures["undetected"] = strength.table(3 if everything else 2)


def _tasks(session: Session) -> Iterator[Task]:
    every, planned = list(flipset.recorded()), 0
    for bits in BITS:
        if bits == max(BITS):
            session.rng("order").shuffle(every)
        for case in every:
            if planned >= session.budget:
                return
            planned += case.tried(bits)
            yield case, bits


def enumerated(task: Task) -> tuple[list[str], list[str]]:
    """One case; called in any process."""
    return flipset.accepted(*task)


def _judge(session: Session, case: Case, bits: int, found: list[str], disputed: list[str]) -> None:
    known = flipset.recorded()[case][str(bits)]
    now: dict[str, Any] = flipset.digest(found)
    told = f"{case.name}, {bits} bits"
    session.line(f"{told}: {now}")
    session.count(f"{case.codec} {case.role}: {bits} bits tried", case.tried(bits))
    session.count(f"{case.codec} {case.role}: {bits} bits accepted", len(found))
    if now != known:
        session.violation(f"{told}: {now}, recorded {known}")
    if disputed:
        session.violation(f"{told}: codec and judge disagree on {len(disputed)}, first {disputed[:3]}")
    if found and case.codec.endswith("rtu") and crc(case.frame) == 0:
        session.violation(f"{told}: {len(found)} pass a CRC-16, first {found[:3]}")


def _sizes() -> dict[int, int]:
    return {bits: sum(case.tried(bits) for case in flipset.recorded()) for bits in BITS}


FULL = sum(_sizes().values())
CAMPAIGN = Campaign("flips", "damaged frames", ("G03", "T11", "T21"), FULL, _sizes()[1] + _sizes()[2] + 200_000, run)
