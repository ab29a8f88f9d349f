"""Search for drives on a bus: protocol family, address and serial settings, by reads only.

``plan_scan`` decides without a port what to probe, in which order, and how long it takes if no drive answers. ``scan``
runs the plan on real buses, with one opening of the port per pass; ``sniff`` listens before anything is sent.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.bus.messages import BusRequest, BusResult, RequestPriority
from drivebus.drives.dialects.base import Dialect
from drivebus.drives.dialects.create import create_dialect
from drivebus.drives.dialects.setpoint_step import SETPOINT_STEP
from drivebus.errors import PortError, PortLost
from drivebus.ports import Port
from drivebus.profiles.model import DriveProfile
from drivebus.protocols.codec import Effect
from drivebus.protocols.family import protocol_family
from drivebus.serial_settings import SerialSettings

FIXED_SETTINGS_SCHEMES = frozenset({"tcp", "memory", "replay"})
"""Port schemes whose serial settings can't be changed: they get one pass."""
LIKELY_BAUDS = (9600, 19200, 4800, 38400)
LIKELY_ADDRESSES = range(9)
"""Searched first: nearly every drive is found there, long before the rest."""
PARAMETER_NUMBERS = 1000
"""Registers below it are parameters in many drives, so that a status register there proves little."""


@dataclass(frozen=True, slots=True)
class ScanCandidate:
    """Model in one encoding that may be on the bus."""

    profile: DriveProfile
    encoding: str

    @property
    def kind(self) -> tuple[str, str]:
        """Family and encoding: candidates with the same frames are probed together."""
        return self.profile.family, self.encoding


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanPass:
    """Scan with a single serial setting: candidates and addresses."""

    settings: SerialSettings
    candidates: tuple[ScanCandidate, ...]
    addresses: tuple[int, ...]
    has_factory_settings: bool
    """The setting is the factory setting of a candidate."""
    is_likely: bool
    """Part of the first search, of ``LIKELY_BAUDS`` and ``LIKELY_ADDRESSES``."""
    duration_s: float
    """Duration in seconds if no drive answers."""

    @property
    def probe_count(self) -> int:
        return len(self.addresses)


def with_look_alikes(wanted: Sequence[DriveProfile]) -> list[DriveProfile]:
    """Add the models of a family that a scan can't tell from a wanted one and that count in another step."""
    families = {profile.family for profile in wanted if SETPOINT_STEP in profile.options}
    known = {profile.model for profile in wanted}
    names = [name for family in sorted(families) for name in protocol_family(family).scan_models if name not in known]
    return [*wanted, *(profile for profile in map(profiles.load, names) if SETPOINT_STEP in profile.options)]


def plan_scan(
    models: Sequence[DriveProfile],
    *,
    addresses: Sequence[int] | None = None,
    bauds: Sequence[int] | None = None,
    formats: Sequence[str] | None = None,
    encodings: Sequence[str] | None = None,
    fixed: SerialSettings | None = None,
) -> list[ScanPass]:
    """Return the passes: likely ones first, factory settings first among them.

    ``fixed`` is the only setting of a port that has no choice.
    """
    kinds: dict[tuple[str, str], list[ScanCandidate]] = {}
    for profile in models:
        for encoding in profile.encodings:
            if encodings is None or encoding in encodings:
                kinds.setdefault((profile.family, encoding), []).append(ScanCandidate(profile, encoding))
    passes: list[ScanPass] = []
    for candidates in kinds.values():
        for settings in _serial_settings(candidates, bauds, formats, fixed):
            passes += _build_passes(candidates, settings, addresses)
    return sorted(passes, key=_search_order)


def _search_order(scan_pass: ScanPass) -> tuple[bool, bool, int, int]:
    baud = scan_pass.settings.baud
    rank = LIKELY_BAUDS.index(baud) if baud in LIKELY_BAUDS else len(LIKELY_BAUDS)
    return not scan_pass.is_likely, not scan_pass.has_factory_settings, rank, -baud


def _serial_settings(
    candidates: Sequence[ScanCandidate],
    bauds: Sequence[int] | None,
    formats: Sequence[str] | None,
    fixed: SerialSettings | None,
) -> list[SerialSettings]:
    """Return the serial settings that a candidate can have, each once."""
    if fixed is not None:
        return [fixed]
    found: dict[SerialSettings, None] = {}
    for candidate in candidates:
        line = candidate.profile.serial
        for baud in bauds or (line.baud, *line.bauds):
            for format in formats or (line.format, *line.formats):
                found[SerialSettings.parse(baud, format)] = None
    return list(found)


