"""Garbage into every codec, both sides (I8).

For every codec and variant, random, damaged and glued frames are read as the reply to random lawful requests, and as
requests. Each is fed whole, byte by byte, as the codec asks, and in random pieces: one answer, ``need`` honest and
never shrinking, no exception but ``ProtocolError``. An independent judge says of every frame whether it is one that
the protocol can't tell from a true one; codec and judge must agree to the byte. What the judge calls lawful although
it came of garbage is the protocol's weakness, not the codec's: it is counted, and held to what its odds allow.
"""

from __future__ import annotations

from collections.abc import Iterator
from random import Random

from verification.campaign import Campaign, CampaignRun
from verification.codec_fuzz import decode_cost
from verification.codec_fuzz import fuzz_block as garbage
from verification.codec_fuzz.collision_odds import false_accept_limit
from verification.codec_fuzz.fuzz_block import BLOCK_BYTES, CHANCE_DAMAGE_KINDS, BlockResult
from verification.codec_fuzz.registry import FUZZED_CODECS
from verification.pool import map_in_order

IN_PROCESS_MAX_BYTES = 1_000_000
"""With no more bytes a codec than this, one process does it."""
FuzzTask = tuple[str, int, int, str]
"""Codec, number of the block, bytes, seed."""


def run(session: CampaignRun) -> None:
    """``session.budget`` bytes for each codec of the roster."""
    totals = {name: BlockResult() for name in FUZZED_CODECS}
    done = 0
    tasks = tuple(_tasks(session))
    for (name, number, _, _), found in zip(
        tasks, map_in_order(fuzz_block, tasks, in_process=session.budget <= IN_PROCESS_MAX_BYTES), strict=True
    ):
        totals[name].add(found)
        for line in found.lines:
            session.trace(f"{name} {number} {line}")
        for text in found.violations:
            session.violation(f"seed {session.seed} block {number}: {text}")
        done += found.bytes
        session.add_trials(max(0, done // len(FUZZED_CODECS) - session.trials))
    for name, total in totals.items():
        _check_totals(session, name, total)
    session.machine["cost"] = decode_cost.decode_costs(session.rng("cost"))


def _tasks(session: CampaignRun) -> Iterator[FuzzTask]:
    """Block by block, all codecs in turn."""
    for number in range(-(-session.budget // BLOCK_BYTES)):
        size = min(BLOCK_BYTES, session.budget - number * BLOCK_BYTES)
        for name in FUZZED_CODECS:
            yield name, number, size, f"{session.campaign}/{session.seed}/{name}/{number}"


def fuzz_block(task: FuzzTask) -> BlockResult:
    """One block; called in any process."""
    name, _, size, seed = task
    return garbage.run_block(FUZZED_CODECS[name], Random(seed), size)


def _check_totals(session: CampaignRun, name: str, total: BlockResult) -> None:
    """A codec's numbers, and whether chance explains what was taken."""
    session.count(f"{name} frames", sum(total.frames.values()))
    session.count(f"{name} bytes", total.bytes)
    for kind in CHANCE_DAMAGE_KINDS:
        taken, expected = total.accepted[kind], total.expected[kind]
        if taken > false_accept_limit(expected):
            session.violation(
                f"G02 {name} {kind}: {taken} taken, {false_accept_limit(expected):.1f} allowed, {expected:.3g} expected"
            )
    session.figures[name] = {
        "frames": dict(sorted(total.frames.items())),
        "outcomes": dict(sorted(total.outcomes.items())),
        "lawful_by_chance": {
            kind: {
                "taken": total.accepted[kind],
                "expected_at_most": float(f"{total.expected[kind]:.3g}"),
                "allowed": float(f"{false_accept_limit(total.expected[kind]):.4g}"),
            }
            for kind in CHANCE_DAMAGE_KINDS
        },
        "lawful_by_judge": {k: n for k, n in sorted(total.accepted.items()) if k not in CHANCE_DAMAGE_KINDS},
    }


CAMPAIGN = Campaign(
    name="fuzz",
    summary={"en": "Garbage bytes into every codec.", "zh": "向每个编解码器灌入乱码。"},
    unit="bytes per codec",
    evidence_for=(
        "I8",
        "I12",
        "T19",
    ),
    full_budget=10**8,
    ci_budget=2 * 10**5,
    run=run,
)
