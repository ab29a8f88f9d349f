"""Options and option types that several commands share."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from drivebus.cli import output
from drivebus.cli.click_ext import Argument, Choice, Option
from drivebus.user_input import HIGHEST_ADDRESS, half_width, parse_addresses, parse_decimal

if TYPE_CHECKING:
    _Type = click.ParamType[Any]
else:
    _Type = click.ParamType


def _complete_models(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    from drivebus import profiles

    return [CompletionItem(name) for name in profiles.models() if name.startswith(incomplete.lower())]


def complete_model_list(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Return the lists with each model that begins as the last word of a list."""
    before, comma, last = incomplete.rpartition(",")
    return [CompletionItem(before + comma + str(item.value)) for item in _complete_models(ctx, param, last)]


def complete_ports(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Return the serial ports and the schemes of the other ports that begin so."""
    from drivebus import ports

    devices = [str(port.device) for port in ports.list_ports()]
    return [
        CompletionItem(name) for name in [*devices, "sim://", "tcp://", "rfc2217://"] if name.startswith(incomplete)
    ]


def port_argument() -> click.Argument:
    """Return the argument PORT."""
    return Argument(["port"], metavar="PORT", shell_complete=complete_ports)


def source_argument() -> click.Argument:
    """Return the argument PORT or capture file."""
    return Argument(["source"], metavar="PORT|FILE", shell_complete=complete_ports)


def serial_options(key_prefix: str = "help.option") -> list[click.Parameter]:
    """Return ``--baud`` and ``--format``; ``key_prefix`` of their help texts."""
    baud = CheckedType(NumberType(50, 4_000_000), "cli.expect.baud")
    return [
        Option(["--baud"], type=baud, metavar="BAUD", key=f"{key_prefix}.baud", example="--baud 19200"),
        Option(["--format"], type=FORMAT, metavar="FORMAT", key=f"{key_prefix}.format", example="--format 8E1"),
    ]


def model_option(*, required: bool = True) -> click.Option:
    return Option(
        ["--model"],
        required=required,
        type=MODEL,
        metavar="MODEL",
        shell_complete=_complete_models,
        example="--model c320",
    )


def encoding_option() -> click.Option:
    return Option(["--encoding"], type=Choice(["ascii", "hex", "rtu"]), metavar="ENCODING", example="--encoding rtu")


def drive_options() -> list[click.Parameter]:
    """Return PORT and the options that name one drive on it."""
    address = CheckedType(NumberType(0, HIGHEST_ADDRESS), "cli.expect.address")
    return [
        port_argument(),
        model_option(),
        Option(["--address"], required=True, type=address, metavar="N", example="--address 1"),
        *serial_options(),
        encoding_option(),
        profile_option(),
        record_option(),
    ]


def profile_option(key: str = "help.option.option") -> click.Option:
    """Return ``--option``: a value of a profile option; ``key`` of its help text."""
    example = "--option setpoint_coding=hex-0.1"
    return Option(
        ["--option"],
        multiple=True,
        type=ASSIGNMENT,
        callback=reject_second_value,
        metavar="NAME=VALUE",
        key=key,
        example=example,
    )


def reject_second_value(
    ctx: click.Context, param: click.Parameter, assignments: tuple[tuple[str, Any], ...]
) -> tuple[tuple[str, Any], ...]:
    """Return assignments. Raises BadParameter for two values of one name that differ."""
    values: dict[str, Any] = {}
    for name, value in assignments:
        if values.setdefault(name, value) != value:
            both = output.join([_assignment_text(name, each) for each in (values[name], value)], "items")
            raise click.BadParameter(output.text("cli.given_twice", values=both), ctx, param)
    return assignments


def _assignment_text(name: str, value: float | str) -> str:
    return f"{name}={str(value).removesuffix('.0')}"


def record_option() -> click.Option:
    """Return ``--record``: a capture of every byte."""
    example = "--record trip-of-pump-3.dbcap"
    return Option(["--record"], type=CAPTURE, metavar="FILE", example=example, unused="record.none")


def service_option() -> click.Option:
    """Return ``--service``: the address or socket of a running service."""
    return Option(["--service"], metavar="URL|SOCKET", example="--service http://127.0.0.1:8080")


def service_drive_option() -> click.Option:
    """Return ``--drive``: the name of a drive in the service's plant."""
    return Option(["--drive"], metavar="NAME", example="--drive fan-1")


def group_option() -> click.Option:
    """Return ``--group``: the name of a group in the service's plant."""
    return Option(["--group"], metavar="NAME", key="help.option.group")


def selection_options(all_key: str) -> list[click.Option]:
    """Return ``--drive``, ``--group`` and ``--all`` of a service; ``all_key``: text of the last."""
    return [
        Option(["--drive", "drives"], multiple=True, metavar="NAME", key="help.option.drives"),
        group_option(),
        Option(["--all", "everything"], is_flag=True, key=all_key),
    ]


def required(option: click.Option) -> click.Option:
    """Return an option after making it a required one."""
    option.required = True
    return option


def dry_run_option() -> click.Option:
    return Option(["--dry-run"], is_flag=True)


WHOLE_NUMBER = re.compile(r"[+-]?[0-9]+", re.ASCII)
_DECIMAL_COMMA = re.compile(r"[+-]?[0-9]+,[0-9]+", re.ASCII)
_NUMBER_WITH_UNIT = re.compile(r"[+-]?[0-9]+([.,][0-9]+)?\s*([^\W\d_]|[%°/])+")
_NEGATIVE = re.compile(r"-[0-9]+(\.[0-9]+)?", re.ASCII)
_UNITS = {"HZ": "Hz", "S": "s"}
"""Units of the values of options and arguments, by their placeholder."""


def found_expected(found: object, expected: str) -> str:
    """Return the problem of a value; an empty one is shown in quotation marks."""
    return output.text("cli.found_expected", found=found if str(found).strip() else f'"{found}"', expected=expected)


def _number_problem(found: object, expected: str, param: click.Parameter | None) -> str:
    """Return the problem of a number, and what to type where a decimal comma, a unit or a sign explains it."""
    number, unit = half_width(str(found)).strip(), _UNITS.get(getattr(param, "metavar", None) or "")
    problem, hint = found_expected(found, expected), None
    if _DECIMAL_COMMA.fullmatch(number):
        hint = output.text("cli.decimal_point", number=number.replace(",", "."))
    elif _NUMBER_WITH_UNIT.fullmatch(number):
        hint = output.text("cli.number_in" if unit else "cli.number_alone", unit=unit)
    elif unit == "Hz" and _NEGATIVE.fullmatch(number):
        hint = output.text("cli.no_negative_frequency")
    return problem if hint is None else output.join([problem, hint], "clauses")


class CheckedType(_Type):
    """A type of click with the error in the user's language; ``key`` is the text of the expected value."""

    def __init__(self, inner: _Type, key: str) -> None:
        self.inner = inner
        self.key = key
        self.name = inner.name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        try:
            return self.inner.convert(value, param, ctx)
        except click.BadParameter:
            expected, is_number = output.text(self.key), isinstance(self.inner, NumberType)
            problem = _number_problem(value, expected, param) if is_number else found_expected(value, expected)
            self.fail(problem, param, ctx)


class NumberType(_Type):
    """A number from ``low`` to ``high``; a whole number if ``low`` is an int."""

    name = "number"

    def __init__(self, low: float, high: float) -> None:
        self.low, self.high = low, high
        self.number_type = int if isinstance(low, int) else float

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        try:
            number = self._number(value)
        except (ValueError, OverflowError):
            number = None
        if number is None or not self.low <= number <= self.high:
            self.fail(_number_problem(value, self._expected(), param), param, ctx)
        return number

    def _number(self, value: Any) -> float:
        """Return the number of a text in ASCII digits: ``1_0`` is none. Raises ValueError."""
        if not isinstance(value, str):
            return self.number_type(value)
        if self.number_type is float:
            return parse_decimal(value)
        if WHOLE_NUMBER.fullmatch(value) is None:
            raise ValueError(value)
        return int(value)

    def _expected(self) -> str:
        if self.number_type is int:
            return output.text("cli.expect.whole", low=self.low, high=self.high)
        return output.text("cli.expect.number", low=f"{self.low:g}", high=f"{self.high:g}")


class ParsedType(_Type):
    """A value parsed by a function that raises ValueError; ``key`` is the text of the expected value."""

    def __init__(self, name: str, parse: Callable[[str], Any], key: str) -> None:
        self.name = name
        self.parse = parse
        self.key = key

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if not isinstance(value, str):
            return value
        try:
            return self.parse(value)
        except ValueError:
            self.fail(found_expected(value, output.text(self.key)), param, ctx)


def parse_model(text: str) -> str:
    """Return the name of a model as the profiles spell it; an unknown one as it is. Raises ValueError for no name."""
    from drivebus.profiles.load import model_name

    if not text.strip():
        raise ValueError(text)
    return model_name(text.strip())


def _parse_format(text: str) -> str:
    from drivebus.serial_settings import SerialSettings

    return SerialSettings.parse(9600, text).format


def parse_assignment(text: str) -> tuple[str, str]:
    """Parse ``NAME=VALUE``. Raises ValueError."""
    name, equals, value = (part.strip() for part in text.partition("="))
    if not (name and equals and value):
        raise ValueError(text)
    return name, value


def _parse_capture_file(text: str) -> str:
    if not text.endswith(".dbcap"):
        raise ValueError(text)
    return text


FOLDER = CheckedType(click.Path(file_okay=False, path_type=Path), "cli.expect.folder")
SEED = NumberType(0, 2**32 - 1)
PERIOD = NumberType(0.1, 86_400.0)
CAPTURE = ParsedType("capture", _parse_capture_file, "cli.expect.capture")
MODEL = ParsedType("model", parse_model, "cli.expect.model")
FORMAT = ParsedType("format", _parse_format, "cli.expect.format")
ADDRESSES = ParsedType("addresses", parse_addresses, "cli.expect.addresses")
FREQUENCY = CheckedType(NumberType(0.0, 4000.0), "cli.expect.frequency")
HOLD_TIME = NumberType(0.1, 10.0)
ASSIGNMENT = ParsedType("assignment", parse_assignment, "cli.expect.option")
