"""Check of a parameter write before anything is sent: parameter, value, raw word, and whether it needs confirmation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isclose

from drivebus.drives.dialects.base import Dialect
from drivebus.errors import CapabilityError, ConfirmationRequired, LimitError
from drivebus.profiles.model import DriveProfile, Parameter, Signal
from drivebus.profiles.notation import parse_number, require_entries
from drivebus.protocols.codec import Effect
from drivebus.user_input import parse_hex_word

SERIAL_ROLES = frozenset({"baud", "format", "protocol"})
"""Roles of the parameters that decide with which serial settings a drive answers."""
_SECONDS_PER_UNIT = {"ms": 0.001, "s": 1.0}
"""Units that a reply delay is given in."""
_ROUNDING_S = 1e-9  # of binary fractions: 9 × 0.001 is more than 0.009


@dataclass(frozen=True, slots=True)
class CheckedWrite:
    """Write of a parameter, checked before anything is sent."""

    parameter: Parameter
    value: float | str
    """In the unit of the parameter; the word in hexadecimal where the user gave it so."""
    raw: int


def check_writes(dialect: Dialect, values: Mapping[str, float | str]) -> list[CheckedWrite]:
    """Return checked writes of numbers or raw words (``0010H``) to the parameters of these names.

    Raises ProfileError, which explains each unknown name, and for the first parameter that can't be written, or not
    with its value, CapabilityError or LimitError.
    """
    entries = require_entries(dialect.profile, values)
    return [_check_write(dialect, entries[name], value) for name, value in values.items()]


def _check_write(dialect: Dialect, parameter: Signal | Parameter, value: float | str) -> CheckedWrite:
    model = dialect.profile.model
    _check_no_command(dialect.profile, parameter)
    if isinstance(parameter, Signal):
        raise CapabilityError("drives.signal_not_written", model=model, notation=parameter.notation)
    if not parameter.writable or not parameter.listed:
        key = "drives.not_described" if parameter.writable else "drives.register_not_listed"
        key = "drives.not_writable" if parameter.listed else key
        raise CapabilityError(key, model=model, notation=parameter.notation)
    word = parse_hex_word(value) if isinstance(value, str) else None
    if word is not None:
        number = number_of(dialect, parameter, word)
    else:
        number = parse_number(parameter, value) if isinstance(value, str) else value
    low, high = parameter.minimum, parameter.maximum
    shown = value if number is None else display_value(parameter, value, number)
    if number is not None and ((low is not None and number < low) or (high is not None and number > high)):
        bounds = {
            name: bound if bound is None else display_value(parameter, bound, bound)
            for name, bound in (("minimum", low), ("maximum", high))
        }
        raise LimitError("drives.parameter_range", notation=parameter.notation, value=shown, **bounds)
    try:
        raw = dialect.parameter_word(parameter, number) if word is None and number is not None else word
    except ValueError:
        raw = None
    if raw is None or number is None:
        raise LimitError("drives.parameter_word", notation=parameter.notation, value=shown)
    nearest = number_of(dialect, parameter, raw)
    rounding = 10.0 ** -(parameter.scale.decimals + 3)  # of binary fractions: a thousandth of the last digit shown
    if word is None and nearest is not None:
        nearest_shown = display_value(parameter, nearest, nearest)
        if not isclose(nearest, number, abs_tol=rounding):
            raise LimitError("drives.parameter_step", notation=parameter.notation, value=shown, nearest=nearest_shown)
        shown = nearest_shown
    if parameter.choices_complete and not _is_described(parameter, raw):
        known = tuple(str(choice) for choice in parameter.choices)
        raise LimitError("drives.parameter_choice", notation=parameter.notation, value=shown, choices=known)
    return _check_address(dialect.profile, CheckedWrite(parameter, shown, raw))


def _is_described(parameter: Parameter, raw: int) -> bool:
    """Return whether the profile describes a word: as one of its choices, or within its range."""
    return not parameter.choices or raw in parameter.choices or parameter.maximum is not None


def undescribed_note(write: CheckedWrite) -> str | None:
    """Return the message key of a caution where the manual does not describe a value that it does not exclude."""
    factory = write.parameter.factory
    is_factory = factory is not None and write.value == factory
    return None if is_factory or _is_described(write.parameter, write.raw) else "drives.parameter_undescribed"


def number_of(dialect: Dialect, parameter: Parameter, raw: int) -> float | None:
    """Return the number of a raw word; None where the coding of the parameter has none for it."""
    value = dialect.parameter_reading(parameter, raw, None).value
    return None if value is None else float(value)


def display_value(parameter: Parameter, value: float | str, number: float) -> float | str:
    """Return a value as the drive's own display shows it: whole numbers, or the digits of a digit code."""
    if isinstance(value, str) and parse_hex_word(value) is not None:
        return value
    if parameter.scale.decimals or not float(number).is_integer():
        return number
    return f"{int(number):04d}" if parameter.scale.coding == "bcd" and number >= 0 else int(number)


