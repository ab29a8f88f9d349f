"""A stand on which single frames can be lost, changed or held back, strangers speak, and everything is on record."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import inf
from typing import Any, NamedTuple

from drivebus.bus import StationStatistics, TraceEvent
from drivebus.bus.messages import BusRequest, BusResult
from drivebus.simulator.wire import Side
from drivebus.testing.virtual_time import running
from drivebus.values import Quality
from verification.campaign import CampaignRun
from verification.drive_variants import DriveVariant
from verification.fault_matrix.frame_fields import is_sync_probe
from verification.reference.request_effects import RequestEffect, classify_request
from verification.scenario.scenario import ObservedBus, Scenario
from verification.scenario.user_command import UserCommand

WireSend = Callable[..., Any]
"""``say(data, at, talker=…)``: a drive says these bytes from that second on."""
ReplyAction = Callable[[WireSend, bytes, float], Any]
"""What a drive says instead of ``data`` at ``at``."""


class MatrixRequest(NamedTuple):
    """A frame of ours on the copper."""

    start: float
    end: float
    address: int
    effect: RequestEffect
    data: bytes


class MatrixReply(NamedTuple):
    """What a drive answered, to which request."""

    address: int
    request: bytes
    data: bytes
    start: float


@dataclass(slots=True)
class ReplyManipulation:
    """``act`` takes the place of the next ``times`` answers; "deaf": the drive hears nothing, "mute": says nothing."""

    address: int
    matches: Callable[[bytes], bool]
    action: ReplyAction | str
    remaining: float


class ForeignTalker:
    """Somebody else on the wire; no host of ours."""

    address = "stranger"


class MatrixBus(Scenario):
    """Drives that have been spoken to once, so that they are known to be there."""

    def __init__(
        self,
        session: CampaignRun,
        kind: DriveVariant,
        name: str,
        addresses: Iterable[int],
        seed: int,
        options: dict[str, Any],
    ) -> None:
        super().__init__(session, kind, addresses, name=name, seed=seed, **options)
        self.requests: list[MatrixRequest] = []
        self.replies: list[MatrixReply] = []
        self.events: list[TraceEvent] = []
        self.when_sent: Callable[[MatrixRequest], None] = lambda sent: None
        self.cuts_last_byte = False
        """Our adapter's driver goes off before the last byte is out."""
        self._manipulations: list[ReplyManipulation] = []
        self._current_request = b""
        self._open = True
        self._intercept_wire()
        self.bus.trace(self.events.append)
        for address in self.drives:
            self.read(address)

    # --- on the copper ---------------------------------------------------------------------------------------------

    def _intercept_wire(self) -> None:
        bench: Any = self.bench
        say, reply, dispatch = bench.wire.transmit, bench.wire.transmit_reply, bench._dispatch

        def on_say(talker: Any, data: bytes, *more: Any, **named: Any) -> Any:
            text = say(talker, data, *more, **named)
            if hasattr(talker, "receive"):
                if self.cuts_last_byte:
                    text.dropped.add(len(data) - 1)
                sent = MatrixRequest(
                    text.start, text.end, *classify_request(self.kind.model, self.kind.encoding, data), data
                )
                self.requests.append(sent)
                self.when_sent(sent)
            return text

        def on_reply(talker: Any, data: bytes, now: float, at: float) -> Any:
            trick = self._manipulation_for(talker.address, lambda act: not isinstance(act, str))

            def drive_says(data: bytes, at: float, talker: Any = talker) -> Any:
                text = reply(talker, data, now, at)
                self.replies.append(MatrixReply(talker.address, self._current_request, data, text.start))
                return text

            if trick is None or isinstance(trick.action, str):
                return drive_says(data, at)
            return trick.action(drive_says, data, at)

        def on_dispatch(frame: Any, stations: Any, text: Any, now: float) -> None:
            self._current_request = frame.frame
            trick = self._manipulation_for(frame.address, lambda act: isinstance(act, str))
            hit = [one.faults for one in stations if trick is not None and one.address == frame.address]
            what = "silent" if trick is not None and trick.action == "deaf" else "mute"
            before = [getattr(faults, what) for faults in hit]
            for faults in hit:
                setattr(faults, what, True)
            dispatch(frame, stations, text, now)
            for faults, was in zip(hit, before, strict=True):
                setattr(faults, what, was)

        bench.wire.transmit, bench.wire.transmit_reply, bench._dispatch = on_say, on_reply, on_dispatch

    def _manipulation_for(
        self, address: int | None, kind: Callable[[ReplyAction | str], bool]
    ) -> ReplyManipulation | None:
        for trick in self._manipulations:
            if (
                trick.address == address
                and trick.remaining > 0
                and kind(trick.action)
                and trick.matches(self._current_request)
            ):
                trick.remaining -= 1
                return trick
        return None

    def manipulate_replies(
        self, address: int, act: ReplyAction | str, times: float = inf, does: RequestEffect | None = None
    ) -> ReplyManipulation:
        """From now on, for requests that do this (None: for all); ``times`` 0 ends it."""

        def wanted(data: bytes) -> bool:
            return does is None or classify_request(self.kind.model, self.kind.encoding, data)[1] is does

        self._manipulations.append(ReplyManipulation(address, wanted, act, times))
        return self._manipulations[-1]

    def send_foreign(self, data: bytes) -> None:
        """Somebody else speaks on the wire, now."""
        bench: Any = self.bench
        with running(self.loop):
            bench.wire.transmit(ForeignTalker(), data, self.loop.time(), (Side.STATIONS, Side.MASTERS))
            bench._arm_timer()

    # --- what a case does --------------------------------------------------------------------------------------------

    def transact(self, address: int, wanted: Any) -> BusResult:
        """One transaction."""
        answer: BusResult = self.loop.run_until_complete(self.bus.transact(BusRequest(address, wanted)))
        return answer

    def plain_read(self, address: int) -> tuple[Any, bytes]:
        """A read of this drive, and its bytes."""
        dialect = self.drives[address].dialect
        wanted = dialect.echo_test_read()
        return wanted, dialect.codec.encode_request(wanted)

    def read(self, address: int) -> BusResult:
        return self.transact(address, self.plain_read(address)[0])

    def command_to_end(self, address: int, what: str, *arguments: Any, **named: Any) -> UserCommand:
        """A user's command, to its end."""
        user_command = self.command(address, what, *arguments, **named)
        self.finish(user_command)
        return user_command

    def start_at(self, address: int, hz: float) -> None:
        """The drive runs at this frequency, because we said so."""
        command = self.command_to_end(address, "run", hz)
        self.run(2.5)
        motor = self.station(address).motor
        self.expect(
            motor.energised and abs(abs(motor.output_hz) - hz) < 0.06, f"not running at {hz}: {command.result_word}"
        )

    def monitored(self, address: int) -> Any:
        """A monitor of what this family always shows, and some good readings."""
        monitor = self.monitor(address, (self._count_events,))
        self.run(2.0)
        return monitor

    @property
    def _count_events(self) -> str:
        return "output_frequency" if self.kind.reports_running else "output_current"

    def has_bad_quality(self, address: int) -> bool:
        """Is what the monitor shows called bad?"""
        readings = self.monitors[address].status().readings
        return bool(readings[self._count_events].quality is Quality.BAD)

    def restart_host(self) -> None:
        """The host dies and another one takes its place; the drives know nothing of it."""
        with running(self.loop):
            for task in list(self.loop.tasks):
                task.cancel()
        self.loop.run_until_complete(self.bus.close())
        self.oracle.trace("the host has died")
        self.monitors.clear()
        self.bus = ObservedBus(self.port, name=self.name)
        self.bus.oracle = self.oracle
        self.drives = {address: self._drive(address) for address in self.drives}
        self.loop.run_until_complete(self.bus.open())
        self.bus.trace(self.events.append)

    def add_absent(self, address: int) -> int:
        """A drive that is registered and not there."""
        self.drives[address] = self._drive(address)
        return address

    def close(self) -> None:
        if self._open:
            self._open = False
            super().close()

    # --- what a case looks at ----------------------------------------------------------------------------------------

    def requests_since(self, mark: int, *does: RequestEffect) -> list[MatrixRequest]:
        """Our frames from the ``mark``-th on, of these kinds (none named: all)."""
        return [one for one in self.requests[mark:] if not does or one.effect in does]

    def sync_probes(self, frames: Iterable[MatrixRequest]) -> list[MatrixRequest]:
        return [one for one in frames if is_sync_probe(self.kind, one.data)]

    def statistics(self, address: int) -> StationStatistics:
        return self.bus.statistics().stations[address]

    def failure_count(self, address: int, error: str = "") -> int:
        """Failed transactions of this drive, of one class or of all."""
        errors = self.statistics(address).errors
        return errors.get(error, 0) if error else sum(errors.values())

    def unsolicited_count(self, name: str) -> int:
        """What the bus has counted of frames that nobody asked for."""
        return self.bus.statistics().counters.get(name, 0)

    def expect(self, truth: object, otherwise: str) -> None:
        """The cell is not held unless this is true."""
        if not truth:
            self.oracle.violation(otherwise)
