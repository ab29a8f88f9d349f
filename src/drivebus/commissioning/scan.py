"""Find drives on a line: family, address, line settings. Reads only; listens before it speaks.

What is asked is planned in ``scan_plan``; ``scan`` walks the plan over real buses, one opening of the port a pass.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from drivebus.bus import Bus
from drivebus.commissioning.scan_plan import Candidate, Pass, probe
from drivebus.drives.make import make_dialect
from drivebus.errors import PortError, PortLost
from drivebus.line import LineSettings
from drivebus.message import Answer, Ask, Lane
from drivebus.ports import Port


@dataclass(frozen=True, slots=True)
class Found:
    """Somebody answered."""

    models: tuple[str, ...]
    """Those that fit, the likeliest first: sisters that speak alike can't be told apart by asking."""
    family: str
    encoding: str
    address: int
    settings: LineSettings
    exchange: tuple[bytes, bytes]
    """The question and the answer that prove it."""
    doubtful: bool = False
    """Bytes came, but no whole valid reply: wrong parity, two drives at one address, or noise."""


@dataclass(slots=True)
class Progress:
    """Where a scan is."""

    total_s: float
    done_s: float = 0.0
    settings: LineSettings | None = None
    address: int | None = None
    kind: tuple[str, str] = ("", "")
    found: list[Found] = field(default_factory=list)

    @property
    def left_s(self) -> float:
        return max(0.0, self.total_s - self.done_s)


@dataclass(frozen=True, slots=True)
class Overheard:
    """What was on the line while we said nothing."""

    count: int
    marks: int
    first: bytes
    seconds: float


class _Ear:
    """A receiver that only counts."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.count = 0
        self.marks = 0

    def data_received(self, data: bytes, marks: int = 0) -> None:
        self.count += len(data)
        self.marks += marks
        if len(self.data) < 64:
            self.data += data

    def port_lost(self, error: PortLost) -> None:
        pass


async def listen(port: Port, seconds: float) -> Overheard:
    """Say nothing for so long and tell what was heard: any byte means that somebody else is master here.

    Raises PortUnavailable.
    """
    ear = _Ear()
    await port.open(ear)
    try:
        await asyncio.sleep(seconds)
    finally:
        await port.close()
    return Overheard(ear.count, ear.marks, bytes(ear.data[:64]), seconds)


async def scan(
    passes: Iterable[Pass],
    open_port: Callable[[LineSettings], Port],
    progress: Progress,
    tell: Callable[[Progress], None] = lambda progress: None,
    *,
    keep_going: bool = False,
) -> list[Found]:
    """Walk the plan. What is found stands in ``progress.found`` at every moment, so an abort loses nothing.

    A line has one setting: where somebody answered, only passes of the same setting follow, unless ``keep_going``.
    Raises PortUnavailable, PortLost.
    """
    queue = list(passes)
    while queue:
        one = queue.pop(0)
        await _walk(one, open_port(one.settings), progress, tell)
        queue = queue if keep_going else _still_possible(queue, progress.found)
        progress.total_s = progress.done_s + sum(later.seconds for later in queue)
    return progress.found


def _still_possible(queue: Sequence[Pass], found: Sequence[Found]) -> list[Pass]:
    """Passes of the line setting that somebody answered under; all while nobody has."""
    settled = {one.settings for one in found if not one.doubtful}
    return [one for one in queue if not settled or one.settings in settled]


async def _walk(one: Pass, port: Port, progress: Progress, tell: Callable[[Progress], None]) -> None:
    async with Bus(port) as bus:
        for address in one.addresses:
            progress.settings, progress.address, progress.kind = one.settings, address, one.candidates[0].kind
            tell(progress)
            found = await _ask_all(bus, one, address)
            if found is not None:
                progress.found.append(found)
            progress.done_s += one.seconds / max(1, one.questions)
    tell(progress)


async def _ask_all(bus: Bus, one: Pass, address: int) -> Found | None:
    """Ask the first candidate; only where something answers are its sisters asked in their own words."""
    fits: list[Candidate] = []
    heard: Answer | None = None
    good: Answer | None = None
    for candidate in one.candidates:
        if not candidate.profile.addresses[0] <= address <= candidate.profile.addresses[1]:
            continue
        answer, refused = await _ask(bus, candidate, address)
        if answer.received:
            heard = heard or answer
        if answer.reply is not None and not refused:
            fits.append(candidate)
            good = good or answer
        if heard is None:
            return None
    if heard is None:
        return None
    proof = good or heard
    candidates = _likeliest(fits) if fits else list(one.candidates)
    return Found(
        tuple(candidate.profile.model for candidate in candidates),
        *one.candidates[0].kind,
        address,
        one.settings,
        (proof.sent, proof.received),
        doubtful=not fits,
    )


def _likeliest(fits: Sequence[Candidate]) -> list[Candidate]:
    """A status register that answered is a better witness than a parameter that many drives have."""
    sure = [candidate for candidate in fits if candidate.profile.status is not None]
    return sure or list(fits)


async def _ask(bus: Bus, candidate: Candidate, address: int) -> tuple[Answer, bool]:
    """One question. The second value: the drive is there but said no."""
    dialect = make_dialect(candidate.profile, address, encoding=candidate.encoding)
    bus.add(dialect.link)
    try:
        answer = await bus.transact(Ask(address, probe(dialect), Lane.PROBE))
    finally:
        bus.remove(address)
    if isinstance(answer.error, PortError):
        raise answer.error
    refused = answer.reply is not None and dialect.refusal(answer.reply) is not None
    return answer, refused
