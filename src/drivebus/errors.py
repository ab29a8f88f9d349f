"""The whole error tree. Each error carries numbers, a scope and whether trying again may help.

    DrivebusError
    ├── ConfigurationError      a file, a link or an argument is wrong (exit 2)
    │   ├── ProfileError
    │   └── PortUrlError
    ├── ProtocolError           these bytes are not the frame that was expected (exit 3)
    │   ├── LengthError · HeaderError · AddressError · EchoError · AlphabetError · CodeError
    │   └── ChecksumError · TerminatorError · TrailingError
    ├── BusError
    │   ├── NoReply             nothing (or nothing whole) came before the deadline
    │   ├── LineError           parity or framing marks, collision
    │   ├── Expired             the command was too old to send
    │   ├── NotPermitted        a frame that may act had no valid permit
    │   ├── Superseded          a newer stop removed it from the queue
    │   └── PortError
    │       ├── PortUnavailable can't be opened: why, and what to do
    │       └── PortLost        was open and is gone
    ├── DriveError
    │   ├── Refused             the drive said no, with its code
    │   ├── CapabilityError     this family or model can't do that: refused before sending
    │   ├── LimitError          outside the drive's limits: refused before sending
    │   ├── PreflightError      the drive does not listen to the bus: what to set on the keypad
    │   ├── StartInhibited           not now: stale status, foreign master, bad link, no ownership
    │   ├── TargetNotReached          the drive reported something else than was asked for
    │   ├── OutcomeUnknown      sent, and nobody can say whether it was done (exit 4)
    │   ├── StopUnconfirmed     the stop was sent; the drive did not report stopped (exit 4)
    │   └── WearBudget          too many EEPROM writes of that parameter today
    └── ServiceError              the service that owns the buses said no; nothing was sent
        ├── NotFound            no such operation, drive, group, bus, alarm or case
        ├── InvalidParameters         wrong parameters: each with its path, found and expected
        ├── Forbidden           the right is missing
        ├── ControlNotHeld            somebody else commands this drive now
        ├── ArmRequired           a start from afar takes two steps
        ├── Interlocked         an interlock forbids the start
        ├── WaiverRequired        the drive would run on when this host dies, and nobody has allowed that
        ├── AuditUnavailable    the start can't be written into the audit trail
        └── ServiceUnavailable  the plant does not answer

``key`` is a sentence in the catalogues (``i18n``), ``params`` are its numbers; ``str()`` is English.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Any, ClassVar

from drivebus import i18n


class ErrorScope(StrEnum):
    """What an error spoils: this request only, the station, or the whole port."""

    REQUEST = "request"
    STATION = "station"
    PORT = "port"
    CONFIGURATION = "configuration"


class DrivebusError(Exception):
    """Base of all errors of drivebus."""

    scope: ClassVar[ErrorScope] = ErrorScope.REQUEST
    retryable: ClassVar[bool] = False
    outcome: Any = None
    """The ``drives.state.Outcome`` of a command that ended in this error: its word and its evidence."""

    def __init__(self, key: str, /, **params: Any) -> None:
        self.key = key
        self.params = params
        super().__init__(key, params)

    def text(self, language: str = "en") -> str:
        """The sentence in ``language`` ("en" or "zh")."""
        return i18n.text(self.key, language, **self.params)

    def __str__(self) -> str:
        return self.text("en")


class ConfigurationError(DrivebusError):
    """A file, link or argument is wrong; names file, line, key, found, expected, remedy where known."""

    scope = ErrorScope.CONFIGURATION


class ProfileError(ConfigurationError):
    """A profile file is refused."""


class PortUrlError(ConfigurationError):
    """A LINK or its options can't be understood."""


