"""Scenario: a simulated bus with its drives, the real bus and drive objects, and the oracle."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable
from typing import Any, NamedTuple

from drivebus.bus import Bus
from drivebus.bus.commands import CoreCommand, DeliverResult
from drivebus.bus.messages import BusRequest, BusResult
from drivebus.drives import Drive, MemoryStore, Monitor
from drivebus.errors import DrivebusError
from drivebus.ports import open_port
from drivebus.protocols.codec import Effect
from drivebus.testing.virtual_time import VirtualLoop, running
from verification.campaign import CampaignRun
from verification.drive_variants import DriveVariant
from verification.reference.effects import RequestEffect
from verification.reference.request_effects import classify_request
from verification.scenario.oracle import Oracle, check_invariants, check_memory
from verification.scenario.user_command import CURRENT_COMMAND, UserCommand, without_traceback


class SentRequest(NamedTuple):
    """Request of the master on the wire."""

    start: float
    end: float
    address: int
    effect: RequestEffect
    data: bytes


class ObservedBus(Bus):
    """The real bus; the oracle gets every result before the caller."""

    oracle: Oracle | None = None

    def _perform(self, commands: list[CoreCommand]) -> None:
        if self.oracle is not None:
            for command in commands:
                if isinstance(command, DeliverResult):
                    self.oracle.on_reply_accepted(command.result)
        super()._perform(commands)

    async def transact(self, bus_request: BusRequest) -> BusResult:
        """Transact and let the oracle assign these bytes to the current user command."""
        command = CURRENT_COMMAND.get()
        if self.oracle is None or command is None:
            return await super().transact(bus_request)
        config = self.core.stations[bus_request.station].config
        frame = config.codec.encode_request(bus_request.request)
        if config.effect_of(frame) is Effect.NONE:
            return await super().transact(bus_request)
        with self.oracle.expecting_frame(command, frame):
            return await super().transact(bus_request)


class Scenario:
    """Bus in virtual time. ``options`` are those of ``sim://`` URLs: line quality, echo, ramp, seed, load …"""

    def __init__(
        self,
        campaign_run: CampaignRun,
        variant: DriveVariant,
        addresses: Iterable[int],
        *,
        loop: VirtualLoop | None = None,
        name: str = "",
        drives: bool = True,
        wrap_port: Callable[[Any], Any] = lambda port: port,
        **options: Any,
    ) -> None:
        """Build the scenario; ``wrap_port`` wraps the simulated port, to record it or to let its calls fail."""
        self.campaign_run, self.variant, self.name = campaign_run, variant, name or variant.name
        self.loop = loop or VirtualLoop()
        query = {
            "baud": variant.baud,
            "ramp": 2,
            "echo": "off",
            "seed": campaign_run.seed,
            **variant.options,
            **options,
        }
        listed = ",".join(map(str, addresses))
        with running(self.loop):
            options_text = "&".join(f"{name}={value}" for name, value in query.items())
            port: Any = open_port(f"sim://{variant.model}@{listed}?{options_text}")
            self.port, self.simulated_bus = port, port.simulated_bus
            self.bus = ObservedBus(wrap_port(self.port), name=self.name)
            self.oracle = self.bus.oracle = Oracle(campaign_run, variant, self.simulated_bus, self.name, self.loop.time)
            for station in self.simulated_bus.stations:
                station.memory.eeprom_writes.clear()  # the ramps were set at the keypad
                station.memory.ram_writes.clear()
            self.drives = {
                station.address: self._drive(station.address) for station in self.simulated_bus.stations if drives
            }
        self.monitors: dict[int, Monitor] = {}
        self.period_s = 0.0
        self.loop.run_until_complete(self.bus.open())

    def _drive(self, address: int) -> Drive:
        variant = self.variant
        return Drive(
            self.bus,
            variant.model,
            address,
            encoding=variant.encoding,
            options=dict(variant.drive_options),
            store=MemoryStore(),
        )

    def add_absent(self, address: int) -> int:
        """Register a drive that does not exist."""
        self.drives[address] = self._drive(address)
        return address

    def observe_wire(self, observe: Callable[[Any, SentRequest | None], None]) -> None:
        """Call ``observe`` with each transmission from now on, and with its request where the master sent it."""
        wire: Any = self.simulated_bus.wire
        transmit = wire.transmit

        def on_transmit(source: Any, data: bytes, *more: Any, **named: Any) -> Any:
            transmission = transmit(source, data, *more, **named)
            request = None
            if hasattr(source, "receive"):
                address, effect = classify_request(self.variant.model, self.variant.encoding, data)
                request = SentRequest(transmission.start, transmission.end, address, effect, data)
            observe(transmission, request)
            return transmission

        wire.transmit = on_transmit

    def station(self, address: int) -> Any:
        """Return the simulated drive at the current time."""
        with running(self.loop):
            return self.simulated_bus.station(address)

    # --- commands and time -----------------------------------------------------------------------------------------

    def monitor(self, address: int, signals: Iterable[str] | None = None, period_s: float = 0.0) -> Monitor:
        """Poll a drive from now on, each signal at most every ``period_s``."""
        self.period_s = max(self.period_s, period_s)
        with running(self.loop):
            monitor = self.monitors[address] = self.drives[address].monitor(signals, period_s=period_s)
        return monitor

    def command(self, address: int, what: str, *arguments: Any, **keywords: Any) -> UserCommand:
        """Start a user command now: the method ``what`` of the drive. It continues while time passes."""
        return self.command_by(getattr(self.drives[address], what), address, what, *arguments, **keywords)

    def command_by(
        self, method: Callable[..., Awaitable[Any]], address: int, what: str, *arguments: Any, **keywords: Any
    ) -> UserCommand:
        """Start a user command that is a function of the campaign, for more than one call (a jog and its lease)."""
        shown = (*arguments, *(f"{name}={value}" for name, value in keywords.items()))
        command = self.oracle.on_command(address, what, shown)
        with running(self.loop):
            command.task = self.loop.create_task(self._execute(command, method, arguments, keywords))
        return command

    async def _execute(
        self, command: UserCommand, method: Callable[..., Awaitable[Any]], arguments: Any, keywords: Any
    ) -> None:
        CURRENT_COMMAND.set(command)
        try:
            command.outcome = await method(*arguments, **keywords)
        except DrivebusError as error:
            command.error = without_traceback(error)
            command.outcome = getattr(error, "outcome", None)
        except Exception as error:  # a user only gets errors of drivebus (I8)
            self.oracle.violation(f"I8 {type(error).__name__} escaped from {command}: {error}")
        finally:
            self.oracle.on_command_ended(command)
        command.task = None

    def run(self, seconds: float) -> None:
        """Let time pass and check the invariants."""
        self.loop.run_until(self.loop.time() + seconds)
        check_invariants(self)

    def finish(self, *commands: UserCommand, within_s: float = 120.0, step_s: float = 0.25) -> None:
        """Let time pass until these commands have ended; a command that does not end is a violation."""
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
            self.simulated_bus.unplug()

    def replug(self) -> None:
        self.oracle.trace("plugged in again")
        with running(self.loop):
            self.simulated_bus.replug()

    def close(self) -> None:
        """Check the invariants and close the bus."""
        check_invariants(self)
        check_memory(self)
        self._cancel_tasks()
        self.loop.run_until_complete(self.bus.close())
        self.loop.run_until(self.loop.time())  # pending calls end with an error
        self._cancel_tasks()  # a motion command that was cancelled has begun to repeat its stop
        check_invariants(self)

    def _cancel_tasks(self) -> None:
        """Cancel the tasks of the loop and let them end."""
        with running(self.loop):
            for task in list(self.loop.tasks):
                task.cancel()
        self.loop.run_until(self.loop.time())
