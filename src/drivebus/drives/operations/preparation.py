"""Unlock and words before a start or a reset: those of every start, and those that the status asks for (DRIVECOM).

None of them moves the motor, so none has the permit of a start; that is granted for the start word alone, and only in
the status that the profile calls ready.
"""

from __future__ import annotations

from drivebus.bus.messages import BusResult, RetryPolicy
from drivebus.drives.dialects.base import CommandFrame, StopMode
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.steps import DriveOperation, get_bus_conditions, wait
from drivebus.drives.permissives import CommandKind, DriveCommand, unmet_bus_permissives
from drivebus.errors import StartInhibited
from drivebus.profiles.words import StartStep

STEP_POLL_INTERVAL_S = 0.05  # pause between two verified states after a word


def prepare_start(op: OperationContext) -> DriveOperation[None]:
    """Send the unlock and the words before a start, each once at most; check the status after one that it asked for.

    Raises StartInhibited where the drive rejects one, or its status fits no word or does not follow one; Expired or
    Superseded as a start does; the error of the bus for an unlock or a word that is confirmed by its reply alone.
    Nothing more is sent then.
    """
    commands = op.dialect.profile.commands
    yield from _send_unlock(op, CommandKind.START)
    for fixed in [step.word for step in commands.preparation if step.when is None] if commands is not None else []:
        yield from _send_confirmed(op, CommandKind.START, op.dialect.preparation_frame(fixed), _hex(fixed))
    op.has_sent_preparation = True
    open_steps = list(commands.status_steps) if commands is not None else []
    while not op.is_prepared():
        word = op.reading_pairs.agreed_raw("state")
        matching = [step for step in open_steps if word is not None and step.when and step.when.matches(word)]
        if not matching:
            raise StartInhibited("drives.status_unprepared", status=_hex(word))
        open_steps.remove(matching[0])
        yield from _take_step(op, matching[0])


def _send_unlock(op: OperationContext, kind: CommandKind) -> DriveOperation[None]:
    """Send the write without which the drive rejects every command, where the profile names one."""
    commands, request = op.dialect.profile.commands, op.dialect.unlock()
    if request is not None and commands is not None and commands.unlock is not None:
        shown = f"{commands.unlock.register:04X}H = {commands.unlock.value:04X}H"
        yield from _send_confirmed(op, kind, CommandFrame(request, RetryPolicy.IDEMPOTENT), shown)


def _send_confirmed(
    op: OperationContext, kind: CommandKind, frame: CommandFrame, frame_text: str
) -> DriveOperation[None]:
    """Send a frame that no status shows: the drive must have answered it."""
    yield from _count_own_stops(op)
    conditions = yield from op.check_deadline()
    for unmet in unmet_bus_permissives(op.dialect.address, conditions):
        raise unmet  # an unlock needs no permit, but goes before a start only where that may follow
    result = yield from op.send_command(op.create_command(kind, conditions), frame)
    _check_accepted(op, result, frame_text)
    if result.error is not None:
        raise result.error


def _check_accepted(op: OperationContext, result: BusResult, frame_text: str) -> None:
    """Raise StartInhibited where the drive rejected what it needs before a start."""
    refused = op.rejected_outcome(result)
    if refused is not None:
        raise StartInhibited("drives.preparation_rejected", word=frame_text, code=refused.params["code"])


def _take_step(op: OperationContext, step: StartStep) -> DriveOperation[None]:
    """Send one word and wait for the status that it brings about. A word without reply is not sent again."""
    yield from _count_own_stops(op)
    conditions = yield from op.check_deadline()
    result = yield from op.send_command(
        op.create_command(CommandKind.START, conditions), op.dialect.preparation_frame(step.word)
    )
    _check_accepted(op, result, _hex(step.word))
    command = op.create_command(CommandKind.START, conditions)  # after the word, which may count as a stop
    yield from _wait_for_status(op, step, command)


def _wait_for_status(op: OperationContext, step: StartStep, command: DriveCommand) -> DriveOperation[None]:
    deadline = (yield from op.check_not_superseded(command)) + step.timeout_s
    while True:
        error = yield from op.read_verified_state()
        now = yield from op.check_not_superseded(command)
        word = op.reading_pairs.agreed_raw("state")
        if error is None and word is not None and step.until is not None and step.until.matches(word):
            return
        if now > deadline:
            raise StartInhibited(
                "drives.preparation_ignored", word=_hex(step.word), status=_hex(word), limit_s=step.timeout_s
            )
        yield from wait(STEP_POLL_INTERVAL_S)


def release_reset(op: OperationContext) -> DriveOperation[None]:
    """Send the unlock, and the stop word where a drive resets on the rising edge of a bit that may still be set."""
    commands = op.dialect.profile.commands
    yield from _send_unlock(op, CommandKind.RESET)
    if commands is not None and commands.reset_on_edge:
        yield from _count_own_stops(op)
        command = op.create_command(CommandKind.RESET, (yield from op.check_deadline()))
        for request in op.dialect.stop(StopMode.STOP):
            yield from op.send_command(command, CommandFrame(request, RetryPolicy.IDEMPOTENT))


def _count_own_stops(op: OperationContext) -> DriveOperation[None]:
    """Keep the number of stops so far, so that a stop word of this operation does not supersede it; other stops do."""
    if op.stop_epoch is None:
        op.stop_epoch = (yield from get_bus_conditions()).stop_epoch


def _hex(word: int | None) -> str:
    return "?" if word is None else f"{word:04X}H"
