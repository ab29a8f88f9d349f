"""All errors of drivebus. Each carries numbers, a scope, and whether a retry may help.

    DrivebusError
    ├── ConfigurationError      invalid file, port URL or argument (exit 2)
    │   ├── ProfileError
    │   └── PortUrlError
    ├── ProtocolError           these bytes are not the expected frame (exit 3)
    │   ├── LengthError · HeaderError · AddressError · EchoError · AlphabetError · CodeError
    │   └── ChecksumError · TerminatorError · TrailingError
    ├── BusError
    │   ├── NoReply             no whole reply before the deadline
    │   ├── LineError           parity or framing error, collision, no silence
    │   ├── Expired             the command was too old to be sent
    │   ├── NotPermitted        a frame that may act had no valid permit
    │   ├── Superseded          a newer stop removed the request from the queue
    │   └── PortError
    │       ├── PortUnavailable can't be opened: reason and remedy
    │       └── PortLost        was open and is gone
    ├── DriveError
    │   ├── DriveRejected       the drive rejected the request, with its error code
    │   ├── CapabilityError     this family or model can't do that: refused before sending
    │   ├── LimitError          outside the drive's limits: refused before sending
    │   ├── ConfirmationRequired the user must confirm this write: refused before sending
    │   ├── PreflightError      the drive is not set to obey the bus: what to set on the keypad
    │   ├── StartInhibited      no motion now: stale status, foreign master, bad link, no control
    │   ├── TargetNotReached    the drive reports another state than requested
    │   ├── OutcomeUnknown      sent, and it is not known whether it was done (exit 4)
    │   ├── StopUnconfirmed     the drive did not report stopped (exit 4)
    │   └── EepromBudgetExceeded too many EEPROM writes of that parameter today
    └── ServiceError            the service that owns the buses refused the request; nothing was sent
        ├── NotFound            no such operation, drive, group, bus, alarm or incident
        ├── InvalidParameters   wrong parameters: each with its path, found and expected
        ├── PermissionDenied    the right is missing
        ├── ControlNotHeld      another user has control of this drive, or no user has
        ├── ArmRequired         a remote start takes two steps
        ├── Interlocked         an interlock forbids the start
        ├── WaiverRequired      the drive may run on when this host fails, and no waiver permits that
        ├── TooManyCommands     the records of refused commands would fill the audit trail
        ├── AuditUnavailable    the start can't be written into the audit trail
        └── ServiceUnavailable  the service does not answer

``key`` is a message of the catalogues (``i18n``), ``params`` are its values; ``str()`` is English.
"""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from typing import Any, ClassVar

from drivebus import i18n


class ErrorScope(StrEnum):
    """Extent of an error: this request only, the station, the port, or the configuration."""

    REQUEST = "request"
    STATION = "station"
    PORT = "port"
    CONFIGURATION = "configuration"


_NUMBERLESS_ERRORS = {TimeoutError: "timeout", ConnectionResetError: "closed", FileExistsError: "eexist"}
"""Classes that Python's own libraries raise without an error number, to the end of the key of their sentence."""


class SystemReason:
    """Reason of a failed system call, as the parameter of a sentence; translated where its error number is known."""

    def __init__(self, error: Exception) -> None:
        self._key = f"system.error_{_error_name(error)}"
        self._words = str(getattr(error, "strerror", None) or "") or str(error) or type(error).__name__

    def text(self, language: str = "en") -> str:
        """Return the reason in a language, in the words of the system for another number."""
        return i18n.text(self._key, language) if i18n.known(self._key) else self._words

    def __str__(self) -> str:
        return self.text("en")


def _error_name(error: Exception) -> str:
    """Return the name of an error number in lower case, or of the class of an error without a number; else nothing."""
    number = getattr(error, "errno", None)
    if number is None:
        return next((name for kind, name in _NUMBERLESS_ERRORS.items() if isinstance(error, kind)), "")
    if type(error).__module__ == "socket":  # a gaierror: the resolver has numbers of its own
        import socket

        return next((n.lower() for n in dir(socket) if n.startswith("EAI_") and getattr(socket, n) == number), "")
    return "" if type(error).__module__ == "ssl" else errno.errorcode.get(number, "").lower()  # those are OpenSSL's


class DrivebusError(Exception):
    """Base of all errors of drivebus."""

    scope: ClassVar[ErrorScope] = ErrorScope.REQUEST
    retryable: ClassVar[bool] = False
    outcome: Any = None
    """The ``drives.outcome.Outcome`` of a command that ended in this error: status and evidence."""
    may_be_running: bool | None = None
    """Whether the motor may be running by the command that ended in this error, so that a stop must follow.

    False: no frame that moves was sent, the drive rejected it, or a stop after it is confirmed. None: not known, which
    counts as True.
    """

    def __init__(self, key: str, /, **params: Any) -> None:
        self.key = key
        self.params = params
        super().__init__(key, params)

    def text(self, language: str = "en") -> str:
        """Return the message in ``language`` ("en" or "zh")."""
        return i18n.text(self.key, language, **self.params)

    def __str__(self) -> str:
        return self.text("en")


