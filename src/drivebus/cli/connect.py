"""From LINK, --model and --address to an open bus and a drive on it."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.drives import Drive, DriveLimits
    from drivebus.ports.base import Port
    from drivebus.profiles import DriveProfile
    from drivebus.serial_settings import SerialSettings


@dataclass(frozen=True, slots=True)
class Target:
    """What the options of a drive verb say: where, what, how."""

    link: str
    model: str
    address: int
    baud: int | None = None
    format: str | None = None
    encoding: str | None = None
    set: tuple[tuple[str, str], ...] = ()
    """``--set NAME=VALUE``: open questions of the family, answered for this drive."""
    record: str | None = None
    """``--record FILE``: a capture to write."""
    service: str | None = None
    """``--service``: who owns the bus; ``link`` is then its address too."""
    drive: str = ""
    """``--drive``: the drive's name in the service's plant."""

    def profile(self) -> DriveProfile:
        """Raises ProfileError for a model nobody knows."""
        from drivebus import profiles

        return profiles.load(self.model)

    def drive_options(self) -> dict[str, Any]:
        """``--set`` as values. Raises ConfigurationError for a name or value that the profile does not know."""
        profile = self.profile()
        return {name: _option_value(profile, name, text) for name, text in self.set}

    def serial_settings(self) -> SerialSettings:
        """Settings of the line: the options', else the LINK's, else the profile's."""
        return open_port(self.link, self.profile(), self.baud, self.format).settings


def _option_value(profile: DriveProfile, name: str, text: str) -> Any:
    from drivebus.errors import ConfigurationError

    if name not in profile.settings:
        known = ", ".join(sorted(profile.settings)) or "–"
        raise ConfigurationError("cli.setting_unknown", model=profile.model, found=name, expected=known)
    question = next((one for one in profile.open_questions if one.setting == name), None)
    choices = question.choices if question else ()
    value = _convert_like(text, profile.settings[name])
    if value is None or (choices and value not in choices):
        expected = ", ".join(str(choice) for choice in choices) or type(profile.settings[name]).__name__
        raise ConfigurationError("cli.setting_value", name=name, found=text, expected=expected)
    return value


_BOOLEANS = {"true": True, "yes": True, "on": True, "1": True, "false": False, "no": False, "off": False, "0": False}


def _convert_like(text: str, like: Any) -> Any:
    """``text`` as a value of the same type as ``like``; None where it is none."""
    if isinstance(like, bool):
        return _BOOLEANS.get(text.lower())
    try:
        return type(like)(text) if isinstance(like, int | float) else text
    except ValueError:
        return None


def open_port(link: str, profile: DriveProfile | None, baud: int | None, format: str | None) -> Port:
    """Return an unopened port; the profile supplies what options and URL leave out. Raises PortUrlError."""
    from drivebus import ports
    from drivebus.ports.url import parse_port_url

    if profile is not None:
        given = parse_port_url(link).explicit
        baud = baud if baud is not None or "baud" in given else profile.serial.baud
        format = format if format is not None or "format" in given else profile.serial.format
    return ports.open_port(link, baud=baud, format=format)


@asynccontextmanager
async def open_drive(target: Target, limits: DriveLimits | None = None) -> AsyncIterator[tuple[Bus, Drive]]:
    """The open bus with the drive on it, within the user's ``limits``; closed afterwards.

    Raises PortUnavailable, PortUrlError, ProfileError; CaptureError where ``record`` can't be created. With ``service``
    the same face over the service that owns the bus; raises what that says.
    """
    if target.service is not None:
        async with _open_remote(target) as served:
            yield served
        return
    from drivebus.bus import Bus
    from drivebus.cli import output
    from drivebus.drives import Drive
    from drivebus.errors import BusError

    profile = target.profile()
    settings = target.drive_options()
    with record_port(open_port(target.link, profile, target.baud, target.format), target.record) as port:
        async with Bus(port) as bus:
            found = Drive(bus, profile, target.address, encoding=target.encoding, settings=settings, limits=limits)
            try:
                yield bus, found
            except BusError:
                if bus.health(target.address).foreign_master:
                    output.print_note("hint.foreign_master")
                raise
            finally:
                found.close()


@asynccontextmanager
async def _open_remote(target: Target) -> AsyncIterator[tuple[Any, Any]]:
    from drivebus.cli.remote.client import open_client
    from drivebus.cli.remote.drive import RemoteBus, RemoteDrive

    assert target.service is not None
    async with open_client(target.service) as client:
        found = RemoteDrive(client, target.drive, target.address, target.profile())
        try:
            yield RemoteBus(), found
        finally:
            await found.close()


@contextmanager
def record_port(port: Port, file: str | None) -> Iterator[Port]:
    """The port, with a capture of all that passes through it where ``file`` names one; says so at the end."""
    with record_ports(file) as around:
        yield around(port)


@contextmanager
def record_ports(file: str | None) -> Iterator[Callable[[Port], Port]]:
    """What puts one capture around port after port, each opened before the next; says at the end what became of it.

    A disk that fails ends the capture, never what the bus does.
    """
    from drivebus.cli import output

    if file is None:
        yield lambda port: port
        return
    from drivebus.ports.recording import RecordingPort

    capturing: list[RecordingPort] = []

    def around(port: Port) -> Port:
        capturing[:] = [capturing[0].continue_on(port) if capturing else RecordingPort(port, file)]
        return capturing[0]

    try:
        yield around
    finally:
        for one in capturing:
            one.end_capture()
    error = capturing[0].error if capturing else None
    if error is not None:
        output.print_note("record.cut", file=file, reason=error.strerror or str(error))
    elif capturing:
        output.print_note("record.done", file=file)
