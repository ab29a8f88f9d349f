"""Scenario that records every frame, and in which single frames can be lost, changed, delayed or sent by a foreign
master."""

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
from verification.reference.effects import RequestEffect
from verification.reference.request_effects import classify_request, is_sync_probe
from verification.scenario.scenario import ObservedBus, Scenario, SentRequest
from verification.scenario.user_command import UserCommand

WireSend = Callable[..., Any]
"""``transmit(data, at, source=…)``: let a drive transmit these bytes at that time."""
ReplyAction = Callable[[WireSend, bytes, float], Any]
"""Transmission of a drive in place of ``data`` at ``at``."""


class MatrixReply(NamedTuple):
    """Reply of a drive and its request."""

    address: int
    request: bytes
    data: bytes
    start: float


@dataclass(slots=True)
class ReplyManipulation:
    """Manipulation of the next replies of one drive. "deaf": the drive receives nothing; "mute": it does not reply."""

    address: int
    matches: Callable[[bytes], bool]
    action: ReplyAction | str
    remaining: float


class ForeignTalker:
    """Foreign master on the wire."""

    address = "foreign master"


class MatrixScenario(Scenario):
    """Scenario whose drives have replied once, so that they are online."""

    def __init__(
        self,
        campaign_run: CampaignRun,
        variant: DriveVariant,
        name: str,
        addresses: Iterable[int],
        seed: int,
        options: dict[str, Any],
    ) -> None:
        super().__init__(campaign_run, variant, addresses, name=name, seed=seed, **options)
        self.requests: list[SentRequest] = []
        self.replies: list[MatrixReply] = []
        self.events: list[TraceEvent] = []
        self.when_sent: Callable[[SentRequest], None] = lambda sent: None
        self.cuts_last_byte = False
        """Whether the adapter's driver is disabled before the last byte is out."""
        self._manipulations: list[ReplyManipulation] = []
        self._current_request = b""
        self._open = True
        self.observe_wire(self._on_transmission)
        self._intercept_replies()
        self.bus.trace(self.events.append)
        for address in self.drives:
            self.read(address)

    # --- manipulations ---------------------------------------------------------------------------------------------

    def _on_transmission(self, transmission: Any, sent: SentRequest | None) -> None:
        if sent is None:
            return
        if self.cuts_last_byte:
            transmission.dropped.add(len(sent.data) - 1)
        self.requests.append(sent)
        self.when_sent(sent)

    def _intercept_replies(self) -> None:
        simulated_bus: Any = self.simulated_bus
        reply, dispatch = simulated_bus.wire.transmit_reply, simulated_bus._dispatch

        def on_reply(source: Any, data: bytes, now: float, at: float) -> Any:
            manipulation = self._manipulation_for(source.address, lambda act: not isinstance(act, str))

            def transmit_reply(data: bytes, at: float, source: Any = source) -> Any:
                transmission = reply(source, data, now, at)
                self.replies.append(MatrixReply(source.address, self._current_request, data, transmission.start))
                return transmission

            if manipulation is None or isinstance(manipulation.action, str):
                return transmit_reply(data, at)
            return manipulation.action(transmit_reply, data, at)

        def on_dispatch(frame: Any, stations: Any, transmission: Any, now: float) -> None:
            self._current_request = frame.frame
            manipulation = self._manipulation_for(frame.address, lambda act: isinstance(act, str))
            hit = [
                station.faults for station in stations if manipulation is not None and station.address == frame.address
            ]
            what = "silent" if manipulation is not None and manipulation.action == "deaf" else "mute"
            before = [getattr(faults, what) for faults in hit]
            for faults in hit:
                setattr(faults, what, True)
            dispatch(frame, stations, transmission, now)
            for faults, was in zip(hit, before, strict=True):
                setattr(faults, what, was)

        simulated_bus.wire.transmit_reply, simulated_bus._dispatch = on_reply, on_dispatch

    def _manipulation_for(
        self, address: int | None, kind: Callable[[ReplyAction | str], bool]
    ) -> ReplyManipulation | None:
        for manipulation in self._manipulations:
            if (
                manipulation.address == address
                and manipulation.remaining > 0
                and kind(manipulation.action)
                and manipulation.matches(self._current_request)
            ):
                manipulation.remaining -= 1
                return manipulation
        return None

    def manipulate_replies(
        self, address: int, act: ReplyAction | str, times: float = inf, effect: RequestEffect | None = None
    ) -> ReplyManipulation:
        """Manipulate replies from now on to requests with this effect (None: to all)."""

        def wanted(data: bytes) -> bool:
            return effect is None or classify_request(self.variant.model, self.variant.encoding, data)[1] is effect

        self._manipulations.append(ReplyManipulation(address, wanted, act, times))
        return self._manipulations[-1]

    def send_foreign(self, data: bytes) -> None:
        """Transmit a frame of a foreign master now."""
        simulated_bus: Any = self.simulated_bus
        with running(self.loop):
            simulated_bus.wire.transmit(ForeignTalker(), data, self.loop.time(), (Side.STATIONS, Side.MASTERS))
            simulated_bus._arm_timer()

    # --- actions of a cell -------------------------------------------------------------------------------------------

    def transact(self, address: int, request: Any) -> BusResult:
        """Run one transaction."""
        answer: BusResult = self.loop.run_until_complete(
            self.bus.transact(BusRequest(station=address, request=request))
        )
        return answer

    def plain_read(self, address: int) -> tuple[Any, bytes]:
        """Return a read of this drive, and its bytes."""
        dialect = self.drives[address].dialect
        wanted = dialect.echo_test_read()
        return wanted, dialect.codec.encode_request(wanted)

    def read(self, address: int) -> BusResult:
        return self.transact(address, self.plain_read(address)[0])

    def command_to_end(self, address: int, what: str, *arguments: Any, **named: Any) -> UserCommand:
        """Run a user command to its end."""
        user_command = self.command(address, what, *arguments, **named)
        self.finish(user_command)
        return user_command

    def start_at(self, address: int, hz: float) -> None:
        """Start a drive and wait until it runs at this frequency."""
        command = self.command_to_end(address, "run", hz)
        self.run(2.5)
        motor = self.station(address).motor
        self.expect(
            motor.energised and abs(abs(motor.output_hz) - hz) < 0.06, f"not running at {hz}: {command.result_word}"
        )

    def monitored(self, address: int) -> Any:
        """Return a monitor of a signal that this model always reports, after some good readings."""
        monitor = self.monitor(address, (self._count_events,))
        self.run(2.0)
        return monitor

    @property
    def _count_events(self) -> str:
        return "output_frequency" if self.variant.reports_running else "output_current"

    def has_bad_quality(self, address: int) -> bool:
        """Return whether the monitored value is bad."""
        readings = self.monitors[address].status().readings
        return bool(readings[self._count_events].quality is Quality.BAD)

    def restart_host(self) -> None:
        """Replace the bus and the drives by new objects; the simulated drives continue."""
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

    def close(self) -> None:
        if self._open:
            self._open = False
            super().close()

    # --- observations of a cell --------------------------------------------------------------------------------------

    def requests_since(self, mark: int, *effect: RequestEffect) -> list[SentRequest]:
        """Return the requests from the ``mark``-th on, with these effects (default: all)."""
        return [request for request in self.requests[mark:] if not effect or request.effect in effect]

    def sync_probes(self, frames: Iterable[SentRequest]) -> list[SentRequest]:
        return [frame for frame in frames if is_sync_probe(self.variant, frame.data)]

    def statistics(self, address: int) -> StationStatistics:
        return self.bus.statistics().stations[address]

    def failure_count(self, address: int, error: str = "") -> int:
        """Return the number of failed transactions of this drive, of one error class or of all."""
        errors = self.statistics(address).errors
        return errors.get(error, 0) if error else sum(errors.values())

    def unsolicited_count(self, name: str) -> int:
        """Return a counter of unsolicited frames."""
        return self.bus.statistics().counters.get(name, 0)

    def expect(self, condition: object, text: str) -> None:
        """Report a violation of the cell unless the condition holds."""
        if not condition:
            self.oracle.violation(text)