@contextmanager
def before_motion() -> Iterator[None]:
    """Mark an error of the block as one before which no frame that moves was sent."""
    try:
        yield
    except DrivebusError as error:
        error.may_be_running = False
        raise


class ConfigurationError(DrivebusError):
    """Invalid file, port URL or argument; names file, line, key, found, expected, remedy where known."""

    scope = ErrorScope.CONFIGURATION


class ProfileError(ConfigurationError):
    """Invalid profile file."""


class PortUrlError(ConfigurationError):
    """Invalid port URL or option."""


class ProtocolError(DrivebusError):
    """These bytes are not the expected frame. ``expected`` and ``found`` are the two values."""

    retryable = True

    def __init__(self, key: str, /, *, expected: Any = None, found: Any = None, size: int = 0, **params: Any) -> None:
        self.expected = expected
        self.found = found
        self.size = size
        """Size of the rejected frame where it was whole and valid for another station; else 0."""
        super().__init__(key, expected=expected, found=found, **params)


class LengthError(ProtocolError):
    """The frame is too long or too short, or its byte count is impossible."""


class HeaderError(ProtocolError):
    """The first bytes can't begin the expected frame."""


class AddressError(ProtocolError):
    """Another station replied. ``size`` is set when its frame was whole."""


class EchoError(ProtocolError):
    """A field that the drive echoes differs from the request."""


class AlphabetError(ProtocolError):
    """A byte is no digit of the frame's alphabet."""


class CodeError(ProtocolError):
    """A response code, state, function or other enumerated value is not documented."""


class ChecksumError(ProtocolError):
    """The received checksum differs from the computed one."""


class TerminatorError(ProtocolError):
    """The end mark is missing."""


class TrailingError(ProtocolError):
    """Bytes follow a frame whose length is known."""


class BusError(DrivebusError):
    """The bus could not perform the request."""


class NoReply(BusError):
    """No whole reply came before the deadline."""

    scope = ErrorScope.STATION
    retryable = True


class LineError(BusError):
    """Parity or framing error, collision on the wire, or no silence to send in."""

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
    """The port can't be opened: the message gives the reason and the remedy."""


class PortLost(PortError):
    """The port was open and is gone; pending commands have an unknown outcome."""


class DriveError(DrivebusError):
    """The drive, or its rules, rejected the request."""

    scope = ErrorScope.STATION


class DriveRejected(DriveError):
    """The drive replied with its own error code (``params["code"]``)."""


class CapabilityName:
    """Name of a capability as the page has it, as the parameter of a sentence; one without a name as it is."""

    def __init__(self, capability: str) -> None:
        self._capability = capability

    def text(self, language: str = "en") -> str:
        """Return the name in a language."""
        key = f"page.can_{self._capability}"
        return i18n.text(key, language) if i18n.known(key) else self._capability

    def __str__(self) -> str:
        return self.text("en")


class CapabilityError(DriveError):
    """This family or model can't do that; nothing was sent.

    ``what`` names the capability for programs, ``command`` is its name in the sentence.
    """

    def __init__(self, key: str, /, **params: Any) -> None:
        if "what" in params:
            params = {"command": CapabilityName(str(params["what"])), **params}
        super().__init__(key, **params)


class LimitError(DriveError):
    """The value is outside the drive's limits; nothing was sent."""


class ConfirmationRequired(DriveError):
    """The user must confirm this write; nothing was sent.

    It may move the motor, make the drive unreachable, or end its control by the bus.
    """


class PreflightError(DriveError):
    """The drive is not set to obey the bus; names the parameters and keypad steps."""


class StartInhibited(DriveError):
    """A moving frame is not allowed now; nothing was sent."""


class TargetNotReached(DriveError):
    """The drive reports another state than requested."""


class OutcomeUnknown(DriveError):
    """The command was sent, and it is not known whether it was executed."""


class StopUnconfirmed(DriveError):
    """The drive did not report stopped; the message names a stop that was withheld from a drive of another model."""


class EepromBudgetExceeded(DriveError):
    """The EEPROM write budget of this parameter is used up."""


class ServiceError(DrivebusError):
    """The service that owns the buses rejected the request; nothing was sent."""


class NotFound(ServiceError):
    """No such operation, drive, group, bus, alarm or incident."""


class InvalidParameters(ServiceError):
    """Wrong parameters. ``params["faults"]`` lists each with ``path``, ``found`` and ``expected``."""


class PermissionDenied(ServiceError):
    """The actor lacks the right that the operation needs."""


class ControlNotHeld(ServiceError):
    """The user does not have control of the drive, and the command needs it."""


class ArmRequired(ServiceError):
    """A remote start takes two steps: arm, then start within ten seconds, once."""


class Interlocked(ServiceError):
    """An interlock forbids the start."""


class WaiverRequired(ServiceError):
    """The drive may run on when this host fails, and no waiver permits its start."""


class TooManyCommands(ServiceError):
    """Too many commands of this user were refused or sent nothing. ``retry_s`` is the waiting time in seconds."""

    retryable = True


class AuditUnavailable(ServiceError):
    """The audit trail can't be written: no start."""

    retryable = True


class ServiceUnavailable(ServiceError):
    """The service does not answer."""

    retryable = True
