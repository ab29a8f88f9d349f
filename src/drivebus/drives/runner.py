"""Run the operations of a drive on its bus.

An operation is a generator. Its code reads as if it blocked, but it knows no clock, no port and no event loop: it
yields a step and receives the result when the step has been performed.

    def read_twice(op: OperationContext, request: Any) -> DriveOperation[BusResult]:
        result = yield from op.read(request)                 # one request on the bus and its reply
        if result.error is not None:
            yield from wait(0.05)                            # nothing is sent for 50 ms
            result = yield from op.read(request)
        conditions = yield from get_bus_conditions()         # the time, and whether a stop was sent meanwhile
        ...

``yield from`` calls one operation from another, as ``await`` calls a coroutine. ``run_operation`` performs the steps:

    step                    performed by                  result
    BusRequest              Bus.transact                  BusResult
    Wait(seconds)           asyncio.sleep                 the time after it
    GetBusConditions        bus_conditions                BusConditions
    UpdateStore(key, f)     Store.update in a thread      None

While an operation waits for a step, the event loop runs the operations of other drives. An exception of a step is
raised at the ``yield``, because only the operation knows whether something was sent before. Tests run the same
generators without an event loop, see ``steps.run_pure``.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from drivebus import clock
from drivebus.bus import Bus
from drivebus.bus.messages import BusRequest, BusResult
from drivebus.bus.station import Presence
from drivebus.drives.context import DriveContext
from drivebus.drives.operations.command_age import CHECKS_TIMEOUT_S
from drivebus.drives.operations.context import OperationContext
from drivebus.drives.operations.steps import BusConditions, DriveOperation, GetBusConditions, Step, UpdateStore, Wait
from drivebus.drives.shared_transactions import SharedTransactions
from drivebus.drives.store import Store
from drivebus.errors import DrivebusError, Expired, NotPermitted

T = TypeVar("T")


class OperationRunner:
    """Runner of one drive's operations: commands one after the other, reads and stops at any time."""

    def __init__(self, bus: Bus, drive: DriveContext, store: Store, load_stored: Callable[[], None]) -> None:
        """``load_stored`` is called before every operation: what is stored can be found once the port is open."""
        self.bus, self.drive = bus, drive
        self._address = drive.dialect.address
        self._store, self._load_stored = store, load_stored
        self._command_lock = asyncio.Lock()
        self._command_count = 0
        self._shared = SharedTransactions(bus, drive.dialect)

    @contextmanager
    def command(self, requested_at: float | None = None) -> Iterator[OperationContext]:
        """Provide the context of a command requested now; every later stop of the drive supersedes it.

        ``requested_at`` counts at most as now: a time by another clock might never expire. An error that leaves the
        block states whether the motor may be running by the command.
        """
        self._command_count += 1
        now = self.bus.now()
        requested_at = None if requested_at is None else min(now, requested_at)
        op = OperationContext(
            self.drive,
            stop_epoch=self.bus.stop_epoch(self._address),
            checks_started_at=now if requested_at is None else requested_at,
            requested_at=requested_at,
        )
        try:
            yield op
        except DrivebusError as error:
            error.may_be_running = op.may_be_running
            raise

    async def run(self, operation: DriveOperation[T]) -> T:
        """Run an operation, also beside another one."""
        self._load_stored()
        return await run_operation(operation, self.bus, self._address, self._store)

    def stop_context(self) -> OperationContext:
        """Return the context of an operation for ``run_stop``."""
        return OperationContext(self.drive, sync_request=self._shared.sync_request)

    async def run_stop(self, operation: DriveOperation[T], first_result: asyncio.Future[BusResult] | None = None) -> T:
        """Run an operation that stops the drive and shares frames with its other stops, see ``SharedTransactions``.

        ``first_result``: the return value of ``submit_first``.
        """
        self._load_stored()
        transact = self._shared.transact
        return await run_operation(
            operation, self.bus, self._address, self._store, first_result=first_result, transact=transact
        )

    def submit_first(self, operation: DriveOperation[Any]) -> asyncio.Future[BusResult]:
        """Submit the first request of an operation now: one turn of the event loop later a poll might go first."""
        self._load_stored()
        step = next(operation)
        while isinstance(step, GetBusConditions):
            step = operation.send(bus_conditions(self.bus, self._address))
        assert isinstance(step, BusRequest)
        return self._shared.submit_first(step, self._command_count)

    async def run_command(self, operation: DriveOperation[T]) -> T:
        """Run a command after the commands before it. Raises Expired where it waited more than 5 s for them."""
        queued_at = self.bus.now()
        async with self._command_lock:
            waited_s = self.bus.now() - queued_at
            if waited_s > CHECKS_TIMEOUT_S:
                operation.close()
                raise Expired("drives.queue_timeout", age_s=round(waited_s, 2), limit_s=CHECKS_TIMEOUT_S)
            return await self.run(operation)


async def run_operation(
    operation: DriveOperation[T],
    bus: Bus,
    address: int,
    store: Store,
    *,
    first_result: asyncio.Future[BusResult] | None = None,
    transact: Callable[[BusRequest], Awaitable[BusResult]] | None = None,
) -> T:
    """Perform the steps of an operation and return its result.

    ``transact`` performs its transactions, None: ``Bus.transact``. After it is cancelled nothing more is sent, except
    the frame of ``first_result`` and one that ``transact`` shares.
    """
    transact = transact or bus.transact
    try:
        step = next(operation) if first_result is None else operation.send(await asyncio.shield(first_result))
        while True:
            try:
                result = await _perform(step, bus, address, store, transact)
            except Exception as error:
                step = operation.throw(error)
            else:
                step = operation.send(result)
    except StopIteration as end:
        value: T = end.value
        return value
    finally:
        operation.close()


async def _perform(
    step: Step, bus: Bus, address: int, store: Store, transact: Callable[[BusRequest], Awaitable[BusResult]]
) -> Any:
    if isinstance(step, BusRequest):
        return await transact(step)
    if isinstance(step, Wait):
        await asyncio.sleep(step.seconds)
        return bus.now()
    if isinstance(step, GetBusConditions):
        return bus_conditions(bus, address)
    assert isinstance(step, UpdateStore)
    return await asyncio.to_thread(store.update, step.key, step.change)


def bus_conditions(bus: Bus, address: int) -> BusConditions:
    """Return what the bus knows of a station now. Raises NotPermitted for one that was removed from the bus."""
    try:
        health = bus.health(address)
    except KeyError:
        raise NotPermitted("bus.unregistered", station=address) from None
    return BusConditions(
        now=bus.now(),
        day=clock.wall_clock().date().isoformat(),
        stop_epoch=bus.stop_epoch(address),
        start_inhibited=bus.start_inhibited(address),
        foreign_master=health.foreign_master,
        duplicate_address=health.duplicate_address,
        damage_rate=health.damage_rate,
        reads_wait_until=health.reads_wait_until,
        damaged=health.damaged,
        contact_losses=bus.contact_losses(address),
        answers=health.presence is Presence.ONLINE and not health.suspect,
    )
