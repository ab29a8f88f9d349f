"""Search for drives on a bus: protocol family, address and serial settings, by reads only.

``scan`` runs a plan (``scan_plan``) on real buses, with one opening of the port per pass; ``sniff`` listens before
anything is sent.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from drivebus.bus import Bus
from drivebus.bus.messages import BusRequest, BusResult, RequestPriority, StationConfig
from drivebus.commissioning.scan_plan import ScanCandidate, ScanPass, further_reads, probe_frame, probe_request
from drivebus.drives.dialects.base import Dialect
from drivebus.drives.dialects.create import create_dialect
from drivebus.errors import AddressError, DrivebusError, PortError, PortLost
from drivebus.ports import Port
from drivebus.serial_settings import SerialSettings

SNIFF_SAMPLE_BYTES = 64
"""Bytes of foreign traffic that are shown."""
ERRORS_OF_WHOLE_REPLIES = {"bus.stray_before", "bus.trailing", "bus.second_reply", "protocols.sunfar.state"}
"""Errors of a complete reply of the requested station that is not accepted."""
MAX_UNREADABLE_REPLIES = 4
"""After as many damaged replies of an address, and no valid frame, no further probe is sent to it."""
NOISE_ALLOWANCE_S = 5.0
"""Noise adds at most the planned time of the probes and these seconds; from then on each address gets one probe."""
MAX_REPEATED_READS = 20
"""Reads of an address that are repeated because their replies were damaged: stray bytes must not exclude a model."""
PARAMETER_REGISTERS_END = 1000
"""Registers below it are parameters in many drives, so that a status register there proves little."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectedDrive:
    """Station that answered a probe."""

    models: tuple[str, ...]
    """Models that fit, the most likely first; related models with the same frames can't be distinguished.

    Empty without a valid reply, and for a device that rejects the reads of every model.
    """
    setpoint_steps_hz: Mapping[str, float | None]
    """Model to the step in Hz in which it counts its frequency; None for a share of its maximum frequency.

    Without a model whose step is only assumed.
    """
    family: str
    encoding: str
    address: int
    settings: SerialSettings
    exchange: tuple[bytes, bytes]
    """Request and reply."""
    valid_reply: bool = True
    """False: bytes were received, but no valid reply: wrong parity, two drives at one address, or noise."""
    replied_address: int | None = None
    """Address of a valid frame that was received in place of a reply from ``address``; None where there was none."""
    replied_late: bool = False
    """``replied_address`` was asked before in the same pass, so that the frame may be its late reply."""
    fits_partly: bool = False
    """The status register answers, but not with a state of these models, or not their other registers."""
    unusable_reply: DrivebusError | None = None
    """Error that names a whole reply which is not accepted, as one with stray bytes; None for other bytes."""

    @property
    def unreadable(self) -> bool:
        """Whether bytes were received, and no valid frame."""
        return not self.valid_reply and self.replied_address is None

    @property
    def doubtful(self) -> bool:
        """Whether the bus can't tell which model it is."""
        return not self.valid_reply or len(self.models) != 1 or self.fits_partly


@dataclass(slots=True, kw_only=True)
class ScanProgress:
    """Progress of a scan, with the drives found so far."""

    total_s: float
    done_s: float = 0.0
    settings: SerialSettings | None = None
    address: int | None = None
    kind: tuple[str, str] = ("", "")
    found: list[DetectedDrive] = field(default_factory=list)
    noise_s: float = 0.0
    """Time that addresses without a valid frame took beyond their planned time."""
    unsent: int = 0
    """Requests that were not sent because the bus was never silent."""

    @property
    def left_s(self) -> float:
        return max(0.0, self.total_s - self.done_s)

    @property
    def noise_allowance_s(self) -> float:
        """Time that noise may still add to the planned time."""
        return NOISE_ALLOWANCE_S + self.done_s - self.noise_s


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

    def data_received(self, data: bytes, line_errors: int = 0) -> None:
        self.count += len(data)
        self.line_errors += line_errors
        if len(self.data) < SNIFF_SAMPLE_BYTES:
            self.data += data

    def port_lost(self, error: PortLost) -> None:
        pass


