"""Status word of a register-based drive: state and direction that it reports."""

from __future__ import annotations

from dataclasses import replace

from drivebus.drives.dialects.base import UNNAMED_FAULT_CODE
from drivebus.drives.readings import ReadingPairs
from drivebus.drives.state import DerivedState, Direction, DriveState
from drivebus.profiles.words import StatusMap

STATE_BITS = (
    ("emergency_stopping", DriveState.DECELERATING),
    ("dc_braking", DriveState.BRAKING),
    ("jogging", DriveState.JOGGING),
    ("speed_search", DriveState.RESTARTING),
    ("paused", DriveState.PAUSED),
    ("running", DriveState.RUNNING),
    ("fault", DriveState.FAULT),
    ("under_voltage", DriveState.NOT_READY),
)
"""In order of precedence: motion first, because a drive that still turns in a fault is turning."""
DIRECTION_SUFFIXES = {"_forward": Direction.FORWARD, "_reverse": Direction.REVERSE}
"""Endings of the names of values that name a direction: running_forward."""


def is_valid_status(status: StatusMap, raw: int) -> bool:
    """Return whether no reserved bit is set, or the value is one that the profile lists."""
    if status.values:
        return raw & status.mask in status.values
    return not raw & status.reserved_mask


def status_state(status: StatusMap, raw: int) -> DriveState:
    """Return the state of a valid status word."""
    if status.values:
        return _split_value(status, raw)[0]
    for name, state in STATE_BITS:
        if raw & status.bits.get(name, 0):
            return state
    ready = status.bits.get("ready", 0)
    return DriveState.STOPPED if not ready or raw & ready else DriveState.NOT_READY


def status_direction(status: StatusMap, raw: int) -> Direction | None:
    """Return the direction of a valid status word, None where it names none."""
    if status.values:
        return _split_value(status, raw)[1]
    bit = status.bits.get("output_reverse") or status.bits.get("set_reverse")
    if not bit:
        return None
    return Direction.REVERSE if raw & bit else Direction.FORWARD


def _split_value(status: StatusMap, raw: int) -> tuple[DriveState, Direction | None]:
    name = status.values[raw & status.mask]
    for suffix, direction in DIRECTION_SUFFIXES.items():
        if name.endswith(suffix):
            return DriveState(name.removesuffix(suffix)), direction
    return DriveState(name), None


def state_names(status: StatusMap, fault_names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the readings that the state follows from; a word without faults needs the fault registers."""
    output = status.standstill_signal
    return ("state", *((output,) if output else ()), *(() if status.shows_fault else fault_names))


def derive_state(
    status: StatusMap, readings: ReadingPairs, fault_names: tuple[str, ...], output_step_hz: float = 0.0
) -> DerivedState | None:
    """Return the state of two status words that agree; of two different turning states the newer one counts.

    ``output_step_hz``: step of the signal output_frequency, which contradicts a word without motion when it is above.
    """
    words, states = readings.raw_pair("state"), _state_pair(status, readings, output_step_hz)
    if words is None or states is None:
        return None
    older, newer = states
    if older is not newer and not (older.turning and newer.turning):
        return None
    by_frequency = newer is not status_state(status, words[1])
    direction = status_direction(status, words[1]) if newer.turning and not by_frequency else None
    codes = _fault_codes(status, readings, fault_names)
    if not status.shows_fault:
        return _with_polled_fault(DerivedState(newer, direction, by_frequency=by_frequency), codes)
    if not status.reports_fault(words[1]):
        return DerivedState(newer, direction, by_frequency=by_frequency)
    first, *further = codes or [UNNAMED_FAULT_CODE]
    return DerivedState(newer, direction, first, further_fault_codes=tuple(further), by_frequency=by_frequency)


def _state_pair(
    status: StatusMap, readings: ReadingPairs, output_step_hz: float
) -> tuple[DriveState, DriveState] | None:
    """Return the last two states, older first: without motion only where no output contradicts that.

    The signal of the standstill must have been read as 0. Of every other drive the output frequency counts where it
    was read: a wrong list of values would otherwise confirm a stop while the motor runs.
    """
    words = readings.raw_pair("state")
    if words is None:
        return None
    older, newer = (status_state(status, word) for word in words)
    if status.standstill == "status_alone" or (older.turning and newer.turning):
        return older, newer
    required = status.standstill_signal
    if required is not None:
        output = readings.raw_pair(required)
        if output is None or not readings.is_since(required, "state"):
            return None
        older, newer = (
            _ramping_down(older, is_output_on=output[0] != 0),
            _ramping_down(newer, is_output_on=output[1] != 0),
        )
    frequencies = readings.pair("output_frequency")
    if frequencies is not None and readings.is_since("output_frequency", "state"):
        first, second = (
            isinstance(frequency.value, int | float) and abs(frequency.value) > output_step_hz
            for frequency in frequencies
        )
        older, newer = _ramping_down(older, is_output_on=first), _ramping_down(newer, is_output_on=second)
    return older, newer


def _ramping_down(state: DriveState, *, is_output_on: bool) -> DriveState:
    return DriveState.DECELERATING if is_output_on and not state.turning else state


def _with_polled_fault(derived: DerivedState, codes: list[int] | None) -> DerivedState | None:
    """Add the fault of a model whose status word shows none: unknown until its fault register was read."""
    if codes is None:
        return None
    if not codes:
        return derived
    state = derived.state if derived.state.turning else DriveState.FAULT
    return replace(derived, state=state, fault_code=codes[0], further_fault_codes=tuple(codes[1:]))


def _fault_codes(status: StatusMap, readings: ReadingPairs, names: tuple[str, ...]) -> list[int] | None:
    """Return the numbers in the fault registers, or the bits that are set, lowest first; None where not yet read."""
    words = [readings.agreed_raw(name) for name in names]
    known = [word for word in words if word is not None]
    if status.numbers_fault:
        codes = [number for word in known if (number := status.fault_number(word))]
    else:
        codes = [16 * place + bit for place, word in enumerate(words) for bit in range(16) if (word or 0) >> bit & 1]
    return codes if len(known) == len(words) or status.shows_fault else None
