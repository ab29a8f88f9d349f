"""Calibration of a DZB100: the coding of the frequencies that it reports, and of those that it accepts."""

from __future__ import annotations

from typing import cast

from drivebus.drives.dialects.dzb100 import (
    Dzb100Dialect,
    decode_or_none,
    highest_safe_word,
    possible_codings,
)
from drivebus.drives.dialects.setpoint_step import UNCALIBRATED_CAP_HZ
from drivebus.drives.operations.calibration import CalibrationResult, CalibrationStep, PlannedRequests
from drivebus.drives.operations.calibration_run import CALIBRATION_RUN_S, run_at_word
from drivebus.drives.operations.context import EXTRA_VERIFICATION_ROUNDS, VERIFICATION_ROUNDS, OperationContext
from drivebus.drives.operations.steps import DriveOperation
from drivebus.drives.state import Direction
from drivebus.errors import StartInhibited, TargetNotReached
from drivebus.protocols.dzb100 import FREQUENCY_CODINGS

DEFAULT_KEYPAD_HZ = 12.3  # differs in all four codings: 007B, 04CE, 0123, 000C


def calibrate_query_coding(
    op: OperationContext, keypad_hz: float = DEFAULT_KEYPAD_HZ
) -> DriveOperation[CalibrationResult]:
    """Determine the query coding from Q00 while the keypad is set to ``keypad_hz``. Nothing moves.

    Raises TargetNotReached where no coding fits, and the error of a read.
    """
    dialect = cast("Dzb100Dialect", op.dialect)
    word = yield from _read_agreed_word(op, dialect, 0)
    step = {coding: abs(_decode_hz(word, coding) - keypad_hz) for coding in FREQUENCY_CODINGS}
    fits = tuple(coding for coding in FREQUENCY_CODINGS if step[coding] <= _half_resolution_hz(coding))
    if not fits:
        raise TargetNotReached("drives.coding_no_match", word=f"{word:04X}H", keypad_hz=keypad_hz)
    return _scaling_result("query_coding", (word,), fits)


def calibrate_setpoint_coding(
    op: OperationContext, direction: Direction | None = None
) -> DriveOperation[CalibrationResult]:
    """Run at 5 Hz or less, read Q00 and Q01 back and exclude codings until one is left. Always stops.

    Raises StartInhibited without the query coding, and every error of ``run``.
    """
    dialect = cast("Dzb100Dialect", op.dialect)
    if not dialect.can_confirm_speed():
        raise StartInhibited("drives.query_coding_first")
    left = possible_codings(dialect.options)
    words: list[int] = []
    while len(left) > 1:
        word = highest_safe_word(left)
        seen_hz = yield from run_at_word(op, word, direction, lambda: _read_agreeing_hz(op, dialect))
        words.append(word)
        fits = tuple(
            coding for coding in left if abs(_decode_hz(word, coding) - seen_hz) <= _query_resolution_hz(dialect)
        )
        if not fits:
            raise TargetNotReached("drives.setpoint_coding_no_match", word=f"{word:04X}H", found_hz=seen_hz)
        if fits == left:
            break
        left = fits
    return _scaling_result("setpoint_coding", tuple(words), left)


def _read_agreeing_hz(op: OperationContext, dialect: Dzb100Dialect) -> DriveOperation[float | None]:
    """Read Q00 and Q01, each verified; None where they do not agree."""
    command = yield from _read_agreed_word(op, dialect, 0)
    output = yield from _read_agreed_word(op, dialect, 1)
    coding = str(dialect.options["query_coding"])
    first, second = _decode_hz(command, coding), _decode_hz(output, coding)
    return second if abs(first - second) <= 2 * _query_resolution_hz(dialect) else None


def _read_agreed_word(op: OperationContext, dialect: Dzb100Dialect, item: int) -> DriveOperation[int]:
    """Read the raw word of Q00 or Q01, verified. Raises the error of the bus or TargetNotReached."""
    requests = (dialect.query(item),)
    name = ("set_frequency", "output_frequency")[item]
    op.reading_pairs.clear(name)
    for _ in range(VERIFICATION_ROUNDS + EXTRA_VERIFICATION_ROUNDS):
        error = yield from op.verified_reads(requests)
        if error is not None:
            raise error
        word = op.reading_pairs.agreed_raw(name)
        if word is not None:
            return word
    raise TargetNotReached("drives.no_agreement", item=f"Q{item:02d}")


def _decode_hz(word: int, coding: str) -> float:
    """Return a word in Hz, infinity where the coding can't decode it."""
    value = decode_or_none(word, coding)
    return float("inf") if value is None else value


def _half_resolution_hz(coding: str) -> float:
    """Return half the step of a coding in Hz: under hex-1, 12.3 Hz shows as 12 Hz."""
    return {"hex-1": 0.5, "hex-0.01": 0.005}.get(coding, 0.05)


def _query_resolution_hz(dialect: Dzb100Dialect) -> float:
    """Return the step of the query coding in Hz."""
    return 2 * _half_resolution_hz(str(dialect.options["query_coding"]))


def _scaling_result(option: str, words: tuple[int, ...], codings: tuple[str, ...]) -> CalibrationResult:
    options = {option: codings[0]} if len(codings) == 1 else {}
    return CalibrationResult(options=options, candidates=codings, words=words)


def _plan_query(dialect: Dzb100Dialect) -> PlannedRequests:
    return (("state", (dialect.query(0), dialect.query(1))),)


def _plan_setpoint(dialect: Dzb100Dialect) -> PlannedRequests:
    frames = dialect.start(None, highest_safe_word(possible_codings(dialect.options)))
    return (*_plan_query(dialect), ("start", tuple(frame.request for frame in frames)))


STEPS = (
    CalibrationStep(
        name="query_coding",
        option="query_coding",
        undetermined="unknown",
        moves=False,
        operation=calibrate_query_coding,
        plan=_plan_query,
        question="calibrate.ask_query",
        question_params={"keypad_hz": DEFAULT_KEYPAD_HZ},
    ),
    CalibrationStep(
        name="setpoint_coding",
        option="setpoint_coding",
        undetermined="unknown",
        moves=True,
        operation=calibrate_setpoint_coding,
        plan=_plan_setpoint,
        question="calibrate.ask_setpoint",
        question_params={"cap_hz": UNCALIBRATED_CAP_HZ, "seconds": CALIBRATION_RUN_S},
    ),
)