async def sniff(port: Port, seconds: float, on_open: Callable[[], None] = lambda: None) -> SniffResult:
    """Listen for this long without sending; any byte means that another master is on the bus.

    ``on_open`` is called once the port is open. Raises PortUnavailable.
    """
    sniffer = _Sniffer()
    await port.open(sniffer)
    try:
        on_open()
        await asyncio.sleep(seconds)
    finally:
        await port.close()
    return SniffResult(sniffer.count, sniffer.line_errors, bytes(sniffer.data[:SNIFF_SAMPLE_BYTES]), seconds)


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


def _remaining_passes(queue: Sequence[ScanPass], detected: Sequence[DetectedDrive]) -> list[ScanPass]:
    """Return the passes of the serial setting that was answered; all of them as long as none was."""
    answered = {drive.settings for drive in detected if drive.valid_reply}
    return [each for each in queue if not answered or each.settings in answered]


async def _run_pass(
    scan_pass: ScanPass, port: Port, progress: ScanProgress, on_progress: Callable[[ScanProgress], None]
) -> None:
    async with Bus(port) as bus:
        for address in scan_pass.addresses:
            if _is_known(progress.found, scan_pass, address):
                progress.done_s += scan_pass.probe_s
                continue
            progress.settings, progress.address, progress.kind = (
                scan_pass.settings,
                address,
                scan_pass.candidates[0].kind,
            )
            on_progress(progress)
            planned_end = bus.now() + scan_pass.probe_s
            probed = _ProbedAddress(
                bus=bus, scan_pass=scan_pass, noise_ends_at=planned_end + progress.noise_allowance_s
            )
            detected = await _probe_address(probed, address)
            if detected is not None:
                progress.found.append(detected)
            if detected is None or not detected.valid_reply:
                progress.noise_s += max(0.0, bus.now() - planned_end)
            progress.unsent += probed.unsent
            progress.done_s += scan_pass.probe_s
    on_progress(progress)


def _is_known(detected: Sequence[DetectedDrive], scan_pass: ScanPass, address: int) -> bool:
    """Return whether a drive of this family has answered at this address in another encoding: it is listed once."""
    family = scan_pass.candidates[0].profile.family
    return any(
        drive.valid_reply and (drive.family, drive.address, drive.settings) == (family, address, scan_pass.settings)
        for drive in detected
    )


