"""Supervision of one drive's stops: the deadline of each stop and its repetition until the drive confirms it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterator
from typing import TypeVar

from drivebus.bus.messages import BusResult
from drivebus.drives.dialects.base import StopMode
from drivebus.drives.operations import stop as stop_operation
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.steps import DriveOperation
from drivebus.drives.operations.stop import StopProgress
from drivebus.drives.outcome import FrameExchange, Outcome, raise_for_status
from drivebus.drives.runner import OperationRunner
from drivebus.errors import NotPermitted

T = TypeVar("T")

STOP_REPEAT_INTERVAL_S = 1.0  # an unconfirmed stop is repeated until it is confirmed or a motion command comes
MIN_SUSPENSION_S = 0.5  # a host that notices a deadline later than this was suspended; a busy one is less late
MIN_WAIT_S = 1e-6  # a shorter wait may not show on the clock of an event loop


class JointStops(set[OperationContext]):
    """Stops under way of several drives of one bus, ordered together: read in turns, each has the time of all.

    A stop of one drive that is ordered at the same time joins none of them and has the time of one drive.
    """


class StopSupervisor:
    """Supervisor of one drive's stops, the only code of a drive that runs beside its commands.

    A stop that is not confirmed in time is reported as unconfirmed and repeated until the drive confirms it, a motion
    command takes its place, or the bus is closed for good. Cancelling the caller of a stop does not cancel the stop.
    """

    def __init__(self, runner: OperationRunner, on_repeated_stop: Callable[[Outcome], None]) -> None:
        """``on_repeated_stop`` is called with the outcome of a repeated stop that the drive has confirmed."""
        self._runner, self._on_repeated_stop = runner, on_repeated_stop
        self._running: set[asyncio.Task[Outcome]] = set()
        self._concurrent: set[OperationContext] = set()
        self._repetition: asyncio.Task[None] | None = None
        self._repeated_mode = StopMode.STOP

    @property
    def pending(self) -> bool:
        """Whether an unconfirmed stop is being repeated."""
        return self._repetition is not None and not self._repetition.done()

    @property
    def stopping(self) -> bool:
        """Whether a stop is under way or being repeated."""
        return bool(self._running) or self.pending

    @property
    def exchanges(self) -> tuple[FrameExchange, ...]:
        """Frames of the stops under way, so far, in their order; one that stops share appears once."""
        exchanges = {exchange.sent_at: exchange for op in self._concurrent for exchange in op.exchanges}
        return tuple(sorted(exchanges.values(), key=lambda exchange: exchange.sent_at or 0.0))

    async def stop(self, mode: StopMode, *, wait: bool = True, joint: JointStops | None = None) -> Outcome:
        """Stop the drive. Raises CapabilityError before sending, StopUnconfirmed after.

        ``joint``: the stops that this one joins; None: it has the time of one drive.
        """
        joint = JointStops() if joint is None else joint
        self._runner.drive.require_capability(mode.value)
        outcome, was_suspended = await self._stop_once(mode, joint, wait=wait)
        if was_suspended:  # what the drive reported is from before the suspension
            outcome, _ = await self._stop_once(mode, joint, wait=wait)
        if outcome.key == "drives.stop_answered":  # a caller with ``wait=False`` needs no more
            return outcome
        return raise_for_status(outcome, stop=True)

    def start_stop(
        self, operation: DriveOperation[Outcome], mode: StopMode, first_result: asyncio.Future[BusResult] | None = None
    ) -> asyncio.Task[Outcome]:
        """Start an operation that stops the drive; after it the stop is repeated where it is not confirmed."""
        task = asyncio.ensure_future(self._run(operation, mode, first_result))
        self._running.add(task)
        task.add_done_callback(self._on_stop_ended)
        return task

    async def _run(
        self, operation: DriveOperation[Outcome], mode: StopMode, first_result: asyncio.Future[BusResult] | None
    ) -> Outcome:
        outcome = await self._runner.run_stop(operation, first_result)
        if outcome.succeeded:
            self.cancel_repetition()
        else:
            self.start_repetition(mode)
        return outcome

    async def _stop_once(self, mode: StopMode, joint: JointStops, *, wait: bool) -> tuple[Outcome, bool]:
        """Return the outcome of a stop, and whether it is unconfirmed only because the host was suspended meanwhile.

        At the deadline the operation is cancelled, because its reads may still wait for their turn on the bus.
        """
        self.cancel_repetition()
        bus, op = self._runner.bus, self._runner.stop_context()
        progress = StopProgress(op, bus.now(), self._concurrent, joint)
        operation = stop_operation.stop(op, mode, wait_confirmed=wait, progress=progress)
        first_result = self._runner.submit_first(operation)
        if not op.stop_awaits_model:  # the first frame of each stop that waits for that read is its own
            op.first_frame = first_result
        task = self.start_stop(operation, mode, first_result)
        self._concurrent.add(op)
        joint.add(op)
        task.add_done_callback(lambda _: self._concurrent.discard(op))
        task.add_done_callback(lambda _: joint.discard(op))
        was_suspended = False
        while not task.done():
            deadline = progress.deadline  # kept: it comes nearer where a faster transaction shows a faster bus
            left_s = deadline - bus.now()
            if left_s <= MIN_WAIT_S:
                task.cancel()
                self.start_repetition(mode)
                return stop_operation.unconfirmed_outcome(op), was_suspended
            await asyncio.wait({task}, timeout=left_s)
            was_suspended = bus.now() > deadline + MIN_SUSPENSION_S
        try:
            outcome = task.result()
        except NotPermitted:  # the drive was removed from the bus
            if not op.stops_sent:
                raise
            return stop_operation.removed_outcome(op), False
        return outcome, self.pending and was_suspended

    def _on_stop_ended(self, task: asyncio.Task[Outcome]) -> None:
        """Retrieve the exception of a stop that no caller awaits: it fails where its drive is removed from the bus."""
        self._running.discard(task)
        if not task.cancelled():
            task.exception()

    def start_repetition(self, mode: StopMode) -> None:
        """Repeat a stop until the drive confirms it."""
        self.cancel_repetition()
        self._repeated_mode = mode
        self._repetition = asyncio.ensure_future(self._repeat(mode))

    async def _repeat(self, mode: StopMode) -> None:
        while not self._runner.bus.is_closed:
            outcome = await self._runner.run_stop(stop_operation.stop(self._runner.stop_context(), mode))
            if outcome.succeeded:
                asyncio.get_running_loop().call_soon(self._on_repeated_stop, outcome)  # when nothing is pending
                return
            await asyncio.sleep(STOP_REPEAT_INTERVAL_S)

    def cancel_repetition(self) -> StopMode | None:
        """Cancel the repetition of a stop and return its mode; None where no stop was being repeated."""
        mode = self._repeated_mode if self.pending else None
        task, self._repetition = self._repetition, None
        if task is not None:
            task.cancel()
        return mode

    async def run_motion(self, operation: DriveOperation[T]) -> T:
        """Run a motion command in place of the repetition of a stop, which resumes where the command fails.

        Raises as ``raise_for_status`` where its result is an outcome.
        """
        mode = self.cancel_repetition()
        try:
            result = await self._runner.run_command(operation)
            if isinstance(result, Outcome):
                raise_for_status(result)
            return result
        except BaseException:
            if mode is not None and self._repetition is None:
                self.start_repetition(mode)
            raise

    @contextlib.contextmanager
    def stop_on_failure(self, op: OperationContext) -> Iterator[None]:
        """Stop the drive until that is confirmed where the block fails and its motion may have begun."""
        try:
            yield
        except BaseException:
            if op.may_be_running and self._repetition is None:
                self.start_repetition(StopMode.STOP)
            raise
