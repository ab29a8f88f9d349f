"""``late`` (I5): shares of 0 to 20 % of all replies come late, by up to 5 s; none may answer another question.

Stations answer in the order in which they were asked, however late (the wire holds a reply back behind an earlier
one): no fence could tell anything of a drive that does not. So what is shown is ruling 2's: lateness up to the
quarantine, and beyond it in order; the figures tell how many replies came later than the family's longest lateness.

Two judges: the witness (I5: the request that caused the delivered frame), and ``Maker``: between asking and hearing
the station made exactly this reply, and it never shows the same values twice in a row. A naive host on the same line
shows that there were mistakes to be made.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from random import Random
from typing import Any

from drivebus.bus import Poll
from drivebus.ports import open_port
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.testing.virtual_time import VirtualLoop, running
from verification.campaign import Campaign, CampaignRun
from verification.drive_variants import DRIVE_VARIANTS, DriveVariant
from verification.scenario.baseline_host import BaselineHost
from verification.scenario.reply_log import LateReplyCounter, ReplyLog
from verification.scenario.scenario import Scenario

LATE_ADDRESSES = (1, 2, 3, 4, 5)
LATE_SHARES = (0.0, 0.001, 0.01, 0.05, 0.1, 0.2)
LATENESS_STEPS_S = (0.15, 0.5, 2.0, 5.0, 5.0, 5.0)
TRANSACTIONS_PER_CHUNK = 2000
"""Transactions of one line; then comes another share and lateness."""
BASELINE_SHARE = 0.05
"""The naive host does so many of the bus's transactions."""
STEP_S = 2.0
CHUNK_MAX_S = 3600.0
"""Of virtual time for a chunk: a line on which nobody is asked any more must not hang the campaign."""
READ_PAUSE_S = 0.4
WITHOUT_CHECKSUM = frozenset({"dzb100"})
"""Frames without a check value: a character that two stations made together is any digit, and only the second reading
tells. That is damage, no misattribution; it is counted apart."""
LATE_PARAMETERS = {
    "c320": ("F0.1", "F0.2", "F1.10", "F4.0", "F9.4"),
    "dzb100": ("00", "01", "10", "23", "77"),
    "vc660": ("F00.00", "F00.01", "F00.02", "F00.03"),
    "df800": ("F1.00", "F1.01", "F1.02", "F1.07", "F1.08"),
}


def similar_reads(kind: DriveVariant, address: int) -> tuple[Any, ...]:
    """Reads of one value each, whose answers look alike; all values change."""
    if kind.model == "c320":
        return tuple(sunfar.ReadMonitor(address, item) for item in (0, 2, 3, 5))
    if kind.model == "dzb100":
        return tuple(dzb100.Dzb100Query(address, item) for item in (0, 1, 2))
    registers = (0x3002, 0x3003, 0x300B) if kind.model == "vc660" else (0, 3, 5, 6)
    return tuple(modbus.ReadRegisters(address, register, 1) for register in registers)


