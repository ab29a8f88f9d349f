"""``late``: 0 to 20 % of all replies are late by up to 5 s; none may be accepted for another request (I5).

Stations reply in the order of the requests, however late: no sync probe could detect a drive that does not. Two checks
decide: the oracle by the request that caused the delivered frame, and ``ReplyLog`` by the reply that the station made
for it. A baseline master on the same bus shows that wrong replies could be accepted.
"""

from __future__ import annotations

import asyncio
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import count
from random import Random
from typing import Any

from drivebus.bus import Poll
from drivebus.ports import open_port
from drivebus.testing.virtual_time import VirtualLoop, running
from verification.campaign import Campaign, CampaignRun, PartResult, map_in_order
from verification.drive_variants import DriveVariant
from verification.families.campaigns import campaign_of
from verification.families.registry import variants_for
from verification.scenario.reply_log import BaselineHost, LateReplyCounter, ReplyLog
from verification.scenario.scenario import Scenario

COVERED = variants_for("late")
LATE_ADDRESSES = (1, 2, 3, 4, 5)
LATE_SHARES = (0.0, 0.001, 0.01, 0.05, 0.1, 0.2)
LATENESS_STEPS_S = (0.15, 0.5, 2.0, 5.0, 5.0, 5.0)
TRANSACTIONS_PER_CHUNK = 2000
"""Transactions of one bus, before the next share and lateness."""
CHUNKS_PER_BLOCK = 25
"""Chunks of each variant that a process runs before it takes the next block."""
BASELINE_SHARE = 0.05
"""Transactions of the baseline host, as a share of the bus's."""
STEP_S = 2.0
CHUNK_MAX_S = 3600.0
"""Longest virtual time of a chunk, in seconds: a bus that sends nothing more must not hang the campaign."""
READ_PAUSE_S = 0.4


def similar_reads(variant: DriveVariant, address: int) -> tuple[Any, ...]:
    """Return reads of one value each whose replies have the same form; all values change."""
    return campaign_of(variant.model).similar_reads(variant, address)


class LateReplyBus:
    """Bus with late replies, polled with requests whose replies have the same form."""

    def __init__(self, campaign_run: CampaignRun, variant: DriveVariant, name: str, rng: Random) -> None:
        self.variant, self.rng, self.campaign_run = variant, rng, campaign_run
        self.share, self.late_s = rng.choice(LATE_SHARES), rng.choice(LATENESS_STEPS_S)
        self.seed, self.bytes = rng.randrange(2**31), rng.random() < 0.1
        self.counts: Counter[str] = Counter()
        self.scenario = scenario = Scenario(campaign_run, variant, LATE_ADDRESSES, name=name, seed=self.seed)
        scenario.simulated_bus.line_quality = self.line_quality
        self.reply_log, self.late_replies = ReplyLog(scenario.simulated_bus), LateReplyCounter(scenario, self.counts)
        self._product_accept, self.accepted = scenario.bus.core._accept_reply, 0
        scenario.bus.core._accept_reply = self._on_accept  # type: ignore[method-assign]
        scenario.monitor(rng.choice(LATE_ADDRESSES))
        with running(scenario.loop):
            for address in LATE_ADDRESSES:
                polls = [Poll(request, 0.0) for request in similar_reads(variant, address)]
                scenario.bus.start_polling(address, polls, lambda answer: None)
            scenario.loop.create_task(self._read_parameters())

    @property
    def line_quality(self) -> str:
        return f"late={self.share}:{self.late_s}" + (",bytes" if self.bytes else "")

    async def _read_parameters(self) -> None:
        """Read parameters at random times, where the model has some."""
        listed = campaign_of(self.variant.model).late_parameters.get(self.variant.model, ())
        while listed:
            await asyncio.sleep(self.rng.expovariate(1 / READ_PAUSE_S))
            names = self.rng.sample(listed, 2)
            await self.scenario.drives[self.rng.choice(LATE_ADDRESSES)].read(names)

    def _on_accept(self, transaction: Any, now: float) -> None:
        """Check every reply that the bus accepts, replies to sync probes included."""
        self.accepted += 1
        self.late_replies.on_accepted(transaction.last_byte_at)
        times = transaction.prepared.station.address, transaction.sent_at, transaction.last_byte_at
        if self.reply_log.matches(*times, transaction.buffer):
            pass
        elif not self.variant.has_checksum and self._collided(transaction, *times):
            self.counts["right reply, damaged by another station's late reply, accepted"] += 1
        else:
            self.scenario.oracle.violation(
                f"wrong reply: {transaction.buffer.hex()} is no reply to {transaction.prepared.data.hex()}"
            )
        self._product_accept(transaction, now)

    def _collided(self, transaction: Any, address: int, sent_at: float, received_at: float) -> bool:
        """Return whether the only reply to this request collided with another station's late reply."""
        made = self.reply_log.replies_between(address, sent_at, received_at)
        return [len(reply) for reply in made] == [len(transaction.buffer)] and self.late_replies.collided(received_at)

    def run_transactions(self, frames: int) -> None:
        """Run at least this number of transactions."""
        end = self.scenario.loop.time() + CHUNK_MAX_S
        while self.scenario.oracle.request_count < frames and self.scenario.loop.time() < end:
            self.scenario.run(STEP_S)
        oracle = self.scenario.oracle
        if oracle.request_count < frames or not 0 < oracle.accepted_count <= self.accepted:
            answers = f"{oracle.accepted_count} or {self.accepted} answers"
            oracle.violation(
                f"{oracle.request_count} requests and {answers} in {CHUNK_MAX_S} s: too few, or missed by the oracle"
            )
        self.scenario.close()

    def run_baseline(self, frames: int) -> Counter[str]:
        """Run the baseline host with the same line quality and seed."""
        loop, counts = VirtualLoop(), Counter[str]()
        reads = [
            (address, self.scenario.drives[address].dialect.codec.encode_request(request))
            for address in LATE_ADDRESSES
            for request in similar_reads(self.variant, address)
        ]
        with running(loop):
            options = {"baud": self.variant.baud, "seed": self.seed, **self.variant.options}
            query = "&".join(f"{name}={value}" for name, value in options.items())
            port: Any = open_port(f"sim://{self.variant.model}@{','.join(map(str, LATE_ADDRESSES))}?{query}")
            port.simulated_bus.line_quality = self.line_quality
            port.simulated_bus.now()
            reply_log = ReplyLog(port.simulated_bus)

            def on_accepted(address: int, sent_at: float, now: float, data: bytes) -> None:
                counts["accepted"] += 1
                counts["misattributed"] += not reply_log.matches(address, sent_at, now, data)

            host = BaselineHost(self.variant, port, loop, reads, on_accepted)
        loop.run_until_complete(host.open())
        while host.frames < frames:
            loop.run_until(loop.time() + STEP_S)
        counts["transactions"] += host.frames
        return counts


