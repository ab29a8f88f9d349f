"""Open the bus and the drive that the options of a command name: on a port, or through a running service."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from drivebus.cli import output
from drivebus.user_input import parse_boolean

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.drives import Drive, DriveLimits
    from drivebus.ports import Port
    from drivebus.profiles import DriveProfile
    from drivebus.serial_settings import SerialSettings
    from drivebus.types import Json

T = TypeVar("T")
LATE_REPLY_WAIT_S = 1.0  # pause after a read without reply: one that comes before the next read is named as late


@dataclass(frozen=True, kw_only=True)
class Target:
    """The drive that the options of a command name."""

    port: str
    """Port URL; with ``service`` its address or socket."""
    model: str
    address: int
    baud: int | None = None
    format: str | None = None
    encoding: str | None = None
    option: tuple[tuple[str, str], ...] = ()
    """``--option NAME=VALUE``: values of profile options."""
    record: str | None = None
    """``--record FILE``: the capture to write."""
    must_record: bool = True
    """Whether a capture that can't be created ends the command before its first frame: never a stop."""
    service: str | None = None
    """``--service``: the service that owns the bus."""
    drive: str = ""
    """``--drive``: name of the drive in the service's plant."""

    @cached_property
    def profile(self) -> DriveProfile:
        """Profile of the model. Raises ProfileError for an unknown model."""
        from drivebus import profiles

        return profiles.load(self.model)

    def drive_options(self) -> dict[str, Any]:
        """Convert ``--option`` to the types of the profile. Raises ConfigurationError for an unknown name or value."""
        return {name: _option_value(self.profile, name, text) for name, text in self.option}

    def open_port(self) -> Port:
        """Return the port, not yet opened. Raises PortUrlError."""
        return open_port(self.port, self.profile, self.baud, self.format)


def _option_value(profile: DriveProfile, name: str, text: str) -> Any:
    from drivebus.errors import ConfigurationError

    reject_unknown_option(profile.model, name, sorted(profile.options))
    question = profile.question(name)
    value = _convert_like(text, profile.options[name])
    if value is None or not question.allows(value):
        raise ConfigurationError("cli.option_value", name=name, found=text, expected=question.expected)
    return value


def reject_unknown_option(model: str, name: str, option_names: Collection[str]) -> None:
    """Raise ConfigurationError for an option that the model does not have."""
    from drivebus.errors import ConfigurationError

    if not option_names:
        raise ConfigurationError("cli.option_none", model=model, found=name)
    if name not in option_names:
        raise ConfigurationError("cli.option_unknown", model=model, found=name, expected=tuple(option_names))


def _convert_like(text: str, like: Any) -> Any:
    """Convert ``text`` to the type of ``like``; None if that is not possible."""
    if isinstance(like, bool):
        return parse_boolean(text)
    try:
        return type(like)(text) if isinstance(like, int | float) else text
    except ValueError:
        return None


def open_port(url: str, profile: DriveProfile, baud: int | None, format: str | None) -> Port:
    """Return the port, not yet opened. The options override the URL, which overrides the profile.

    Raises PortUrlError, PortUnavailable for the terminal of this command.
    """
    from drivebus import ports
    from drivebus.serial_settings import SerialSettings

    reject_own_terminal(url)
    defaults = SerialSettings.parse(profile.serial.baud, profile.serial.format)
    return ports.open_port(url, baud=baud, format=format, defaults=defaults)


def reject_own_terminal(url: str) -> None:
    """Raise PortUnavailable where the port is the terminal of this command.

    The link of simulated drives that have ended leads to the pty of a terminal that was opened since then.
    """
    from drivebus import ports
    from drivebus.errors import PortUnavailable

    path = ports.parse_port_url(url).path
    with suppress(OSError):
        device = Path(path).stat().st_rdev
        for descriptor in (0, 1, 2):
            if os.isatty(descriptor) and os.fstat(descriptor).st_rdev == device:
                raise PortUnavailable("cli.own_terminal", port=path)


def note_foreign_settings(settings: SerialSettings, profile: DriveProfile) -> None:
    """Print a note where the manual of the model does not have the baud rate or format of the port."""
    serial = profile.serial
    if settings.baud in serial.bauds and settings.format in serial.formats:
        return
    expected = output.join(
        [output.join(map(str, serial.bauds), "items"), output.join(serial.formats, "items")], "clauses"
    )
    output.print_note("cli.serial_not_in_manual", model=profile.model, found=settings, expected=expected)


