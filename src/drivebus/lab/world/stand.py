"""A test stand: one simulated line with its drives, the real bus and real drives on it, and the witness beside them."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable
from typing import Any

from drivebus.bus import Bus
from drivebus.bus.effects import Act, Done
from drivebus.drives import Drive, MemoryStore, Monitor
from drivebus.errors import DrivebusError
from drivebus.lab.campaign import Session
from drivebus.lab.kinds import Kind
from drivebus.lab.world.loop import Loop, running
from drivebus.lab.world.truth import check_memory, inspect
from drivebus.lab.world.wishes import CURRENT, Wish, bare
from drivebus.lab.world.witness import Witness
from drivebus.message import Answer, Ask, WriteClass
from drivebus.ports import open_port


class WatchedBus(Bus):
    """The real bus; the witness hears of every answer before whoever asked."""

    witness: Witness | None = None

    def _perform(self, acts: list[Act]) -> None:
        if self.witness is not None:
            for act in acts:
                if isinstance(act, Done):
                    self.witness.answered(act.answer)
        super()._perform(acts)

    async def transact(self, ask: Ask) -> Answer:
        """Whose wish a frame serves is known to the bit: nobody else asked for these bytes at this time."""
        wish = CURRENT.get()
        if self.witness is None or wish is None or ask.write_class is WriteClass.READ:
            return await super().transact(ask)
        with self.witness.asking(wish, self.core.stations[ask.station].codec.encode_request(ask.request)):
            return await super().transact(ask)


class Stand:
    """One line. ``options`` are those of ``sim://`` links: weather, echo, ramp, seed, load …"""

    def __init__(
        self, session: Session, kind: Kind, addresses: Iterable[int], *, loop: Loop | None = None,
        name: str = "", drives: bool = True, around: Callable[[Any], Any] = lambda port: port, **options: Any,
    ) -> None:  # fmt: skip
        """``around`` makes the bus's port of the simulated one: what records it, or lets its calls fail."""
        self.session, self.kind, self.name = session, kind, name or kind.name
        self.loop = loop or Loop()
        query = {"baud": kind.baud, "ramp": 2, "echo": "off", "seed": session.seed, **kind.options, **options}
        listed = ",".join(map(str, addresses))
        with running(self.loop):
            options_text = "&".join(f"{name}={value}" for name, value in query.items())
            port: Any = open_port(f"sim://{kind.model}@{listed}?{options_text}")
            self.port, self.bench = port, port.bench
            self.bus = WatchedBus(around(self.port), name=self.name)
            self.witness = self.bus.witness = Witness(session, kind, self.bench, self.name, self.loop.time)
            for station in self.bench.stations:
                station.memory.eeprom_writes.clear()  # the ramps were set at the keypad
                station.memory.ram_writes.clear()
            self.drives = {station.address: self._drive(station.address) for station in self.bench.stations if drives}
        self.monitors: dict[int, Monitor] = {}
        self.period_s = 0.0
        self.loop.run(self.bus.open())

    def _drive(self, address: int) -> Drive:
        kind = self.kind
        return Drive(
            self.bus, kind.model, address, encoding=kind.encoding, settings=dict(kind.settings), store=MemoryStore()
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

    def wish(self, address: int, what: str, *arguments: Any, **named: Any) -> Wish:
        """A user's command, given now: the method ``what`` of the drive. It goes on while time passes."""
        return self.wish_by(getattr(self.drives[address], what), address, what, *arguments, **named)

    def wish_by(
        self, method: Callable[..., Awaitable[Any]], address: int, what: str, *arguments: Any, **named: Any
    ) -> Wish:
        """The same by a function of the campaign's own, for what takes more than one call (a jog and its lease)."""
        wish = self.witness.wished(address, what, arguments)
        with running(self.loop):
            wish.task = self.loop.create_task(self._fulfil(wish, method, arguments, named))
        return wish

    async def _fulfil(self, wish: Wish, method: Callable[..., Awaitable[Any]], arguments: Any, named: Any) -> None:
        CURRENT.set(wish)
        try:
            wish.outcome = await method(*arguments, **named)
        except DrivebusError as error:
            wish.error = bare(error)
            wish.outcome = getattr(error, "outcome", None)
        except Exception as error:  # no user is ever told in another way (I8)
            self.witness.violation(f"I8 {type(error).__name__} escaped from {wish}: {error}")
        finally:
            self.witness.ended(wish)
        wish.task = None

    def run(self, seconds: float) -> None:
        """Let time pass."""
        self.loop.run_until(self.loop.time() + seconds)
        inspect(self)

    def finish(self, *wishes: Wish, within_s: float = 120.0, step_s: float = 0.25) -> None:
        """Let time pass until these wishes have ended; one that does not is a violation."""
        end = self.loop.time() + within_s
        while any(not wish.over for wish in wishes) and self.loop.time() < end:
            self.loop.run_until(min(end, self.loop.time() + step_s))
        for wish in wishes:
            if not wish.over:
                self.witness.violation(f"{wish} has no end after {within_s} s")
        inspect(self)

    def unplug(self) -> None:
        self.witness.unplugged()
        with running(self.loop):
            self.bench.unplug()

    def replug(self) -> None:
        self.witness.note("plugged in again")
        with running(self.loop):
            self.bench.replug()

    def close(self) -> None:
        """End the bus, and look once more."""
        inspect(self)
        check_memory(self)
        with running(self.loop):
            for task in list(self.loop.tasks):
                task.cancel()
        self.loop.run_until(self.loop.time())
        self.loop.run(self.bus.close())
        self.loop.run_until(self.loop.time())  # whoever still waited is told that the bus has ended
        inspect(self)