@dataclass(frozen=True, slots=True, kw_only=True)
class LateReplyBlock:
    """Chunks of all variants that one process runs, numbered from ``first``."""

    seed: int
    first: int
    transactions: int
    """Of each variant."""
    only: frozenset[str]


@dataclass(frozen=True, slots=True, kw_only=True)
class LateReplyResult:
    """Result of a block: its trials, and the counts of each variant by name."""

    part: PartResult
    found: dict[str, Counter[str]]
    baseline: dict[str, Counter[str]]


def run(campaign_run: CampaignRun) -> None:
    """Run blocks of chunks, from two processes where there is more than one, until each variant has done the budget."""
    variants = tuple(variant for variant in COVERED if campaign_run.covers(variant.name))
    found: dict[str, Counter[str]] = {variant.name: Counter() for variant in variants}
    baseline: dict[str, Counter[str]] = {variant.name: Counter() for variant in variants}
    blocks = tuple(_blocks(campaign_run))
    in_process = len(blocks) == 1 or campaign_run.listener is not None
    for result in map_in_order(partial(run_block, campaign_run.listener), blocks, in_process=in_process):
        campaign_run.merge(result.part)
        for variant in variants:
            found[variant.name].update(result.found[variant.name])
            baseline[variant.name].update(result.baseline[variant.name])
    _report_results(campaign_run, variants, found, baseline)


def _blocks(campaign_run: CampaignRun) -> Iterator[LateReplyBlock]:
    size = CHUNKS_PER_BLOCK * TRANSACTIONS_PER_CHUNK
    for number, start in enumerate(range(0, campaign_run.budget, size)):
        yield LateReplyBlock(
            seed=campaign_run.seed,
            first=number * CHUNKS_PER_BLOCK,
            transactions=min(size, campaign_run.budget - start),
            only=campaign_run.only,
        )


def run_block(listener: Callable[[str], None] | None, block: LateReplyBlock) -> LateReplyResult:
    """Run the chunks of one block, all variants in turn, in any process."""
    campaign_run = CampaignRun(
        campaign="late", seed=block.seed, budget=block.transactions, only=block.only, listener=listener
    )
    found, baseline = defaultdict[str, Counter[str]](Counter), defaultdict[str, Counter[str]](Counter)
    for number in count(block.first):
        frames = min(TRANSACTIONS_PER_CHUNK, campaign_run.remaining)
        if not frames:
            break
        for variant in (variant for variant in COVERED if campaign_run.covers(variant.name)):
            bus = LateReplyBus(
                campaign_run, variant, f"{variant.name}/{number}", campaign_run.rng(variant.name, number)
            )
            bus.run_transactions(frames)
            found[variant.name].update(bus.counts, transactions=bus.scenario.oracle.request_count)
            baseline[variant.name].update(bus.run_baseline(max(1, int(frames * BASELINE_SHARE))))
        campaign_run.add_trials(frames)
    return LateReplyResult(part=campaign_run.result(), found=dict(found), baseline=dict(baseline))


def _report_results(
    campaign_run: CampaignRun,
    variants: tuple[DriveVariant, ...],
    found: dict[str, Counter[str]],
    baseline: dict[str, Counter[str]],
) -> None:
    campaign_run.figures["order"] = "stations reply in the order of the requests, however late"
    for variant in variants:
        shown: dict[str, object] = {
            "longest_lateness_s": variant.max_reply_lateness_s,
            **dict(sorted(found[variant.name].items())),
        }
        campaign_run.figures[variant.name] = shown | {"baseline_host": dict(sorted(baseline[variant.name].items()))}
        campaign_run.trace(f"{variant.name}: {campaign_run.figures[variant.name]}")


CAMPAIGN = Campaign(
    name="late",
    summary={"en": "Late replies are never accepted.", "zh": "迟到的应答绝不采信。"},
    unit="transactions of each kind",
    evidence_for=(
        "I5",
        "I4",
        "T04",
    ),
    full_budget=10**7,
    ci_budget=2000,
    run=run,
)