class ProtocolError(DrivebusError):
    """These bytes are not the frame that was expected. ``expected`` and ``found`` are the two numbers."""

    retryable = True

    def __init__(self, key: str, /, *, expected: Any = None, found: Any = None, size: int = 0, **params: Any) -> None:
        self.expected = expected
        self.found = found
        self.size = size
        """Bytes that the refused frame took, where it was whole and valid for somebody else; else 0."""
        super().__init__(key, expected=expected, found=found, **params)


class LengthError(ProtocolError):
    """Too long, too short, or a byte count that can't be."""


class HeaderError(ProtocolError):
    """The first bytes can't begin the expected frame."""


class AddressError(ProtocolError):
    """Another station answered. ``size`` is set when its frame was whole."""


class EchoError(ProtocolError):
    """A field that the drive echoes differs from the request."""


class AlphabetError(ProtocolError):
    """A byte is no digit of the frame's alphabet (T19)."""


class CodeError(ProtocolError):
    """A response code, state, function or other enumerated value that nobody documented."""


class ChecksumError(ProtocolError):
    """Checksum received and computed differ."""


class TerminatorError(ProtocolError):
    """The end mark is missing."""


class TrailingError(ProtocolError):
    """Bytes follow a frame whose length is known."""


class BusError(DrivebusError):
    """The bus could not do it."""


class NoReply(BusError):
    """Nothing, or nothing whole, came before the deadline."""

    scope = ErrorScope.STATION
    retryable = True


class LineError(BusError):
    """Parity or framing marks, or a collision on the wire."""

    retryable = True


class Expired(BusError):
    """The command was too old to be sent."""


class NotPermitted(BusError):
    """A frame that may act had no valid permit."""


class Superseded(BusError):
    """A newer stop removed this request from the queue."""


class PortError(BusError):
    """The port itself failed."""

    scope = ErrorScope.PORT


class PortUnavailable(PortError):
    """The port can't be opened: the sentence says why and what to do."""


class PortLost(PortError):
    """The port was open and is gone; what was pending has an unknown outcome."""


class DriveError(DrivebusError):
    """The drive, or its rules, said no."""

    scope = ErrorScope.STATION


class DriveRejected(DriveError):
    """The drive answered with its own error code (``params["code"]``)."""


class CapabilityError(DriveError):
    """This family or model can't do that; nothing was sent."""


class LimitError(DriveError):
    """Outside the drive's limits; nothing was sent."""


class PreflightError(DriveError):
    """The drive is not set to listen to the bus; names the parameters and keypad steps."""


class StartInhibited(DriveError):
    """A moving frame is not allowed now; nothing was sent."""


class TargetNotReached(DriveError):
    """The drive reported something else than was asked for."""


class OutcomeUnknown(DriveError):
    """Sent, and nothing tells whether it was done."""


class StopUnconfirmed(DriveError):
    """The stop was sent and the drive did not report stopped."""


class EepromBudgetExceeded(DriveError):
    """The EEPROM write budget of this parameter is used up."""


class ServiceError(DrivebusError):
    """The service that owns the buses said no; nothing was sent."""


class NotFound(ServiceError):
    """No such operation, drive, group, bus, alarm or case."""


class InvalidParameters(ServiceError):
    """Wrong parameters. ``params["faults"]`` lists each with ``path``, ``found`` and ``expected``."""


class PermissionDenied(ServiceError):
    """The actor lacks the right that the operation needs."""


class ControlNotHeld(ServiceError):
    """Somebody else holds the drive's lease, or nobody does and the command needs one."""


class ArmRequired(ServiceError):
    """A start from afar takes two steps: arm, then start within ten seconds, once."""


class Interlocked(ServiceError):
    """An interlock forbids the start."""


class WaiverRequired(ServiceError):
    """The drive does not certainly stop when this host dies, and nobody has recorded that it may start all the same."""


class AuditUnavailable(ServiceError):
    """The audit trail can't be written: no start (G14)."""

    retryable = True


class ServiceUnavailable(ServiceError):
    """The plant does not answer."""

    retryable = True
