"""The shapes that protocols, bus, drives and simulators share. Values only: no clock, no port."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from math import inf
from typing import Any, Protocol

from drivebus.serial_settings import SerialSettings


class Effect(Enum):
    """What a frame does to the drive that obeys it, derived from its bytes."""

    NONE = "none"
    """A pure read."""
    SETTING = "setting"
    """Writes a parameter or a setpoint, resets a fault: no start by itself."""
    MOTION = "motion"
    """May start or jog the motor."""
    STOP = "stop"
    """Can only take motion away. Needs no permit, is dropped by no check (ruling 5)."""


class RetryPolicy(Enum):
    """RELIABILITY 6.5: how a frame may be repeated."""

    READ = "read"
    """Harmless; one retry."""
    IDEMPOTENT = "A"
    """Absolute and idempotent (setpoint, stop): resend at most twice while unexpired."""
    EDGE_TRIGGERED = "B"
    """Start, fault reset, jog: never resent by the bus; the operation decides after two fenced reads."""
    EEPROM = "D"
    """Compare before write, no automatic resend."""
    BROADCAST = "E"
    """Once; nobody answers; verified one by one."""


class RequestPriority(IntEnum):
    """Who goes first on a bus."""

    STOP = 0
    COMMAND = 1
    PARAMETER = 2
    POLL = 3
    PROBE = 4


@dataclass(frozen=True, slots=True)
class Incomplete:
    """Ask again when ``need`` bytes (counted from offset 0) have arrived."""

    need: int


@dataclass(frozen=True, slots=True)
class Complete:
    """The first ``size`` bytes are this message."""

    message: Any
    size: int


@dataclass(frozen=True, slots=True)
class CompleteIfSilent:
    """The first ``size`` bytes are this message if nothing follows; else ask again with ``need`` bytes (ruling 11)."""

    message: Any
    size: int
    need: int


DecodeResult = Incomplete | Complete | CompleteIfSilent


class Codec(Protocol):
    """One encoding of one protocol, both sides. Pure; strict at offset 0; never hunts.

    All decoding raises ``drivebus.errors.ProtocolError`` (a subclass) and nothing else, for any bytes, and gives
    the same answer whole or byte by byte.
    """

    family: str
    """"c320", "dzb100", "modbus"."""
    encoding: str
    """"ascii", "hex", "rtu"."""

    @property
    def broadcast_address(self) -> int | None:
        """The address that every station hears and none answers."""
        ...

    def encode_request(self, request: Any, /) -> bytes:
        """The canonical bytes of a request. Raises ValueError for a field out of range."""
        ...

    def encode_reply(self, reply: Any, /) -> bytes:
        """The canonical bytes of a station's reply."""
        ...

    def decode_request(self, data: bytes, /) -> DecodeResult:
        """Station side: the request that begins at offset 0."""
        ...

    def decode_reply(self, request: Any, data: bytes, /) -> DecodeResult:
        """Host side: is this the reply to that request? An error reply of the drive is a message, not an exception."""
        ...

    def reply_size(self, request: Any, /) -> int:
        """Bytes of the normal reply; 0 where none is expected (broadcast)."""
        ...

    def largest_reply(self, request: Any, /) -> int:
        """Bytes of the longest lawful reply: with this the reply deadline is computed."""
        ...

    def address_of(self, request: Any, /) -> int:
        """The station that the request speaks to."""
        ...


@dataclass(frozen=True, slots=True)
class StationTiming:
    """When a station may be spoken to and how long it is waited for. Seconds unless the name says characters."""

    gap_characters: float = 3.5
    """Silence before each of our frames, from the last byte heard or our own computed last bit."""
    gap_floor_s: float = 0.0
    """The gap is never shorter than this (e.g. 1.75 ms above 19,200 baud for RTU)."""
    reply_delay_s: float = 0.1
    """Longest time the station may take before the first byte of its reply (family rule)."""
    reply_delay_characters: float = 0.0
    """The same where the manual counts in characters (C320: 8); both are added."""
    adapter_latency_s: float = 0.02
    """Allowance for the adapter and the operating system."""
    turnaround_s: float = 0.1
    """Silence after a broadcast, which nobody answers (F10)."""
    max_reply_lateness_s: float = 0.5
    """Quarantine after a timeout: the family's longest lateness (RELIABILITY 5.3)."""
    tolerate_leading_noise: bool = False
    """One stray byte may stand before a reply (a driver-enable glitch), in Modbus ASCII a few (ruling 10)."""

    def __post_init__(self) -> None:
        """Raises ValueError: with a time that never ends, every frame of the bus would wait, stops too."""
        for name in self.__slots__:
            value = getattr(self, name)
            if not 0 <= value < inf:
                raise ValueError(f"timing {name} {value}: expected a finite number, 0 or more")

    def gap_s(self, settings: SerialSettings) -> float:
        return max(settings.seconds(self.gap_characters), self.gap_floor_s)

    def timeout_s(self, settings: SerialSettings, reply_bytes: int) -> float:
        """From our own last bit to the last bit of the longest lawful reply."""
        return self.reply_delay_s + settings.seconds(self.reply_delay_characters + reply_bytes) + self.adapter_latency_s


@dataclass(frozen=True, slots=True)
class Permit:
    """Leave for one frame that is neither a read nor a stop. Only ``drives.gate`` grants it."""

    station: int
    effect: Effect
    retry_policy: RetryPolicy
    expires_at: float
    stop_epoch: int
    """The station's stop generation at grant: a newer stop voids every older permit (6.5)."""
    command_id: str = ""
    """Id of the command object it belongs to."""

    def __post_init__(self) -> None:
        """Raises ValueError for an expiry that is no number: no comparison would ever end it (I1)."""
        if self.expires_at != self.expires_at:
            raise ValueError(f"permit for station {self.station}: expires_at is NaN, expected monotonic seconds")


@dataclass(slots=True)
class BusRequest:
    """One transaction wanted of the bus, which looks at it once: changing it afterwards changes nothing. Not frozen,
    as ``Answer`` is not, because a frozen one takes four times as long to make, and each transaction makes both."""

    station: int
    request: Any
    priority: RequestPriority = RequestPriority.PARAMETER
    retry_policy: RetryPolicy = RetryPolicy.READ
    permit: Permit | None = None
    expires_at: float | None = None
    """Not sent after this monotonic second."""
    tag: Any = None
    """Carried through untouched."""


@dataclass(slots=True)
class BusResult:
    """What became of an Ask. Exactly one of ``reply`` and ``error`` is set, except for broadcasts (neither)."""

    bus_request: BusRequest
    reply: Any = None
    error: Exception | None = None
    sent: bytes = b""
    """The bytes that left, empty where nothing left."""
    received: bytes = b""
    sent_at: float | None = None
    """First bit on the wire, monotonic."""
    received_at: float | None = None
    attempts: int = 0


@dataclass(frozen=True, slots=True)
class StationConfig:
    """All that a bus must know of one station; made by a dialect."""

    address: int
    codec: Codec
    timing: StationTiming
    effect_of: Callable[[bytes], Effect]
    """Effect of an encoded request, from its bytes and what the drive's profile says of them."""
    sync_request: Callable[[int], Any]
    """n → a harmless request whose reply cannot be taken for any other recent one; n counts up (ruling 2)."""
    label: str = ""
    extra: Mapping[str, Any] = field(default_factory=dict)
