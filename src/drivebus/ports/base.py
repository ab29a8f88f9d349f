"""Interface of a port, which sends and receives bytes, and its capabilities.

A port of one event loop sends and receives once opened until ``close()``, or until it is lost and calls
``receiver.port_lost`` once. It may be opened again, and then finds its device by the identity that it remembers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

from drivebus import i18n
from drivebus.serial_settings import SerialSettings
from drivebus.types import Capabilities, EchoSetting, Receiver


@dataclass(frozen=True, slots=True)
class PortNote:
    """A fact about an open port that its user should know, as a message of the catalogues."""

    key: str
    params: Mapping[str, Any] = field(default_factory=dict)

    def text(self, language: str = "en") -> str:
        """Return the sentence in ``language`` ("en" or "zh")."""
        return i18n.text(self.key, language, **self.params)


class Port(Protocol):
    """A connection to one bus. Created unopened by ``drivebus.ports.open_port``."""

    @property
    def settings(self) -> SerialSettings:
        """Baud rate and character format."""
        ...

    @property
    def capabilities(self) -> Capabilities:
        """Properties of the port, final once ``open`` has returned."""
        ...

    @property
    def identity(self) -> str:
        """Name of the device that survives replugging where it has one; the key of stored calibrations."""
        ...

    @property
    def url(self) -> str:
        """The port URL that opens this port again."""
        ...

    @property
    def echo(self) -> EchoSetting:
        """The user's setting for the adapter's echo."""
        ...

    async def open(self, receiver: Receiver) -> None:
        """Open, or open again. Raises PortUnavailable with the reason and the remedy."""
        ...

    def write(self, data: bytes, /) -> None:
        """Send at once; never blocks, never sends bytes of an earlier opening. Raises PortLost where it is not open."""
        ...

    async def close(self) -> None:
        """Release the port; the receiver is not called. Idempotent."""
        ...


def port_notes(port: Port) -> tuple[PortNote, ...]:
    """Return the notes of an open port; most have none."""
    return tuple(getattr(port, "notes", ()))


def drive_options(port: Port, address: int) -> Mapping[str, Any]:
    """Return the profile options that the port itself has for a drive; only the port of simulated drives has any."""
    known: Mapping[int, Mapping[str, Any]] = getattr(port, "drive_options", {})
    return known.get(address, {})


@runtime_checkable
class PendingReader(Protocol):
    """A port that delivers on request what it has received, before the event loop calls it."""

    def read_pending(self) -> None:
        """Deliver the bytes that have arrived and are not delivered yet."""
        ...


@runtime_checkable
class PausableReader(PendingReader, Protocol):
    """A port that can leave received bytes in the kernel: one read for a whole reply, not a wake-up for each byte.

    A hang-up during a pause is noticed at the next read.
    """

    def pause_reading(self) -> None:
        """Deliver bytes no longer as they come. Idempotent."""
        ...

    def resume_reading(self) -> None:
        """Deliver bytes as they come again. Idempotent; without effect on a closed port."""
        ...