class LateReplyBus:
    """One stand under one weather, with as many same-shaped questions as it bears."""

    def __init__(self, session: CampaignRun, kind: DriveVariant, name: str, chance: Random) -> None:
        self.kind, self.rng, self.session = kind, chance, session
        self.share, self.late_s = chance.choice(LATE_SHARES), chance.choice(LATENESS_STEPS_S)
        self.seed, self.bytes = chance.randrange(2**31), chance.random() < 0.1
        self.counts: Counter[str] = Counter()
        self.scenario = stand = Scenario(session, kind, LATE_ADDRESSES, name=name, seed=self.seed)
        stand.bench.line_quality = self.line_quality
        self.reply_log, self.late_replies = ReplyLog(stand.bench), LateReplyCounter(stand, self.counts)
        self._product_accept, self.accepted = stand.bus.core._accept_reply, 0
        stand.bus.core._accept_reply = self._on_accept  # type: ignore[method-assign]
        stand.monitor(chance.choice(LATE_ADDRESSES))
        with running(stand.loop):
            for address in LATE_ADDRESSES:
                polls = [Poll(question, 0.0) for question in similar_reads(kind, address)]
                stand.bus.start_polling(address, polls, lambda answer: None)
            stand.loop.create_task(self._read_parameters())

    @property
    def line_quality(self) -> str:
        return f"late={self.share}:{self.late_s}" + (",bytes" if self.bytes else "")

    async def _read_parameters(self) -> None:
        """A user who reads parameters now and then."""
        while True:
            await asyncio.sleep(self.rng.expovariate(1 / READ_PAUSE_S))
            names = self.rng.sample(LATE_PARAMETERS[self.kind.model], 2)
            await self.scenario.drives[self.rng.choice(LATE_ADDRESSES)].read(names)

    def _on_accept(self, transaction: Any, now: float) -> None:
        """Whatever the bus believes, the answers of its own fences too."""
        self.accepted += 1
        self.late_replies.on_accepted(transaction.last_byte_at)
        times = transaction.prepared.station.address, transaction.sent_at, transaction.last_byte_at
        if self.reply_log.matches(*times, bytes(transaction.buffer)):
            pass
        elif self.kind.model in WITHOUT_CHECKSUM and self._collided(transaction, *times):
            self.counts["the right answer, spoilt by another station's late one, believed"] += 1
        else:
            self.scenario.oracle.violation(
                f"G04 {transaction.buffer.hex()} is no answer to {transaction.prepared.data.hex()}"
            )
        self._product_accept(transaction, now)

    def _collided(self, transaction: Any, address: int, sent_at: float, heard_at: float) -> bool:
        """The one answer to this question, but another station's late reply fell into it."""
        made = self.reply_log.replies_between(address, sent_at, heard_at)
        return [len(text) for text in made] == [len(transaction.buffer)] and self.late_replies.collided(heard_at)

    def run_transactions(self, frames: int) -> None:
        """So many transactions at least."""
        end = self.scenario.loop.time() + CHUNK_MAX_S
        while self.scenario.oracle.request_count < frames and self.scenario.loop.time() < end:
            self.scenario.run(STEP_S)
        witness = self.scenario.oracle
        if witness.request_count < frames or not 0 < witness.accepted_count <= self.accepted:
            answers = f"{witness.accepted_count} or {self.accepted} answers"
            witness.violation(
                f"{witness.request_count} requests and {answers} in {CHUNK_MAX_S} s: nobody asks, or nobody judges"
            )
        self.scenario.close()

    def run_baseline(self, frames: int) -> Counter[str]:
        """The control, under the same weather and seed."""
        loop, counts = VirtualLoop(), Counter[str]()
        asked = [
            (address, self.scenario.drives[address].dialect.codec.encode_request(question))
            for address in LATE_ADDRESSES
            for question in similar_reads(self.kind, address)
        ]
        with running(loop):
            options = {"baud": self.kind.baud, "seed": self.seed, **self.kind.options}
            query = "&".join(f"{name}={value}" for name, value in options.items())
            port: Any = open_port(f"sim://{self.kind.model}@{','.join(map(str, LATE_ADDRESSES))}?{query}")
            port.simulated_bus.line_quality = self.line_quality
            port.simulated_bus.now()
            maker = ReplyLog(port.simulated_bus)

            def believed(address: int, sent_at: float, now: float, data: bytes) -> None:
                counts["believed"] += 1
                counts["misattributed"] += not maker.matches(address, sent_at, now, data)

            host = BaselineHost(self.kind, port, loop, asked, believed)
        loop.run_until_complete(host.open())
        while host.frames < frames:
            loop.run_until(loop.time() + STEP_S)
        counts["transactions"] += host.frames
        return counts


def run(session: CampaignRun) -> None:
    """All kinds in turn, a chunk each, until each has done the budget."""
    found: dict[str, Counter[str]] = {kind.name: Counter() for kind in DRIVE_VARIANTS}
    naive: dict[str, Counter[str]] = {kind.name: Counter() for kind in DRIVE_VARIANTS}
    number = 0
    while session.remaining:
        frames = min(TRANSACTIONS_PER_CHUNK, session.remaining)
        for kind in DRIVE_VARIANTS:
            line = LateReplyBus(session, kind, f"{kind.name}/{number}", session.rng(kind.name, number))
            line.run_transactions(frames)
            found[kind.name].update(line.counts, transactions=line.scenario.oracle.request_count)
            naive[kind.name].update(line.run_baseline(max(1, int(frames * BASELINE_SHARE))))
        number += 1
        session.add_trials(frames)
    _report_results(session, found, naive)


def _report_results(session: CampaignRun, found: dict[str, Counter[str]], naive: dict[str, Counter[str]]) -> None:
    session.figures["order"] = "stations answer in the order in which they were asked, however late"
    for kind in DRIVE_VARIANTS:
        shown: dict[str, object] = {
            "longest_lateness_s": kind.max_reply_lateness_s,
            **dict(sorted(found[kind.name].items())),
        }
        session.figures[kind.name] = shown | {"naive_host": dict(sorted(naive[kind.name].items()))}
        session.trace(f"{kind.name}: {session.figures[kind.name]}")


CAMPAIGN = Campaign(
    name="late",
    summary={"en": "Late replies are never accepted.", "zh": "迟到的应答绝不采信。"},
    unit="transactions of each kind",
    evidence_for=(
        "I5",
        "I4",
        "T04",
    ),
    full_budget=10**6,
    ci_budget=4000,
    run=run,
)
