"""A test stand: one simulated line with its drives, the real bus and real drives on it, and the witness beside them."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable
from typing import Any

from drivebus.bus import Bus
from drivebus.bus.commands import CoreCommand, DeliverResult
from drivebus.bus.messages import BusRequest, BusResult, RetryPolicy
from drivebus.drives import Drive, MemoryStore, Monitor
from drivebus.errors import DrivebusError
from drivebus.ports import open_port
from drivebus.testing.virtual_time import VirtualLoop, running
from verification.campaign import CampaignRun
from verification.drive_variants import DriveVariant
from verification.scenario.invariants import check_invariants, check_memory
from verification.scenario.oracle import Oracle
from verification.scenario.user_command import CURRENT_COMMAND, UserCommand, without_traceback


class ObservedBus(Bus):
    """The real bus; the witness hears of every answer before whoever asked."""

    oracle: Oracle | None = None

    def _perform(self, acts: list[CoreCommand]) -> None:
        if self.oracle is not None:
            for act in acts:
                if isinstance(act, DeliverResult):
                    self.oracle.on_reply_accepted(act.result)
        super()._perform(acts)

    async def transact(self, ask: BusRequest) -> BusResult:
        """Whose wish a frame serves is known to the bit: nobody else asked for these bytes at this time."""
        command = CURRENT_COMMAND.get()
        if self.oracle is None or command is None or ask.retry_policy is RetryPolicy.READ:
            return await super().transact(ask)
        with self.oracle.expecting_frame(command, self.core.stations[ask.station].codec.encode_request(ask.request)):
            return await super().transact(ask)


class Scenario:
    """One line. ``options`` are those of ``sim://`` links: weather, echo, ramp, seed, load …"""

    def __init__(
        self,
        session: CampaignRun,
        kind: DriveVariant,
        addresses: Iterable[int],
        *,
        loop: VirtualLoop | None = None,
        name: str = "",
        drives: bool = True,
        around: Callable[[Any], Any] = lambda port: port,
        **options: Any,
    ) -> None:
        """``around`` makes the bus's port of the simulated one: what records it, or lets its calls fail."""
        self.session, self.kind, self.name = session, kind, name or kind.name
        self.loop = loop or VirtualLoop()
        query = {"baud": kind.baud, "ramp": 2, "echo": "off", "seed": session.seed, **kind.options, **options}
        listed = ",".join(map(str, addresses))
        with running(self.loop):
            options_text = "&".join(f"{name}={value}" for name, value in query.items())
            port: Any = open_port(f"sim://{kind.model}@{listed}?{options_text}")
            self.port, self.bench = port, port.simulated_bus
            self.bus = ObservedBus(around(self.port), name=self.name)
            self.oracle = self.bus.oracle = Oracle(session, kind, self.bench, self.name, self.loop.time)
            for station in self.bench.stations:
                station.memory.eeprom_writes.clear()  # the ramps were set at the keypad
                station.memory.ram_writes.clear()
            self.drives = {station.address: self._drive(station.address) for station in self.bench.stations if drives}
        self.monitors: dict[int, Monitor] = {}
        self.period_s = 0.0
        self.loop.run_until_complete(self.bus.open())

    def _drive(self, address: int) -> Drive:
        kind = self.kind
        return Drive(
            self.bus, kind.model, address, encoding=kind.encoding, options=dict(kind.drive_options), store=MemoryStore()
        )

    def station(self, address: int) -> Any:
        """The simulated drive, brought to this moment."""
        with running(self.loop):
            return self.bench.station(address)

    # --- what a campaign does with it ------------------------------------------------------------------------------

    def monitor(self, address: int, signals: Iterable[str] | None = None, period_s: float = 0.0) -> Monitor:
        """Poll a drive from now on, nothing more often than ``period_s``."""
        self.period_s = max(self.period_s, period_s)
        with running(self.loop):
            monitor = self.monitors[address] = self.drives[address].monitor(signals, period_s=period_s)
        return monitor

    def command(self, address: int, what: str, *arguments: Any, **named: Any) -> UserCommand:
        """A user's command, given now: the method ``what`` of the drive. It goes on while time passes."""
        return self.command_by(getattr(self.drives[address], what), address, what, *arguments, **named)

    def command_by(
        self, method: Callable[..., Awaitable[Any]], address: int, what: str, *arguments: Any, **named: Any
    ) -> UserCommand:
        """The same by a function of the campaign's own, for what takes more than one call (a jog and its lease)."""
        command = self.oracle.on_command(address, what, arguments)
        with running(self.loop):
            command.task = self.loop.create_task(self._execute(command, method, arguments, named))
        return command

    async def _execute(
        self, wish: UserCommand, method: Callable[..., Awaitable[Any]], arguments: Any, named: Any
    ) -> None:
        CURRENT_COMMAND.set(wish)
        try:
            wish.outcome = await method(*arguments, **named)
        except DrivebusError as error:
            wish.error = without_traceback(error)
            wish.outcome = getattr(error, "outcome", None)
        except Exception as error:  # no user is ever told in another way (I8)
            self.oracle.violation(f"I8 {type(error).__name__} escaped from {wish}: {error}")
        finally:
            self.oracle.on_command_ended(wish)
        wish.task = None

    def run(self, seconds: float) -> None:
        """Let time pass."""
        self.loop.run_until(self.loop.time() + seconds)
        check_invariants(self)

    def finish(self, *commands: UserCommand, within_s: float = 120.0, step_s: float = 0.25) -> None:
        """Let time pass until these wishes have ended; one that does not is a violation."""
        end = self.loop.time() + within_s
        while any(not command.is_ended for command in commands) and self.loop.time() < end:
            self.loop.run_until(min(end, self.loop.time() + step_s))
        for command in commands:
            if not command.is_ended:
                self.oracle.violation(f"{command} has no end after {within_s} s")
        check_invariants(self)

    def unplug(self) -> None:
        self.oracle.on_unplugged()
        with running(self.loop):
            self.bench.unplug()

    def replug(self) -> None:
        self.oracle.trace("plugged in again")
        with running(self.loop):
            self.bench.replug()

    def close(self) -> None:
        """End the bus, and look once more."""
        check_invariants(self)
        check_memory(self)
        with running(self.loop):
            for task in list(self.loop.tasks):
                task.cancel()
        self.loop.run_until(self.loop.time())
        self.loop.run_until_complete(self.bus.close())
        self.loop.run_until(self.loop.time())  # whoever still waited is told that the bus has ended
        check_invariants(self)
