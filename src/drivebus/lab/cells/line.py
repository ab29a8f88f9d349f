"""A stand on which single frames can be lost, changed or held back, strangers speak, and everything is on record."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import inf
from typing import Any, NamedTuple

from drivebus.bus import StationStatistics, TraceEvent
from drivebus.lab.campaign import Session
from drivebus.lab.cells.alphabet import is_fence
from drivebus.lab.kinds import Kind
from drivebus.lab.manual import Does, request
from drivebus.lab.world.loop import running
from drivebus.lab.world.stand import Stand, WatchedBus
from drivebus.lab.world.wishes import Wish
from drivebus.message import Answer, Ask
from drivebus.reading import Quality
from drivebus.sim.wire import Side

Say = Callable[..., Any]
"""``say(data, at, talker=…)``: a drive says these bytes from that second on."""
Act = Callable[[Say, bytes, float], Any]
"""What a drive says instead of ``data`` at ``at``."""


class Sent(NamedTuple):
    """A frame of ours on the copper."""

    start: float
    end: float
    address: int
    does: Does
    data: bytes


class Said(NamedTuple):
    """What a drive answered, to which request."""

    address: int
    request: bytes
    data: bytes
    start: float


@dataclass(slots=True)
class Trick:
    """``act`` takes the place of the next ``times`` answers; "deaf": the drive hears nothing, "mute": says nothing."""

    address: int
    wanted: Callable[[bytes], bool]
    act: Act | str
    times: float


class Stranger:
    """Somebody else on the wire; no host of ours."""

    address = "stranger"


class Line(Stand):
    """Drives that have been spoken to once, so that they are known to be there."""

    def __init__(
        self, session: Session, kind: Kind, name: str, addresses: Iterable[int], seed: int, options: dict[str, Any]
    ) -> None:
        super().__init__(session, kind, addresses, name=name, seed=seed, **options)
        self.sent: list[Sent] = []
        self.said: list[Said] = []
        self.events: list[TraceEvent] = []
        self.when_sent: Callable[[Sent], None] = lambda sent: None
        self.cuts = False
        """Our adapter's driver goes off before the last byte is out (F09)."""
        self._tricks: list[Trick] = []
        self._request = b""
        self._open = True
        self._meddle()
        self.bus.trace(self.events.append)
        for address in self.drives:
            self.read(address)

    # --- on the copper ---------------------------------------------------------------------------------------------

    def _meddle(self) -> None:
        bench: Any = self.bench
        say, reply, dispatch = bench.wire.say, bench.wire.reply, bench._dispatch

        def on_say(talker: Any, data: bytes, *more: Any, **named: Any) -> Any:
            said = say(talker, data, *more, **named)
            if hasattr(talker, "hear"):
                if self.cuts:
                    said.dropped.add(len(data) - 1)
                sent = Sent(said.start, said.end, *request(self.kind.model, self.kind.encoding, data), data)
                self.sent.append(sent)
                self.when_sent(sent)
            return said

        def on_reply(talker: Any, data: bytes, now: float, at: float) -> Any:
            trick = self._trick(talker.address, lambda act: not isinstance(act, str))

            def drive_says(data: bytes, at: float, talker: Any = talker) -> Any:
                said = reply(talker, data, now, at)
                self.said.append(Said(talker.address, self._request, data, said.start))
                return said

            if trick is None or isinstance(trick.act, str):
                return drive_says(data, at)
            return trick.act(drive_says, data, at)

        def on_dispatch(frame: Any, stations: Any, said: Any, now: float) -> None:
            self._request = frame.frame
            trick = self._trick(frame.address, lambda act: isinstance(act, str))
            hit = [one.faults for one in stations if trick is not None and one.address == frame.address]
            what = "silent" if trick is not None and trick.act == "deaf" else "mute"
            before = [getattr(faults, what) for faults in hit]
            for faults in hit:
                setattr(faults, what, True)
            dispatch(frame, stations, said, now)
            for faults, was in zip(hit, before, strict=True):
                setattr(faults, what, was)

        bench.wire.say, bench.wire.reply, bench._dispatch = on_say, on_reply, on_dispatch

    def _trick(self, address: int | None, kind: Callable[[Act | str], bool]) -> Trick | None:
        for trick in self._tricks:
            if trick.address == address and trick.times > 0 and kind(trick.act) and trick.wanted(self._request):
                trick.times -= 1
                return trick
        return None

    def trick(self, address: int, act: Act | str, times: float = inf, does: Does | None = None) -> Trick:
        """From now on, for requests that do this (None: for all); ``times`` 0 ends it."""

        def wanted(data: bytes) -> bool:
            return does is None or request(self.kind.model, self.kind.encoding, data)[1] is does

        self._tricks.append(Trick(address, wanted, act, times))
        return self._tricks[-1]

    def stranger(self, data: bytes) -> None:
        """Somebody else speaks on the wire, now."""
        bench: Any = self.bench
        with running(self.loop):
            bench.wire.say(Stranger(), data, self.loop.time(), (Side.STATIONS, Side.HOSTS))
            bench._set()

    # --- what a case does --------------------------------------------------------------------------------------------

    def ask(self, address: int, wanted: Any) -> Answer:
        """One transaction."""
        answer: Answer = self.loop.run(self.bus.transact(Ask(address, wanted)))
        return answer

    def plain(self, address: int) -> tuple[Any, bytes]:
        """A read of this drive, and its bytes."""
        dialect = self.drives[address].dialect
        wanted = dialect.plain_read()
        return wanted, dialect.codec.encode_request(wanted)

    def read(self, address: int) -> Answer:
        return self.ask(address, self.plain(address)[0])

    def do(self, address: int, what: str, *arguments: Any, **named: Any) -> Wish:
        """A user's command, to its end."""
        wish = self.wish(address, what, *arguments, **named)
        self.finish(wish)
        return wish

    def running_at(self, address: int, hz: float) -> None:
        """The drive runs at this frequency, because we said so."""
        wish = self.do(address, "run", hz)
        self.run(2.5)
        motor = self.station(address).motor
        self.expect(motor.energised and abs(abs(motor.output_hz) - hz) < 0.06, f"not running at {hz}: {wish.word}")

    def monitored(self, address: int) -> Any:
        """A monitor of what this family always shows, and some good readings."""
        monitor = self.monitor(address, (self._watched,))
        self.run(2.0)
        return monitor

    @property
    def _watched(self) -> str:
        return "output_frequency" if self.kind.tells else "output_current"

    def bad(self, address: int) -> bool:
        """Is what the monitor shows called bad?"""
        readings = self.monitors[address].status().readings
        return bool(readings[self._watched].quality is Quality.BAD)

    def restart(self) -> None:
        """The host dies and another one takes its place; the drives know nothing of it."""
        with running(self.loop):
            for task in list(self.loop.tasks):
                task.cancel()
        self.loop.run(self.bus.close())
        self.witness.note("the host has died")
        self.monitors.clear()
        self.bus = WatchedBus(self.port, name=self.name)
        self.bus.witness = self.witness
        self.drives = {address: self._drive(address) for address in self.drives}
        self.loop.run(self.bus.open())
        self.bus.trace(self.events.append)

    def absent(self, address: int) -> int:
        """A drive that is registered and not there."""
        self.drives[address] = self._drive(address)
        return address

    def close(self) -> None:
        if self._open:
            self._open = False
            super().close()

    # --- what a case looks at ----------------------------------------------------------------------------------------

    def since(self, mark: int, *does: Does) -> list[Sent]:
        """Our frames from the ``mark``-th on, of these kinds (none named: all)."""
        return [one for one in self.sent[mark:] if not does or one.does in does]

    def fences(self, frames: Iterable[Sent]) -> list[Sent]:
        return [one for one in frames if is_fence(self.kind, one.data)]

    def figures(self, address: int) -> StationStatistics:
        return self.bus.statistics().stations[address]

    def failures(self, address: int, error: str = "") -> int:
        """Failed transactions of this drive, of one class or of all."""
        errors = self.figures(address).errors
        return errors.get(error, 0) if error else sum(errors.values())

    def kinds(self, name: str) -> int:
        """What the bus has counted of frames that nobody asked for."""
        return self.bus.statistics().counters.get(name, 0)

    def expect(self, truth: object, otherwise: str) -> None:
        """The cell is not held unless this is true."""
        if not truth:
            self.witness.violation(otherwise)