@asynccontextmanager
async def open_drive(target: Target, limits: DriveLimits | None = None) -> AsyncIterator[tuple[Bus, Drive]]:
    """Open the bus with the drive on it, within the user's ``limits``; close both afterwards.

    With ``target.service`` the pair has the same interface over the service. Raises PortUnavailable, PortUrlError,
    ProfileError, CaptureError where a required ``record`` can't be created, and the errors of the service.
    """
    if target.service is not None:
        async with _open_remote(target) as remote:
            yield remote
        return
    from drivebus.bus import Bus
    from drivebus.drives import Drive
    from drivebus.errors import BusError

    profile, options = target.profile, target.drive_options()
    with record_port(target.open_port(), target.record, required=target.must_record) as port:
        note_foreign_settings(port.settings, profile)
        async with Bus(port) as bus:
            drive = Drive(bus, profile, target.address, encoding=target.encoding, options=options, limits=limits)
            try:
                yield bus, drive
            except BusError:  # a reply from another address is a ProtocolError, with a remedy of its own
                if bus.health(target.address).foreign_master:
                    output.print_note("hint.foreign_master")
                raise
            finally:
                drive.close()


async def read_again_later(read: Callable[[], Awaitable[T]]) -> T:
    """Return what ``read`` returns after ``LATE_REPLY_WAIT_S``. A reply that comes meanwhile is named as late.

    Only for a command that reads: the port is in use meanwhile, and after any other a stop may be wanted. Raises the
    errors of ``read``, and ``click.Abort`` where a signal ends the wait.
    """
    from drivebus.cli.signals import shutdown_signals

    async def wait_and_read() -> T:
        await asyncio.sleep(LATE_REPLY_WAIT_S)
        return await read()

    with shutdown_signals() as shutdown:
        found = await shutdown.interruptible(wait_and_read())
        if found is None:
            raise click.Abort
        return found


@asynccontextmanager
async def _open_remote(target: Target) -> AsyncIterator[tuple[Any, Any]]:
    from drivebus.cli.remote.client import open_client
    from drivebus.cli.remote.drive import RemoteBus, RemoteDrive

    assert target.service is not None
    async with open_client(target.service) as client:
        on_request = partial(_end_line_and_note_request, target.drive)
        drive = RemoteDrive(client, target.drive, target.address, target.profile, on_request)
        try:
            yield RemoteBus(), drive
        finally:
            await drive.close()


def _end_line_and_note_request(drive: str, request: Json) -> None:
    """Print the request below the line that an attached command draws again and again."""
    output.end_live_line()
    note_control_request(drive, request)


def note_control_request(drive: str, request: Json) -> None:
    """Print that another user asks for control of the drive."""
    key = "control.requested" if request["reason"] is None else "control.requested_for"
    output.print_note(key, drive=drive, user=request["user"], reason=request["reason"])


@contextmanager
def record_port(port: Port, file: str | None, *, required: bool = True) -> Iterator[Port]:
    """Record all bytes of a port in a capture if ``file`` is given; report the file at the end."""
    with record_ports(file, required=required) as wrap:
        yield wrap(port)


@contextmanager
def record_ports(file: str | None, *, required: bool = True) -> Iterator[Callable[[Port], Port]]:
    """Provide a function that records port after port in one capture; report the file at the end.

    A disk error ends the capture, never the communication; ``required``: a file that can't be created prevents it.
    """
    if file is None:
        yield lambda port: port
        return
    from drivebus.ports.recording import RecordingPort

    recording: list[RecordingPort] = []

    def wrap(port: Port) -> Port:
        recording[:] = [recording[0].continue_on(port) if recording else RecordingPort(port, file, required=required)]
        return recording[0]

    try:
        yield wrap
    finally:
        for port in recording:
            port.end_capture()
    error = recording[0].error if recording else None
    if isinstance(error, OSError):
        from drivebus.errors import SystemReason

        output.print_note("record.cut", file=file, reason=SystemReason(error))
    elif error is not None:
        output.print_note("record.none", why=error)
    elif recording:
        output.print_note("record.done", file=file)
