"""Types that several packages share: JSON objects, and the interface between a port and its receiver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, Protocol

from drivebus.errors import PortLost

Json = dict[str, Any]
"""A JSON object."""

EchoSetting = Literal["detect", "on", "off"]
"""The user's setting: does the adapter return what we send?"""


@dataclass(frozen=True, slots=True)
class Capabilities:
    """Properties of a port that depend on the hardware and the operating system: shown to the user, never fatal."""

    has_line_timing: bool = False
    """Bytes are delivered when they were on the wire, so that "before our own last stop bit" has a meaning."""
    parity: bool = False
    """The parity of every received byte is checked, and bad bytes are counted in ``line_errors``."""
    direction_control: bool = False
    """The port itself switches the RS485 driver (kernel TIOCSRS485); False: the adapter does."""


class Receiver(Protocol):
    """Receiver of a port's events. Called from the event loop, never from within ``write`` or ``open``."""

    def data_received(self, data: bytes, line_errors: int = 0) -> None:
        """Receive bytes, of which ``line_errors`` had a parity or framing error, or were a break.

        An RFC 2217 server reports bad bytes apart from the data: then ``data`` may be empty.
        """
        ...

    def port_lost(self, error: PortLost) -> None:
        """Handle the loss of the open port. Called exactly once per ``open``, never after ``close``."""
        ...
