"""What a port is to everybody above: bytes in, bytes out, and what it can promise. No I/O lives here.

A port belongs to one event loop. Its life: ``open(receiver)`` → ``write`` and ``receiver.data_received`` →
either ``close()`` (silent) or one ``receiver.port_lost``; after both it may be opened again, and then finds
its device by the identity that it remembers (F12).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, runtime_checkable

from drivebus import i18n
from drivebus.errors import PortLost
from drivebus.serial_settings import SerialSettings

EchoSetting = Literal["detect", "on", "off"]


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What is real about a port (ruling 9): shown to the user, never fatal."""

    has_line_timing: bool = False
    """Bytes take their character time: 'before our own last stop bit' means something."""
    parity: bool = False
    """The parity of every received byte is checked and bad bytes are counted in ``marks``."""
    direction_control: bool = False
    """The port itself switches the RS485 driver (kernel TIOCSRS485); False: the adapter does."""


@dataclass(frozen=True, slots=True)
class PortNote:
    """Something true of an open port that its user should know; a sentence of the catalogues."""

    key: str
    params: Mapping[str, Any] = field(default_factory=dict)

    def text(self, language: str = "en") -> str:
        return i18n.text(self.key, language, **self.params)


class Receiver(Protocol):
    """Who is told what comes in. Called from the event loop, never from within ``write`` or ``open``."""

    def data_received(self, data: bytes, line_errors: int = 0) -> None:
        """Bytes as they came; ``marks`` of them had a parity or framing error, or were a break (G20).

        An RFC 2217 server tells of bad bytes apart from them: then ``data`` may be empty with ``marks`` above 0.
        """
        ...

    def port_lost(self, error: PortLost) -> None:
        """The open port is gone. Exactly once per ``open``, never after ``close``."""
        ...


class Port(Protocol):
    """One line to a bus. Made unopened by ``drivebus.ports.open_port``."""

    @property
    def settings(self) -> SerialSettings:
        """Baud rate and character format."""
        ...

    @property
    def capabilities(self) -> Capabilities:
        """Final once ``open`` has returned."""
        ...

    @property
    def identity(self) -> str:
        """A name that survives replugging and renumbering as far as the port has one; key of stored proofs."""
        ...

    @property
    def url(self) -> str:
        """The LINK that opens this port again."""
        ...

    @property
    def echo(self) -> EchoSetting:
        """What the user said about the adapter's echo (F03)."""
        ...

    async def open(self, receiver: Receiver) -> None:
        """Open, or open again. Raises PortUnavailable with why and what to do."""
        ...

    def write(self, data: bytes, /) -> None:
        """Send at once; never blocks, never keeps bytes of an earlier opening. Raises PortLost where it is not open."""
        ...

    async def close(self) -> None:
        """Let go of everything. Idempotent; the receiver hears nothing of it."""
        ...


def port_notes(port: Port) -> tuple[PortNote, ...]:
    """What an open port wants its user to know; most have nothing to say."""
    return tuple(getattr(port, "notes", ()))


@runtime_checkable
class PausableReader(Protocol):
    """A port that can be told not to wake the loop for a while."""

    def pause_until(self, when: float, /) -> None:
        """Deliver nothing before loop time ``when``; bytes wait in the kernel. ``when`` in the past: deliver now."""
        ...