def confirmation_needed(dialect: Dialect, write: CheckedWrite) -> ConfirmationRequired | None:
    """Return why the user must confirm a write.

    It may move the motor, the drive may not be reached after it, or the bus no longer controls the drive.
    """
    params = {"notation": write.parameter.notation, "value": write.value}
    if not may_become_unreachable(dialect, write):
        if may_move(dialect, write):
            return ConfirmationRequired("drives.confirm_inputs", **params)
        needed = _bus_control_values(dialect, write)
        return ConfirmationRequired("drives.confirm_source", **params, needed=needed) if needed is not None else None
    role = _role(dialect.profile, write.parameter)
    if role == "address":
        return ConfirmationRequired("drives.confirm_address", **params, address=write.raw, present=dialect.address)
    if role == "reply_delay":
        expected_ms = dialect.profile.timing.reply_delay_s * 1000
        return ConfirmationRequired("drives.confirm_reply_delay", **params, expected_ms=round(expected_ms, 1))
    return ConfirmationRequired("drives.confirm_serial", **params)


def may_become_unreachable(dialect: Dialect, write: CheckedWrite) -> bool:
    """Return whether the drive may reply elsewhere, with other serial settings or too late after a write."""
    role = _role(dialect.profile, write.parameter)
    if role == "reply_delay":
        delay = number_of(dialect, write.parameter, write.raw)
        seconds = _SECONDS_PER_UNIT.get(write.parameter.unit)
        return delay is None or seconds is None or delay * seconds > dialect.profile.timing.reply_delay_s + _ROUNDING_S
    return role in SERIAL_ROLES or (role == "address" and write.raw != dialect.address)


def _bus_control_values(dialect: Dialect, write: CheckedWrite) -> str | None:
    """Return the values with which the bus controls the drive; None unless this write sets such a parameter to another.

    Such a parameter is a precondition of the profile.
    """
    parameter = write.parameter
    for precondition in dialect.profile.preconditions:
        if precondition.notation == parameter.notation and write.raw not in precondition.accepted:
            numbers = [number_of(dialect, parameter, raw) for raw in precondition.accepted]
            return " / ".join(str(display_value(parameter, number, number)) for number in numbers if number is not None)
    return None


def may_move(dialect: Dialect, write: CheckedWrite) -> bool:
    """Return whether a write may start the motor, as one to an input terminal that is wired to "run"."""
    frame = dialect.codec.encode_request(dialect.write_parameter(write.parameter, write.raw, save=False).request)
    return dialect.station_config.effect_of(frame) is Effect.MOTION


def _role(profile: DriveProfile, parameter: Parameter) -> str | None:
    return next((role for role, notation in profile.roles.items() if notation == parameter.notation), None)


def _check_no_command(profile: DriveProfile, entry: Parameter | Signal) -> None:
    """Raise CapabilityError for the command word and the set frequency: only the commands of drivebus write them."""
    for key, locators in (
        ("drives.register_is_command", profile.command_locators()),
        ("drives.register_is_setpoint", profile.setpoint_locators()),
    ):
        if entry.locator in locators:
            raise CapabilityError(key, model=profile.model, notation=entry.notation)


def _check_address(profile: DriveProfile, write: CheckedWrite) -> CheckedWrite:
    """Return a write unless it gives the drive an address at which no master reaches it. Raises LimitError."""
    low, high = profile.addresses
    if _role(profile, write.parameter) == "address" and not low <= write.raw <= high:
        params = {"notation": write.parameter.notation, "value": write.value, "expected": f"{low}-{high}"}
        if write.raw == profile.broadcast:
            raise LimitError("drives.write_broadcast", **params)
        if write.raw == 0:
            raise LimitError("drives.write_address_zero", model=profile.model, **params)
        raise LimitError("drives.write_address", **params)
    return write
