"""Find drives on a line: family, address, line settings. Reads only; listens before it speaks.

What is asked is planned in ``scan_plan``; ``scan`` walks the plan over real buses, one opening of the port a pass.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from drivebus.bus import Bus
from drivebus.bus.messages import BusRequest, BusResult, RequestPriority
from drivebus.commissioning.scan_plan import ScanCandidate, ScanPass, probe_request
from drivebus.drives.dialects.create import create_dialect
from drivebus.errors import PortError, PortLost
from drivebus.ports import Port
from drivebus.serial_settings import SerialSettings


@dataclass(frozen=True, slots=True)
class DetectedDrive:
    """Somebody answered."""

    models: tuple[str, ...]
    """Those that fit, the likeliest first: sisters that speak alike can't be told apart by asking."""
    family: str
    encoding: str
    address: int
    settings: SerialSettings
    exchange: tuple[bytes, bytes]
    """The question and the answer that prove it."""
    doubtful: bool = False
    """Bytes came, but no whole valid reply: wrong parity, two drives at one address, or noise."""


@dataclass(slots=True)
class ScanProgress:
    """Where a scan is."""

    total_s: float
    done_s: float = 0.0
    settings: SerialSettings | None = None
    address: int | None = None
    kind: tuple[str, str] = ("", "")
    found: list[DetectedDrive] = field(default_factory=list)

    @property
    def left_s(self) -> float:
        return max(0.0, self.total_s - self.done_s)


@dataclass(frozen=True, slots=True)
class SniffResult:
    """What was on the line while we said nothing."""

    count: int
    line_errors: int
    first: bytes
    seconds: float


class _Sniffer:
    """A receiver that only counts."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.count = 0
        self.line_errors = 0

    def data_received(self, data: bytes, marks: int = 0) -> None:
        self.count += len(data)
        self.line_errors += marks
        if len(self.data) < 64:
            self.data += data

    def port_lost(self, error: PortLost) -> None:
        pass


async def sniff(port: Port, seconds: float) -> SniffResult:
    """Say nothing for so long and tell what was heard: any byte means that somebody else is master here.

    Raises PortUnavailable.
    """
    ear = _Sniffer()
    await port.open(ear)
    try:
        await asyncio.sleep(seconds)
    finally:
        await port.close()
    return SniffResult(ear.count, ear.line_errors, bytes(ear.data[:64]), seconds)


async def scan(
    passes: Iterable[ScanPass],
    open_port: Callable[[SerialSettings], Port],
    progress: ScanProgress,
    on_progress: Callable[[ScanProgress], None] = lambda progress: None,
    *,
    keep_going: bool = False,
) -> list[DetectedDrive]:
    """Walk the plan. What is found stands in ``progress.found`` at every moment, so an abort loses nothing.

    A line has one setting: where somebody answered, only passes of the same setting follow, unless ``keep_going``.
    Raises PortUnavailable, PortLost.
    """
    queue = list(passes)
    while queue:
        one = queue.pop(0)
        await _run_pass(one, open_port(one.settings), progress, on_progress)
        queue = queue if keep_going else _remaining_passes(queue, progress.found)
        progress.total_s = progress.done_s + sum(later.duration_s for later in queue)
    return progress.found


def _remaining_passes(queue: Sequence[ScanPass], found: Sequence[DetectedDrive]) -> list[ScanPass]:
    """Passes of the line setting that somebody answered under; all while nobody has."""
    settled = {one.settings for one in found if not one.doubtful}
    return [one for one in queue if not settled or one.settings in settled]


async def _run_pass(one: ScanPass, port: Port, progress: ScanProgress, tell: Callable[[ScanProgress], None]) -> None:
    async with Bus(port) as bus:
        for address in one.addresses:
            progress.settings, progress.address, progress.kind = one.settings, address, one.candidates[0].kind
            tell(progress)
            found = await _probe_address(bus, one, address)
            if found is not None:
                progress.found.append(found)
            progress.done_s += one.duration_s / max(1, one.probe_count)
    tell(progress)


async def _probe_address(bus: Bus, one: ScanPass, address: int) -> DetectedDrive | None:
    """Ask the first candidate; only where something answers are its sisters asked in their own words."""
    fits: list[ScanCandidate] = []
    heard: BusResult | None = None
    good: BusResult | None = None
    for candidate in one.candidates:
        if not candidate.profile.addresses[0] <= address <= candidate.profile.addresses[1]:
            continue
        answer, refused = await _probe(bus, candidate, address)
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
    candidates = _prefer_status_register(fits) if fits else list(one.candidates)
    return DetectedDrive(
        tuple(candidate.profile.model for candidate in candidates),
        *one.candidates[0].kind,
        address,
        one.settings,
        (proof.sent, proof.received),
        doubtful=not fits,
    )


def _prefer_status_register(fits: Sequence[ScanCandidate]) -> list[ScanCandidate]:
    """A status register that answered is a better witness than a parameter that many drives have."""
    sure = [candidate for candidate in fits if candidate.profile.status is not None]
    return sure or list(fits)


async def _probe(bus: Bus, candidate: ScanCandidate, address: int) -> tuple[BusResult, bool]:
    """One question. The second value: the drive is there but said no."""
    dialect = create_dialect(candidate.profile, address, encoding=candidate.encoding)
    bus.add_station(dialect.station_config)
    try:
        answer = await bus.transact(BusRequest(address, probe_request(dialect), RequestPriority.PROBE))
    finally:
        bus.remove_station(address)
    if isinstance(answer.error, PortError):
        raise answer.error
    refused = answer.reply is not None and dialect.rejection(answer.reply) is not None
    return answer, refused