def _build_passes(
    candidates: Sequence[ScanCandidate], settings: SerialSettings, addresses: Sequence[int] | None
) -> list[ScanPass]:
    """Return one pass over the likely addresses and one over the others, where there are any."""
    low = min(candidate.profile.addresses[0] for candidate in candidates)
    high = max(candidate.profile.addresses[1] for candidate in candidates)
    broadcasts = {candidate.profile.broadcast for candidate in candidates}
    wanted = [a for a in (addresses or range(low, high + 1)) if low <= a <= high and a not in broadcasts]
    factory = any(str(settings) == f"{c.profile.serial.baud} {c.profile.serial.format}" for c in candidates)
    usual = settings.baud in LIKELY_BAUDS
    likely = tuple(address for address in wanted if usual and address in LIKELY_ADDRESSES)
    others = tuple(address for address in wanted if address not in likely)
    probe_s = probe_duration_s(candidates[0], settings)
    return [
        ScanPass(
            settings=settings,
            candidates=tuple(candidates),
            addresses=part,
            has_factory_settings=factory,
            is_likely=part is likely,
            duration_s=len(part) * probe_s,
        )
        for part in (likely, others)
        if part
    ]


def durations_s(passes: Sequence[ScanPass]) -> tuple[float, float]:
    """Return the seconds of the likely passes and of all passes if no drive answers."""
    return sum(each.duration_s for each in passes if each.is_likely), sum(each.duration_s for each in passes)


def probe_duration_s(candidate: ScanCandidate, settings: SerialSettings) -> float:
    """Return the seconds of a probe without reply: gap, frame, reply timeout."""
    dialect = create_dialect(candidate.profile, max(1, candidate.profile.addresses[0]), encoding=candidate.encoding)
    request = probe_request(dialect)
    codec, timing = dialect.station_config.codec, dialect.station_config.timing
    sent = settings.seconds(len(codec.encode_request(request)))
    return timing.gap_s(settings) + sent + timing.timeout_s(settings, codec.largest_reply(request))


def probe_request(dialect: Dialect) -> Any:
    """Return the probe of an address: the read of the status alone, or of one signal where the drive reports none.

    Raises ValueError if its bytes could do more than read.
    """
    request = dialect.echo_test_read()
    if dialect.station_config.effect_of(dialect.station_config.codec.encode_request(request)) is not Effect.NONE:
        raise ValueError(f"{request} is not a read")
    return request


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectedDrive:
    """Station that answered a probe."""

    models: tuple[str, ...]
    """Models that fit, the most likely first; related models with the same frames can't be distinguished."""
    setpoint_steps_hz: Mapping[str, float | None]
    """Model to the step in Hz in which it counts its frequency; None for a share of its maximum frequency."""
    family: str
    encoding: str
    address: int
    settings: SerialSettings
    exchange: tuple[bytes, bytes]
    """Request and reply."""
    valid_reply: bool = True
    """False: bytes were received, but no valid reply: wrong parity, two drives at one address, or noise."""

    @property
    def doubtful(self) -> bool:
        """Whether the bus can't tell which model it is."""
        return not self.valid_reply or len(self.models) > 1


@dataclass(slots=True, kw_only=True)
class ScanProgress:
    """Progress of a scan, with the drives found so far."""

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
    """Bytes that were received while nothing was sent."""

    count: int
    line_errors: int
    first: bytes
    seconds: float


