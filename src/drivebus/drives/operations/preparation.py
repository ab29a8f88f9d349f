"""Words that a drive needs before a start or a reset, such as those of DRIVECOM: sent by what the status asks for.

None of them moves the motor, so none has the permit of a start; that is granted for the start word alone, and only in
the status that the profile calls ready.
"""

from __future__ import annotations

from drivebus.bus.messages import RetryPolicy
from drivebus.drives.dialects.base import CommandFrame, StopMode
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.steps import DriveOperation, get_bus_conditions, wait
from drivebus.drives.permissives import CommandKind, DriveCommand
from drivebus.errors import StartInhibited
from drivebus.profiles.model import StartStep

STEP_POLL_INTERVAL_S = 0.05  # pause between two verified states after a word


def prepare_start(op: OperationContext) -> DriveOperation[None]:
    """Send the words before a start, each once at most, and check the status after each.

    Raises StartInhibited where the status fits no word or does not follow one; Expired or Superseded as a start does.
    Nothing more is sent then.
    """
    commands = op.dialect.profile.commands
    open_steps = list(commands.preparation) if commands is not None else []
    while not op.is_prepared():
        word = op.reading_pairs.agreed_raw("state")
        step = next((one for one in open_steps if word is not None and one.when.matches(word)), None)
        if step is None:
            raise StartInhibited("drives.status_unprepared", status=_hex(word))
        open_steps.remove(step)
        yield from _take_step(op, step)


def _take_step(op: OperationContext, step: StartStep) -> DriveOperation[None]:
    """Send one word and wait for the status that it brings about. A word without reply is not sent again."""
    yield from _count_own_stops(op)
    conditions = yield from op.check_deadline()
    answer = yield from op.send_command(
        op.create_command(CommandKind.START, conditions), op.dialect.preparation_frame(step.word)
    )
    refused = op.rejected_outcome(answer)
    if refused is not None:
        raise StartInhibited("drives.preparation_rejected", word=_hex(step.word), code=refused.params["code"])
    command = op.create_command(CommandKind.START, conditions)  # after the word: it may be a stop, which is counted
    yield from _wait_for_status(op, step, command)


def _wait_for_status(op: OperationContext, step: StartStep, command: DriveCommand) -> DriveOperation[None]:
    deadline = (yield from op.check_not_superseded(command)) + step.timeout_s
    while True:
        error = yield from op.read_verified_state()
        now = yield from op.check_not_superseded(command)
        word = op.reading_pairs.agreed_raw("state")
        if error is None and word is not None and step.until.matches(word):
            return
        if now > deadline:
            raise StartInhibited(
                "drives.preparation_ignored", word=_hex(step.word), status=_hex(word), limit_s=step.timeout_s
            )
        yield from wait(STEP_POLL_INTERVAL_S)


def release_reset(op: OperationContext) -> DriveOperation[None]:
    """Send the stop word where a drive resets on the rising edge of a bit: the bit may be set since the last reset."""
    commands = op.dialect.profile.commands
    if commands is not None and commands.reset_on_edge:
        yield from _count_own_stops(op)
        command = op.create_command(CommandKind.RESET, (yield from op.check_deadline()))
        for request in op.dialect.stop(StopMode.STOP):
            yield from op.send_command(command, CommandFrame(request, RetryPolicy.IDEMPOTENT))


def _count_own_stops(op: OperationContext) -> DriveOperation[None]:
    """Note which stops came before: a stop word of this operation does not supersede it, any other stop does."""
    if op.stop_epoch is None:
        op.stop_epoch = (yield from get_bus_conditions()).stop_epoch


def _hex(word: int | None) -> str:
    return "?" if word is None else f"{word:04X}H"
