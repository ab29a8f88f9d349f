"""Requests to a bus and their results, permits, and the configuration of a station."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Any

from drivebus.protocols.codec import Codec, Effect
from drivebus.serial_settings import StationTiming


class RetryPolicy(Enum):
    """Policy for sending a frame again that needs a permit; for reads and stops their effect decides."""

    IDEMPOTENT = "idempotent"
    """Absolute value, such as a setpoint: resent at most twice while not expired."""
    EDGE_TRIGGERED = "edge_triggered"
    """Start, fault reset, jog: never resent by the bus; the operation decides after two verified reads."""
    EEPROM = "eeprom"
    """Compared before it is written, never resent."""


class RequestPriority(IntEnum):
    """Priority class of a request; a lower number goes first."""

    STOP = 0
    COMMAND = 1
    STOP_READ = 2
    """A read that is part of a stop: of the model before its first frame, of the standstill after it."""
    PARAMETER = 3
    POLL = 4
    PROBE = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Permit:
    """Permission for one frame that is neither a read nor a stop. Only ``drives.permissives`` grants it."""

    station: int
    effect: Effect
    retry_policy: RetryPolicy
    expires_at: float
    """Monotonic second after which it is void."""
    stop_epoch: int
    """Stop epoch of the station when granted: a newer stop voids the permit."""
    command_id: str = ""
    """Id of the command that the frame belongs to."""

    def __post_init__(self) -> None:
        """Raises ValueError for an expiry that is NaN: no comparison would ever end it."""
        if self.expires_at != self.expires_at:
            raise ValueError(f"permit for station {self.station}: expires_at is NaN, expected monotonic seconds")


@dataclass(slots=True, kw_only=True)
class BusRequest:
    """Transaction to perform. The bus reads it once, at ``submit``; later changes have no effect.

    Neither this nor ``BusResult`` is frozen: a frozen one takes four times as long to make, and each transaction makes
    both.
    """

    station: int
    request: Any
    priority: RequestPriority = RequestPriority.PARAMETER
    permit: Permit | None = None
    expires_at: float | None = None
    """Not sent after this monotonic second."""
    waits_in_quarantine: bool = True
    """False: fails at once where a sync probe proves nothing and the next one follows after 5 s."""
    tag: Any = None
    """Value of the caller, returned unchanged."""


@dataclass(slots=True, kw_only=True)
class BusResult:
    """Result of a BusRequest. Exactly one of ``reply`` and ``error`` is set, except for broadcasts (neither)."""

    bus_request: BusRequest
    reply: Any = None
    error: Exception | None = None
    sent: bytes = b""
    """The bytes on the wire, empty where nothing was sent."""
    received: bytes = b""
    sent_at: float | None = None
    """First bit on the wire, monotonic seconds."""
    received_at: float | None = None
    """Last byte of the reply, monotonic seconds."""
    gap_s: float = 0.0
    """Silence that the bus keeps before each frame to this station."""
    attempts: int = 0
    """Number of times that the frame was sent."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StationConfig:
    """Configuration of one station for the bus; created by a dialect."""

    address: int
    codec: Codec
    timing: StationTiming
    effect_of: Callable[[bytes], Effect]
    """Effect of an encoded request, from its bytes and the drive's profile."""
    sync_request: Callable[[int], Any]
    """n → a harmless request whose reply differs from every other recent one; n counts up."""
    label: str = ""
    stop_request: Any = None
    """Stop frame of this drive; None: about as long as a sync request."""
    longest_requests: Sequence[Any] = ()
    """Requests outside the polls for which a stop may have to wait."""
    sample_requests: Sequence[Any] = ()
    """Further requests that stand for all frames to this station where protocols share a bus."""