class _Sniffer:
    """Receiver that counts bytes and line errors."""

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
    """Listen for this long without sending; any byte means that another master is on the bus.

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
    """Run the passes; ``progress.found`` is always current, so that an abort loses nothing.

    A bus has one serial setting: after a valid reply only passes of that setting follow, unless ``keep_going``.
    Raises PortUnavailable, PortLost.
    """
    queue = list(passes)
    while queue:
        scan_pass = queue.pop(0)
        await _run_pass(scan_pass, open_port(scan_pass.settings), progress, on_progress)
        queue = queue if keep_going else _remaining_passes(queue, progress.found)
        progress.total_s = progress.done_s + sum(later.duration_s for later in queue)
    return progress.found


def _remaining_passes(queue: Sequence[ScanPass], found: Sequence[DetectedDrive]) -> list[ScanPass]:
    """Return the passes of the serial setting that was answered; all of them as long as none was."""
    answered = {drive.settings for drive in found if drive.valid_reply}
    return [each for each in queue if not answered or each.settings in answered]


async def _run_pass(
    scan_pass: ScanPass, port: Port, progress: ScanProgress, on_progress: Callable[[ScanProgress], None]
) -> None:
    async with Bus(port) as bus:
        for address in scan_pass.addresses:
            if _is_known(progress.found, scan_pass, address):
                progress.done_s += scan_pass.duration_s / scan_pass.probe_count
                continue
            progress.settings, progress.address, progress.kind = (
                scan_pass.settings,
                address,
                scan_pass.candidates[0].kind,
            )
            on_progress(progress)
            found = await _probe_address(bus, scan_pass, address)
            if found is not None:
                progress.found.append(found)
            progress.done_s += scan_pass.duration_s / scan_pass.probe_count
    on_progress(progress)


def _is_known(found: Sequence[DetectedDrive], scan_pass: ScanPass, address: int) -> bool:
    """Return whether a drive of this family has answered at this address in another encoding: it is listed once."""
    family = scan_pass.candidates[0].profile.family
    return any(
        drive.valid_reply and (drive.family, drive.address, drive.settings) == (family, address, scan_pass.settings)
        for drive in found
    )


async def _probe_address(bus: Bus, scan_pass: ScanPass, address: int) -> DetectedDrive | None:
    """Probe an address with the first candidate, and with the others only if bytes are received.

    Models with the same request, and the same size of its reply, are probed once; of those that were answered, only
    models whose status has the value that was read, and whose other registers of state and identity were answered, are
    named, if there are any.
    """
    fits: list[ScanCandidate] = []
    doubtful: set[str] = set()
    answered: dict[tuple[bytes, int], Any] = {}  # probe, size of its reply: the reply, None if rejected or missing
    first: BusResult | None = None
    good: BusResult | None = None

    async def reply_to(dialect: Dialect, request: Any) -> Any | None:
        nonlocal first, good
        probe = dialect.codec.encode_request(request), dialect.codec.reply_size(request)
        if probe not in answered:
            result, rejected = await _probe(bus, dialect, request)
            answered[probe] = None if rejected else result.reply
            if result.received:
                first = first or result
            if answered[probe] is not None:
                good = good or result
        return answered[probe]

    async def answers_all(dialect: Dialect) -> bool:
        further = [*dialect.state_reads()[:1], dialect.model_check()]
        return all([await reply_to(dialect, read) is not None for read in further if read is not None])

    for candidate in scan_pass.candidates:
        if not candidate.profile.addresses[0] <= address <= candidate.profile.addresses[1]:
            continue
        dialect = create_dialect(candidate.profile, address, encoding=candidate.encoding)
        request = probe_request(dialect)
        reply = await reply_to(dialect, request)
        if first is None:
            return None
        if reply is not None:
            fits.append(candidate)
            if _is_foreign_status(dialect, request, reply) or not await answers_all(dialect):
                doubtful.add(candidate.profile.model)
    if first is None:
        return None
    answer = good or first
    fits = [candidate for candidate in fits if candidate.profile.model not in doubtful] or fits
    candidates = _prefer_status_register(fits) if fits else list(scan_pass.candidates)
    if good is not None and fits:
        candidates = await _named_by_code(candidates, address, reply_to) or candidates
    return DetectedDrive(
        models=tuple(candidate.profile.model for candidate in candidates),
        setpoint_steps_hz={
            c.profile.model: None
            if c.profile.setpoint_share or c.profile.setpoint_rpm
            else c.profile.setpoint_scale.factor
            for c in candidates
        },
        family=scan_pass.candidates[0].profile.family,
        encoding=scan_pass.candidates[0].encoding,
        address=address,
        settings=scan_pass.settings,
        exchange=(answer.sent, answer.received),
        valid_reply=bool(fits),
    )


async def _named_by_code(
    fits: Sequence[ScanCandidate], address: int, reply_to: Callable[[Dialect, Any], Awaitable[Any | None]]
) -> list[ScanCandidate]:
    """Return the models that the code of their identity register names; none where no model has such codes."""
    for candidate in fits:
        dialect = create_dialect(candidate.profile, address, encoding=candidate.encoding)
        for request in dialect.identity_reads() if candidate.profile.identity_codes is not None else ():
            reply = await reply_to(dialect, request)
            models = dialect.decode_identity((reply,)).models if reply is not None else ()
            if models:
                return [one for one in fits if one.profile.model in models]
    return []


def _is_foreign_status(dialect: Dialect, request: Any, reply: Any) -> bool:
    """Return whether the status in a reply has a value, or a reserved bit, that the model does not have."""
    state = dialect.decode_readings(request, reply, None).get("state")
    return state is not None and state.reason == "drives.reserved_bits"


def _prefer_status_register(fits: Sequence[ScanCandidate]) -> list[ScanCandidate]:
    """Prefer models whose status register answered to those of a parameter that many drives have.

    A model without status register stays beside them where all of these registers may be parameters of its own; models
    whose status register has a number that is a parameter in many drives come last.
    """
    registers = [status.register for candidate in fits if (status := candidate.profile.status) is not None]

    def stays(profile: DriveProfile) -> bool:
        highest = -1 if profile.notation.style == "register" else profile.notation.highest
        return profile.status is not None or max(registers, default=-1) <= highest

    def may_be_a_parameter(candidate: ScanCandidate) -> bool:
        status = candidate.profile.status
        return status is not None and status.register < PARAMETER_NUMBERS

    return sorted((one for one in fits if stays(one.profile)), key=may_be_a_parameter)


async def _probe(bus: Bus, dialect: Dialect, request: Any) -> tuple[BusResult, bool]:
    """Send one probe; the second value is True if the drive rejected it."""
    bus.add_station(dialect.station_config)
    try:
        result = await bus.transact(
            BusRequest(station=dialect.address, request=request, priority=RequestPriority.PROBE)
        )
    finally:
        bus.remove_station(dialect.address)
    if isinstance(result.error, PortError):
        raise result.error
    rejected = result.reply is not None and dialect.rejection(result.reply) is not None
    return result, rejected
