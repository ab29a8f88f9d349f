"""``fuzz``: garbage into every codec, on both sides (I8).

Random, damaged and joined frames are decoded as replies to random valid requests, and as requests: whole, byte by byte
and in random pieces. The result must be the same, ``need`` correct, and no exception but ``ProtocolError`` may escape.
The reference codec decides which frames are valid; frames that are valid by chance are counted and compared with their
odds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from random import Random
from time import perf_counter

from verification.campaign import Campaign, CampaignRun, map_in_order
from verification.codec_fuzz.collision_odds import false_accept_limit
from verification.codec_fuzz.fuzz_block import (
    BLOCK_BYTES,
    CHANCE_DAMAGE_KINDS,
    DecodeFunction,
    FuzzResult,
    decode_outcome,
    run_block,
)
from verification.codec_fuzz.fuzzed_codec import FuzzedCodec
from verification.families.campaigns import FUZZED_CODECS

# --- cost of decoding -------------------------------------------------------------------------------------------------

GARBAGE_LENGTH = 256


def decode_costs(rng: Random) -> dict[str, dict[str, float]]:
    """Return for each codec, in microseconds: a byte of garbage of frame length; the worst 256 bytes, whole (also in
    bare loops) and fed one by one."""
    return {name: _codec_costs(rng, entry) for name, entry in FUZZED_CODECS.items()}


def garbage(rng: Random, entry: FuzzedCodec) -> list[bytes]:
    """Return garbage of 256 bytes each, random or starting like a request or a reply."""
    heads = [b"", bytes((1, 0x63)) if entry.codec.encoding == "rtu" else b":0163"]
    for _ in range(8):
        exchange = entry.make_exchange(rng, entry.codec)
        heads += [frame[:keep] for frame in (exchange.sent, exchange.received) for keep in (1, 2, 4, 8, len(frame) - 3)]
    return [(head + bytes(rng.choices(entry.alphabet, k=GARBAGE_LENGTH)))[:GARBAGE_LENGTH] for head in heads]


def decoders(rng: Random, entry: FuzzedCodec) -> tuple[DecodeFunction, DecodeFunction]:
    """Return the decoders of the master's and the station's side."""
    return partial(entry.codec.decode_reply, entry.make_exchange(rng, entry.codec).request), entry.codec.decode_request


def _codec_costs(rng: Random, entry: FuzzedCodec) -> dict[str, float]:
    both, long = decoders(rng, entry), garbage(rng, entry)
    short = [rng.randbytes(rng.randrange(1, 40)) for _ in range(500)]
    mean = sum(_seconds(partial(decode_outcome, decode, data)) for decode in both for data in short) / sum(
        map(len, short)
    )
    worst = max(_seconds(partial(decode_outcome, decode, data)) for decode in both for data in long)
    bare = _seconds(partial(_bare_loop, long[0]))
    return {
        "us_per_byte": round(mean / len(both) * 1e6, 3),
        "worst_256_us": round(worst * 1e6, 1),
        "worst_256_in_loops": round(worst / bare, 1),
        "worst_256_one_by_one_us": round(max(_one_by_one(decode, data) for decode in both for data in long[:12]) * 1e6),
    }


def _one_by_one(decode: DecodeFunction, data: bytes) -> float:
    return sum(_seconds(partial(decode_outcome, decode, data[:end])) for end in range(1, len(data) + 1))


def _seconds(work: Callable[[], object]) -> float:
    """Return the shortest of five times, which excludes pauses of the machine."""
    best = float("inf")
    for _ in range(5):
        start = perf_counter()
        work()
        best = min(best, perf_counter() - start)
    return best


def _bare_loop(data: bytes) -> None:
    for byte in data:
        byte & 0x0F


# --- campaign ---------------------------------------------------------------------------------------------------------

IN_PROCESS_MAX_BYTES = 1_000_000
"""Largest number of bytes per codec for one process."""
FuzzTask = tuple[str, int, int, str]
"""Codec, number of the block, bytes, seed."""


def run(campaign_run: CampaignRun) -> None:
    """Fuzz each codec with the budget in bytes."""
    totals = {name: FuzzResult() for name in FUZZED_CODECS if campaign_run.covers(name)}
    done = 0
    tasks = tuple(_tasks(campaign_run))
    for (name, number, _, _), found in zip(
        tasks, map_in_order(fuzz_block, tasks, in_process=campaign_run.budget <= IN_PROCESS_MAX_BYTES), strict=True
    ):
        totals[name].add(found)
        for line in found.lines:
            campaign_run.trace(f"{name} {number} {line}")
        for text in found.violations:
            campaign_run.violation(f"seed {campaign_run.seed} block {number}: {text}")
        done += found.bytes
        campaign_run.add_trials(max(0, done // len(totals) - campaign_run.trials))
    for name, total in totals.items():
        _check_totals(campaign_run, name, total)
    if campaign_run.budget >= CAMPAIGN.full_budget:
        campaign_run.machine["cost"] = decode_costs(campaign_run.rng("cost"))


def _tasks(campaign_run: CampaignRun) -> Iterator[FuzzTask]:
    """Yield the blocks, all codecs in turn."""
    for number in range(-(-campaign_run.budget // BLOCK_BYTES)):
        size = min(BLOCK_BYTES, campaign_run.budget - number * BLOCK_BYTES)
        for name in filter(campaign_run.covers, FUZZED_CODECS):
            yield name, number, size, f"{campaign_run.campaign}/{campaign_run.seed}/{name}/{number}"


def fuzz_block(task: FuzzTask) -> FuzzResult:
    """Run one block, in any process."""
    name, _, size, seed = task
    return run_block(FUZZED_CODECS[name], Random(seed), size)


def _check_totals(campaign_run: CampaignRun, name: str, total: FuzzResult) -> None:
    """Report a codec's figures; more accepted frames than random damage explains are a violation."""
    campaign_run.count(f"{name} frames", sum(total.frames.values()))
    campaign_run.count(f"{name} bytes", total.bytes)
    for kind in CHANCE_DAMAGE_KINDS:
        taken, expected = total.accepted[kind], total.expected[kind]
        if taken > false_accept_limit(expected):
            campaign_run.violation(
                f"by chance: {name} {kind}: {taken} accepted, {false_accept_limit(expected):.1f} allowed"
            )
    campaign_run.figures[name] = {
        "frames": dict(sorted(total.frames.items())),
        "outcomes": dict(sorted(total.outcomes.items())),
        "valid_by_chance": {
            kind: {
                "taken": total.accepted[kind],
                "expected_at_most": float(f"{total.expected[kind]:.3g}"),
                "allowed": float(f"{false_accept_limit(total.expected[kind]):.4g}"),
            }
            for kind in CHANCE_DAMAGE_KINDS
        },
        "valid_by_reference": {k: n for k, n in sorted(total.accepted.items()) if k not in CHANCE_DAMAGE_KINDS},
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
    ci_budget=50_000,
    run=run,
)
