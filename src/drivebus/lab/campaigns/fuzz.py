"""Garbage into every codec, both sides (G01, G02, I8).

For every codec and variant, random, damaged and glued frames are read as the reply to random lawful requests, and as
requests. Each is fed whole, byte by byte, as the codec asks, and in random pieces: one answer, ``need`` honest and
never shrinking, no exception but ``ProtocolError``. An independent judge says of every frame whether it is one that
the protocol can't tell from a true one; codec and judge must agree to the byte. What the judge calls lawful although
it came of garbage is the protocol's weakness, not the codec's: it is counted, and held to what its odds allow.
"""

from __future__ import annotations

from collections.abc import Iterator
from random import Random

from drivebus.lab.campaign import Campaign, Session
from drivebus.lab.codecs import cost, garbage
from drivebus.lab.codecs.garbage import RECKONED, SIZE, Found
from drivebus.lab.codecs.odds import limit
from drivebus.lab.codecs.roster import ROSTER
from drivebus.lab.crew import in_order

ALONE = 1_000_000
"""With no more bytes a codec than this, one process does it."""
Task = tuple[str, int, int, str]
"""Codec, number of the block, bytes, seed."""


def run(session: Session) -> None:
    """``session.budget`` bytes for each codec of the roster."""
    totals = {name: Found() for name in ROSTER}
    done = 0
    tasks = tuple(_tasks(session))
    for (name, number, _, _), found in zip(tasks, in_order(block, tasks, alone=session.budget <= ALONE), strict=True):
        totals[name].add(found)
        for line in found.lines:
            session.line(f"{name} {number} {line}")
        for text in found.violations:
            session.violation(f"seed {session.seed} block {number}: {text}")
        done += found.bytes
        session.did(max(0, done // len(ROSTER) - session.trials))
    for name, total in totals.items():
        _judge(session, name, total)
    session.machine["cost"] = cost.figures(session.rng("cost"))


def _tasks(session: Session) -> Iterator[Task]:
    """Block by block, all codecs in turn."""
    for number in range(-(-session.budget // SIZE)):
        size = min(SIZE, session.budget - number * SIZE)
        for name in ROSTER:
            yield name, number, size, f"{session.campaign}/{session.seed}/{name}/{number}"


def block(task: Task) -> Found:
    """One block; called in any process."""
    name, _, size, seed = task
    return garbage.block(ROSTER[name], Random(seed), size)


def _judge(session: Session, name: str, total: Found) -> None:
    """A codec's numbers, and whether chance explains what was taken."""
    session.count(f"{name} frames", sum(total.frames.values()))
    session.count(f"{name} bytes", total.bytes)
    for kind in RECKONED:
        taken, expected = total.accepted[kind], total.expected[kind]
        if taken > limit(expected):
            session.violation(
                f"G02 {name} {kind}: {taken} taken, {limit(expected):.1f} allowed, {expected:.3g} expected"
            )
    session.figures[name] = {
        "frames": dict(sorted(total.frames.items())),
        "outcomes": dict(sorted(total.outcomes.items())),
        "lawful_by_chance": {
            kind: {
                "taken": total.accepted[kind],
                "expected_at_most": float(f"{total.expected[kind]:.3g}"),
                "allowed": float(f"{limit(total.expected[kind]):.4g}"),
            }
            for kind in RECKONED
        },
        "lawful_by_judge": {k: n for k, n in sorted(total.accepted.items()) if k not in RECKONED},
    }


CAMPAIGN = Campaign("fuzz", "bytes per codec", ("G01", "G02", "I8", "I12", "T19"), 10**8, 2 * 10**5, run)