@dataclass(slots=True, kw_only=True)
class _ProbedAddress:
    """Replies of one address to the probes of a pass; each request is sent once, apart from repetitions."""

    bus: Bus
    scan_pass: ScanPass
    noise_ends_at: float
    """Time after which noise no longer delays a request, nor lets another one follow."""
    replies: dict[tuple[bytes, int], Any] = field(default_factory=dict)
    """Probe and size of its reply to the reply, None where it was rejected or missing."""
    received: BusResult | None = None
    """First exchange with bytes of the station."""
    rejected: BusResult | None = None
    """First valid frame that rejects a probe."""
    answered: BusResult | None = None
    """First reply with what was asked for."""
    foreign: BusResult | None = None
    """First exchange that was answered from another address."""
    unusable_reply: DrivebusError | None = None
    """First error that names a whole reply."""
    damaged: set[tuple[bytes, int]] = field(default_factory=set)
    """Probes whose last reply is no valid frame."""
    repetitions_left: int = 0
    """Number of requests that may be sent again."""
    unsent: int = 0
    """Number of requests that were not sent because the bus was never silent."""

    @property
    def is_noise(self) -> bool:
        """Whether no further request is sent: no valid frame came, and damaged replies reached their limit or time."""
        if self.rejected or self.answered:
            return False
        return len(self.damaged) >= MAX_UNREADABLE_REPLIES or self.bus.now() >= self.noise_ends_at

    async def reply_to(self, dialect: Dialect, request: Any) -> Any | None:
        """Return the reply to a request; None where it was rejected or missing."""
        probe = probe_frame(dialect, request)
        while probe not in self.replies or self._take_repetition(probe):
            result = await _probe(self.bus, self.scan_pass.station_config(dialect), request, self._expiry())
            self.unsent += not result.sent
            self.damaged.discard(probe)
            is_rejected = result.reply is not None and dialect.rejection(result.reply) is not None
            self.replies[probe] = None if is_rejected else result.reply
            if result.received:
                self.received = self.received or result
                if isinstance(result.error, DrivebusError) and result.error.key in ERRORS_OF_WHOLE_REPLIES:
                    self.unusable_reply = self.unusable_reply or result.error
                if result.reply is None:
                    self.damaged.add(probe)
            elif getattr(result.error, "key", None) == "bus.other_station_replied":
                self.foreign = self.foreign or result
            if is_rejected:
                self.rejected = self.rejected or result
            elif result.reply is not None:
                self.answered = self.answered or result
        return self.replies[probe]

    def _expiry(self) -> float | None:
        """Return the time until which a request waits for silence; None, as long as any, after a valid frame."""
        if self.rejected or self.answered:
            return None
        return max(self.bus.now() + self.scan_pass.probe_s, self.noise_ends_at)

    def _take_repetition(self, probe: tuple[bytes, int]) -> bool:
        """Return whether a request whose reply was damaged is to be sent again, and count it.

        Not where the same bytes were answered as the request of another model, with a byte count of another size.
        """
        is_answered = any(other[0] == probe[0] and reply is not None for other, reply in self.replies.items())
        is_due = probe in self.damaged and not is_answered and self.repetitions_left > 0
        self.repetitions_left -= is_due
        return is_due

    async def answers_all(self, dialect: Dialect) -> bool:
        """Return whether the registers of state and identity of a model are answered."""
        return all([await self.reply_to(dialect, read) is not None for read in further_reads(dialect)])


async def _probe_address(probed: _ProbedAddress, address: int) -> DetectedDrive | None:
    """Probe an address with the first candidate, and with the others only if bytes are received.

    Models with the same request and the same size of its reply are probed once. Of the models that were answered, those
    are preferred whose status can have the value that was read, and whose other registers of state and identity answer.
    """
    scan_pass = probed.scan_pass
    probes: list[tuple[ScanCandidate, Dialect, Any]] = []
    for candidate in scan_pass.candidates:
        if not candidate.profile.addresses[0] <= address <= candidate.profile.addresses[1]:
            continue
        dialect = create_dialect(candidate.profile, address, encoding=candidate.encoding)
        probes.append((candidate, dialect, probe_request(dialect)))
        await probed.reply_to(*probes[-1][1:])
        if probed.received is None:
            return None if probed.foreign is None else _foreign_reply(scan_pass, address, probed.foreign)
        if probed.is_noise:
            break
    probed.repetitions_left = MAX_REPEATED_READS if probed.rejected or probed.answered else 0
    fits: list[ScanCandidate] = []
    partly: list[ScanCandidate] = []
    for candidate, dialect, request in probes:
        reply = await probed.reply_to(dialect, request)
        if reply is not None:
            is_foreign = _is_foreign_status(dialect, request, reply) or not await probed.answers_all(dialect)
            (partly if is_foreign else fits).append(candidate)
    answer = probed.answered or probed.rejected or probed.received
    if answer is None:
        return None
    candidates = _prefer_status_register(fits or partly)
    if candidates:
        candidates = await _find_named_by_code(candidates, address, probed.reply_to) or candidates
    return DetectedDrive(
        models=tuple(candidate.profile.model for candidate in candidates),
        setpoint_steps_hz={
            c.profile.model: None
            if c.profile.setpoint_share or c.profile.setpoint_rpm
            else c.profile.setpoint_scale.factor
            for c in candidates
            if c.profile.evidence["setpoint"].kind != "assumed"
        },
        family=scan_pass.candidates[0].profile.family,
        encoding=scan_pass.candidates[0].encoding,
        address=address,
        settings=scan_pass.settings,
        exchange=(answer.sent, answer.received),
        valid_reply=answer is not probed.received or answer.reply is not None,
        fits_partly=bool(partly) and not fits,
        unusable_reply=probed.unusable_reply,
    )


