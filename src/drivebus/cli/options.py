"""Options that several verbs share, each with a value that works."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from drivebus.cli import voice
from drivebus.cli.command import Argument, OneOf, Option

if TYPE_CHECKING:
    _Type = click.ParamType[Any]
else:
    _Type = click.ParamType


def _models(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    from drivebus import profiles

    return [CompletionItem(name) for name in profiles.models() if name.startswith(incomplete)]


def _links(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    from drivebus import ports

    found = [str(port.device) for port in ports.list_ports()]
    return [CompletionItem(name) for name in [*found, "sim://", "tcp://", "rfc2217://"] if name.startswith(incomplete)]


def link(name: str = "link") -> click.Argument:
    """LINK: where the line is."""
    return Argument([name], metavar="LINK", key="help.argument.link", shell_complete=_links)


def source() -> click.Argument:
    """LINK or a capture file."""
    return Argument(["source"], metavar="LINK|FILE", shell_complete=_links)


def line() -> list[click.Parameter]:
    """--baud and --format; without them the LINK's own, else the profile's."""
    bauds = click.IntRange(50, 4_000_000)
    return [
        Option(["--baud"], type=Checked(bauds, "cli.expect.baud"), metavar="BAUD", example="--baud 19200"),
        Option(["--format"], type=FORMAT, metavar="FORMAT", example="--format 8E1"),
    ]


def model(required: bool = True) -> click.Option:
    return Option(["--model"], required=required, metavar="MODEL", shell_complete=_models, example="--model c320")


def encoding() -> click.Option:
    return Option(["--encoding"], type=OneOf(["ascii", "hex", "rtu"]), metavar="ENCODING", example="--encoding rtu")


def drive() -> list[click.Parameter]:
    """LINK and all that names one drive on it."""
    station = Checked(click.IntRange(0, 247), "cli.expect.address")
    return [
        link(),
        model(),
        Option(["--address"], required=True, type=station, metavar="N", example="--address 1"),
        *line(),
        encoding(),
        setting(),
        record(),
    ]


def setting() -> click.Option:
    """--set: an open question of the family, answered."""
    example = "--set setpoint_coding=hex-0.1"
    return Option(["--set"], multiple=True, type=ASSIGNMENT, metavar="NAME=VALUE", example=example)


def record() -> click.Option:
    """--record: a capture of every byte, for ``monitor`` and for evidence."""
    return Option(["--record"], type=CAPTURE, metavar="FILE", example="--record trip-of-pump-3.dbcap")


def dry_run() -> click.Option:
    return Option(["--dry-run"], is_flag=True)


class Checked(_Type):
    """click's type, with a complaint in the user's language: ``key`` says what was expected."""

    def __init__(self, inner: _Type, key: str) -> None:
        self.inner = inner
        self.key = key
        self.name = inner.name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        try:
            return self.inner.convert(value, param, ctx)
        except click.BadParameter:
            self.fail(voice.say("cli.found_expected", found=value, expected=voice.say(self.key)), param, ctx)


class Number(_Type):
    """A number from ``low`` to ``high``, a whole one where these are; the complaint is in the user's language."""

    name = "number"

    def __init__(self, low: float, high: float) -> None:
        self.low, self.high = low, high
        self.kind = int if isinstance(low, int) else float

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        try:
            found = self.kind(value)
        except (ValueError, OverflowError):
            found = None
        if found is None or not self.low <= found <= self.high:
            self.fail(voice.say("cli.found_expected", found=value, expected=self._expected()), param, ctx)
        return found

    def _expected(self) -> str:
        if self.kind is int:
            return voice.say("cli.expect.whole", low=self.low, high=self.high)
        return voice.say("cli.expect.number", low=f"{self.low:g}", high=f"{self.high:g}")


class Parsed(_Type):
    """A value read by one function that raises ValueError; ``key`` says what was expected."""

    def __init__(self, name: str, read: Callable[[str], Any], key: str) -> None:
        self.name = name
        self.read = read
        self.key = key

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if not isinstance(value, str):
            return value
        try:
            return self.read(value)
        except ValueError:
            self.fail(voice.say("cli.found_expected", found=value, expected=voice.say(self.key)), param, ctx)


def _format(text: str) -> str:
    from drivebus.line import LineSettings

    return LineSettings.parse(9600, text).format


def addresses(text: str) -> tuple[int, ...]:
    """``0-3,7`` → (0, 1, 2, 3, 7). Raises ValueError."""
    found: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        low, high = _station(first), _station(last if dash else first)
        if high < low:
            raise ValueError(part)
        found += range(low, high + 1)
    return tuple(dict.fromkeys(found))


def _station(text: str) -> int:
    if not (text.isascii() and text.isdecimal() and int(text) <= 247):
        raise ValueError(text)
    return int(text)


def _frequency(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= 4000.0:
        raise ValueError(text)
    return value


def assignment(text: str) -> tuple[str, str]:
    """``NAME=VALUE``. Raises ValueError."""
    name, equals, value = (part.strip() for part in text.partition("="))
    if not (name and equals and value):
        raise ValueError(text)
    return name, value


def _capture(text: str) -> str:
    if not text.endswith(".dbcap"):
        raise ValueError(text)
    return text


FILE = Checked(click.Path(dir_okay=False, path_type=Path), "cli.expect.file")
FOLDER = Checked(click.Path(file_okay=False, path_type=Path), "cli.expect.folder")
SEED = Number(0, 2**32 - 1)
PERIOD_S = Number(0.1, 86_400.0)
CAPTURE = Parsed("capture", _capture, "cli.expect.capture")
FORMAT = Parsed("format", _format, "cli.expect.format")
ADDRESSES = Parsed("addresses", addresses, "cli.expect.addresses")
FREQUENCY = Parsed("frequency", _frequency, "cli.expect.frequency")
ASSIGNMENT = Parsed("assignment", assignment, "cli.expect.assignment")