def _foreign_reply(scan_pass: ScanPass, address: int, result: BusResult) -> DetectedDrive:
    """Return the row of an address whose probe was answered from another address."""
    assert isinstance(result.error, AddressError)
    replied_address = result.error.params["found"]
    return DetectedDrive(
        models=(),
        setpoint_steps_hz={},
        family=scan_pass.candidates[0].profile.family,
        encoding=scan_pass.candidates[0].encoding,
        address=address,
        settings=scan_pass.settings,
        exchange=(result.sent, result.received),
        valid_reply=False,
        replied_address=replied_address,
        replied_late=replied_address in scan_pass.addresses[: scan_pass.addresses.index(address)],
    )


async def _find_named_by_code(
    fits: Sequence[ScanCandidate], address: int, reply_to: Callable[[Dialect, Any], Awaitable[Any | None]]
) -> list[ScanCandidate]:
    """Return the models that the code of their identity register names; none where no model has such codes."""
    for candidate in fits:
        dialect = create_dialect(candidate.profile, address, encoding=candidate.encoding)
        for request in dialect.identity_reads() if candidate.profile.identity_codes is not None else ():
            reply = await reply_to(dialect, request)
            models = dialect.decode_identity((reply,)).models if reply is not None else ()
            if models:
                return [fit for fit in fits if fit.profile.model in models]
    return []


def _is_foreign_status(dialect: Dialect, request: Any, reply: Any) -> bool:
    """Return whether the status in a reply has a value, or a reserved bit, that the model does not have."""
    state = dialect.decode_readings(request, reply, None).get("state")
    return state is not None and state.reason in ("drives.reserved_bits", "drives.unlisted_state")


def _prefer_status_register(fits: Sequence[ScanCandidate]) -> list[ScanCandidate]:
    """Prefer models whose status register answered to those of a parameter that many drives have.

    A model without status register stays beside them where its own register is none of these parameters, or where all
    of their registers may be parameters of its own; models whose status register may be a parameter come last.
    """
    registers = [status.register for candidate in fits if (status := candidate.profile.status) is not None]

    def stays(candidate: ScanCandidate) -> bool:
        profile = candidate.profile
        if profile.status is not None or _probe_register(candidate) >= PARAMETER_REGISTERS_END:
            return True
        highest = PARAMETER_REGISTERS_END - 1 if profile.notation.style == "register" else profile.notation.highest
        return max(registers, default=-1) <= highest

    def may_be_a_parameter(candidate: ScanCandidate) -> bool:
        status = candidate.profile.status
        return status is not None and status.register < PARAMETER_REGISTERS_END

    return sorted(filter(stays, fits), key=may_be_a_parameter)


def _probe_register(candidate: ScanCandidate) -> int:
    """Return the register that a probe reads; 0 in a protocol without registers."""
    address = max(1, candidate.profile.addresses[0])
    request = probe_request(create_dialect(candidate.profile, address, encoding=candidate.encoding))
    return getattr(request, "register", 0)


async def _probe(bus: Bus, station: StationConfig, request: Any, expires_at: float | None = None) -> BusResult:
    """Send one probe, not after ``expires_at``. Raises PortUnavailable, PortLost."""
    bus.add_station(station)
    try:
        result = await bus.transact(
            BusRequest(station=station.address, request=request, priority=RequestPriority.PROBE, expires_at=expires_at)
        )
    finally:
        bus.remove_station(station.address)
    if isinstance(result.error, PortError):
        raise result.error
    return result
