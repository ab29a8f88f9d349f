"""``Drive``: one drive of any family on a bus. Every method is a conversation; this is the shell around them."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

from drivebus import profiles
from drivebus.bus import Bus
from drivebus.drives import (
    commloss,
    identity,
    jogging,
    parameters,
    proofs,
    reset,
    setpoint,
    start,
    statusread,
    stopping,
)
from drivebus.drives import preflight as preflights
from drivebus.drives.commloss import CommLossReport
from drivebus.drives.dialect import Dialect, Stop
from drivebus.drives.identity import Identity
from drivebus.drives.lease import JogLease
from drivebus.drives.make import make_dialect
from drivebus.drives.memory import DriveLimits, Memory, Preflight
from drivebus.drives.monitor import Monitor
from drivebus.drives.operation import PREPARE_S, Talk
from drivebus.drives.proofs import CodingFound
from drivebus.drives.reach import reach
from drivebus.drives.settle import settled
from drivebus.drives.shell import begin, converse
from drivebus.drives.state import Direction, DriveStatus, Outcome
from drivebus.drives.store import FileStore, MemoryStore, default_path
from drivebus.drives.talk import Conversation
from drivebus.drives.wear import Wear
from drivebus.errors import CapabilityError, Expired
from drivebus.message import Answer, StationTiming
from drivebus.profiles.model import DriveProfile
from drivebus.reading import Reading
from drivebus.seams import Store

T = TypeVar("T")
INSIST_S = 1.0
"""An unconfirmed stop is repeated this often until the drive confirms it or somebody commands anew (matrix 6.4)."""
TICK_S = 1e-6
"""Less than this is not waited for: a loop's clock may not show it."""
FORGETFUL = ("sim", "memory", "replay")
"""Links whose drives have no EEPROM that wears and no bench where a proof was made."""


class Drive:
    """Control and monitor one drive.

    A command returns its Outcome where it is confirmed or acknowledged. Everything else raises, with the outcome on the
    error: CapabilityError, LimitError, PreflightError, GateError, WearBudget and Expired before anything was sent;
    Refused, NotReached, OutcomeUnknown, StopUnconfirmed and Superseded after.
    """

    def __init__(
        self,
        bus: Bus,
        profile: DriveProfile | str | Path,
        address: int,
        *,
        encoding: str | None = None,
        limits: DriveLimits | None = None,
        settings: Mapping[str, Any] | None = None,
        store: Store | None = None,
        timing: StationTiming | None = None,
    ) -> None:
        """Registers the drive on the bus. Raises ProfileError, ConfigurationError (address, encoding, setting)."""
        loaded = profile if isinstance(profile, DriveProfile) else profiles.load(profile)
        self.bus, self.profile, self.address = bus, loaded, address
        self._store = store if store is not None else _default_store(bus)
        self._given = dict(settings or {})
        self.dialect: Dialect = make_dialect(loaded, address, encoding=encoding, settings=self._given, timing=timing)
        given_limits = limits or DriveLimits()
        self._memory = Memory(self.dialect, self._wear(given_limits), given_limits, on_read=self._read)
        self._readers: list[Callable[[Answer], None]] = []
        self._recalled = False
        self._lock = asyncio.Lock()
        self._insisting: asyncio.Task[None] | None = None
        self._stops: set[asyncio.Task[Outcome]] = set()
        self._old_stop = Stop.STOP
        self._recall()
        bus.add(self.dialect.link)

    def close(self) -> None:
        """Take the drive off its bus; sends nothing."""
        self._give_in()
        self.bus.remove(self.address)

    @property
    def _key(self) -> str:
        """What proofs and wear are kept under."""
        return f"{self.bus.port.identity}/{self.address}"

    def _wear(self, limits: DriveLimits) -> Wear:
        return Wear(self._store, self._key, limits.saves_per_day)

    def _recall(self) -> None:
        """What was proved and worn before: known once the port is open, as only then it knows which device it is (F12).

        Before that ``/dev/ttyUSB0`` is a name that another line's adapter may have had.
        """
        if self._recalled or self.bus.is_closed:
            return
        self._recalled = True
        self._memory.wear = self._wear(self._memory.limits)
        for setting, value in self._proofs().items():
            if setting not in self._given:
                self.dialect.settle(setting, value)

    async def _talk(self, conversation: Conversation[T], begun: asyncio.Future[Answer] | None = None) -> T:
        self._recall()
        return await converse(conversation, self.bus, self.address, self._store, begun)

    def _wish(self, wished_at: float | None = None) -> Talk:
        """A command wished for now: a stop from now on takes it away, whatever it still waits for (6.5)."""
        now = self.bus.now()
        wished_at = None if wished_at is None else min(now, wished_at)  # by another clock it might never expire
        return Talk(self._memory, self.bus.generation(self.address), now if wished_at is None else wished_at, wished_at)

    async def _in_turn(self, conversation: Conversation[T]) -> T:
        """One command at a time; a stop never waits for this. Raises Expired for one that waited too long."""
        wished_at = self.bus.now()
        async with self._lock:
            waited_s = self.bus.now() - wished_at
            if waited_s > PREPARE_S:
                conversation.close()
                raise Expired("drives.turn_too_late", age_s=round(waited_s, 2), limit_s=PREPARE_S)
            return await self._talk(conversation)

    async def _command(self, conversation: Conversation[Outcome]) -> Outcome:
        return settled(await self._in_turn(conversation))

    async def _motion(self, conversation: Conversation[T]) -> T:
        """A command that begins motion ends the repetition of an old stop; where it does not end well, that goes on."""
        old = self._give_in()
        try:
            return await self._in_turn(conversation)
        except BaseException:
            if old is not None and self._insisting is None:
                self._insist_on(old)
            raise

    @contextlib.contextmanager
    def _passing(self, talk: Talk) -> Iterator[None]:
        """A motion that must not outlast this block where it fails: it is stopped until that is confirmed."""
        try:
            yield
        except BaseException:
            if talk.may_turn and self._insisting is None:
                self._insist_on(Stop.STOP)
            raise

    @property
    def limits(self) -> DriveLimits:
        """The user's own limits; what is set here holds from the next command on."""
        return self._memory.limits

    @limits.setter
    def limits(self, limits: DriveLimits) -> None:
        self._memory.limits = limits
        self._memory.wear = self._wear(limits)

    @property
    def range_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency that may be set: the profile's and the user's limits together."""
        return self._memory.minimum_hz, self._memory.maximum_hz

    @property
    def acceleration_s(self) -> float | None:
        """Its ramp, where the pre-flight has read it."""
        return self._memory.acceleration_s

    def repace(self, profile: DriveProfile) -> None:
        """The same model with other periods: for the monitors that follow."""
        self.profile = self.dialect.profile = profile

    def check_frequency(self, frequency_hz: float) -> float:
        """What the drive makes of a frequency, in Hz. Raises LimitError; nothing is sent."""
        return self._memory.check_frequency(frequency_hz)[1]

    # --- what it is doing ---------------------------------------------------------------------------------------

    async def status(self, signals: Iterable[str] | None = None) -> DriveStatus:
        """State, direction, fault and readings, read now. Raises the bus's error where the drive does not answer."""
        names = None if signals is None else tuple(signals)
        return await self._talk(statusread.status(Talk(self._memory), names))

    def monitor(
        self,
        signals: Iterable[str] | None = None,
        on_change: Callable[[DriveStatus], None] | None = None,
        period_s: float = 0.0,
    ) -> Monitor:
        """Poll these signals (None: all of the profile) until closed; ``on_change`` gets a status per answer.

        ``period_s``: nothing more often than that, for a line with more drives than the profile's own periods allow;
        readings are then good for three of these periods.
        """
        self._recall()
        return Monitor(self.bus, self.dialect, signals, on_change, period_s, self._readers)

    def _read(self, answer: Answer) -> None:
        """Monitors hear of it a turn later: whoever watches them must not hold up or break a command."""
        for hear in self._readers:
            asyncio.get_running_loop().call_soon(hear, answer)

    async def identify(self) -> Identity:
        """What the drive says of itself (C320 class 0); for the others only that it answers."""
        return await self._talk(identity.identify(Talk(self._memory)))

    async def preflight(self) -> Preflight:
        """Does the drive listen to the bus? Read now; what is missing is in the result, not raised."""
        return await self._talk(preflights.preflight(Talk(self._memory)))

    async def if_host_dies(self) -> CommLossReport:
        """What the drive does by itself when nobody speaks to it any more."""
        return await self._talk(commloss.if_host_dies(Talk(self._memory)))

    # --- motion -------------------------------------------------------------------------------------------------

    async def run(
        self,
        frequency_hz: float,
        direction: Direction | str | None = None,
        wait: bool = False,
        timeout_s: float | None = None,
        wished_at: float | None = None,
    ) -> Outcome:
        """Run at ``frequency_hz``. ``direction`` None is forward (DF800: as the drive is set).

        ``wait``: return when the drive reports running at that frequency, within ``timeout_s`` (None: from its ramp).
        ``wished_at``: when somebody asked for it, by ``bus.now()``. Nothing that moves leaves more than 5 s after that,
        however long the checks take, nor 2 s after them (ruling 12); None: the checks have a limit of their own.
        """
        way = None if direction is None else Direction(direction)
        talk = self._wish(wished_at)
        outcome = settled(await self._motion(start.run(talk, frequency_hz, way, will_wait=wait)))
        return settled(await self._talk(reach(talk, frequency_hz, outcome, timeout_s))) if wait else outcome

    async def set_frequency(self, frequency_hz: float, wished_at: float | None = None) -> Outcome:
        """Change the set frequency; absolute, read back where the model shows it.

        ``wished_at``: as for ``run``; a frame that moves has 2 s from it, every other 5 s.
        """
        return await self._command(setpoint.set_frequency(self._wish(wished_at), frequency_hz))

    def jog(
        self,
        frequency_hz: float | None = None,
        direction: Direction | str = Direction.FORWARD,
        lease_s: float = jogging.LONGEST_LEASE_S,
        wished_at: float | None = None,
    ) -> JogLease:
        """``async with drive.jog(5.0) as lease``: jogs while the lease is renewed.

        ``frequency_hz`` None is the drive's own jog frequency, the only one where the bus can't set it (Modbus models).
        ``wished_at``: as for ``run``.
        Raises LimitError for a lease above 0.5 s.
        """
        way = Direction(direction)
        turning: list[Talk] = []

        async def begin() -> Outcome:
            talk = self._wish(wished_at)
            turning.append(talk)
            with self._passing(talk):
                return settled(await self._motion(jogging.begin(talk, frequency_hz, way)))

        async def end() -> Outcome:
            return settled(await self._stopped(jogging.end(Talk(self._memory)), Stop.STOP), stop=True)

        def may_turn() -> bool:
            return any(talk.may_turn for talk in turning)

        return JogLease(begin, end, lease_s, lambda: self._turning_s(turning[-1].moved), self.bus.now, may_turn)

    def _turning_s(self, moved: Answer | None) -> float:
        """How long ago the last bit of a frame that moves was out."""
        if moved is None or moved.sent_at is None:
            return 0.0
        return max(0.0, self.bus.now() - moved.sent_at - self.bus.line.seconds(len(moved.sent)))

    async def stop(self, wait: bool = True) -> Outcome:
        """Stop along the ramp. Raises StopUnconfirmed where the drive does not report it; the stop is then repeated.

        Its patience is that of one drive on a line of its own: for several at once there is ``bus_stop``.
        """
        return await self._stop(Stop.STOP, wait)

    async def stop_among(self, drives: int) -> Outcome:
        """``stop`` as one of so many drives of a line that are stopped at once: each waits for the others' turns."""
        return await self._stop(Stop.STOP, True, drives)

    async def coast(self, wait: bool = True) -> Outcome:
        """Output off, the motor runs out. Raises CapabilityError where the model has no such command."""
        return await self._stop(Stop.COAST, wait)

    async def quick_stop(self, wait: bool = True) -> Outcome:
        """The drive's own fast stop. Not an emergency stop: only a hard-wired STO or SS1 is."""
        return await self._stop(Stop.QUICK_STOP, wait)

    async def _stop(self, how: Stop, wait: bool, drives: int = 1) -> Outcome:
        """``drives``: as one of so many that are stopped at once, where each waits for the others' turns."""
        if how.value not in self.profile.capabilities:
            raise CapabilityError("drives.cannot", model=self.profile.model, what=how.value)
        self._give_in()
        talk = Talk(self._memory)
        progress = stopping.Progress(talk, self.bus.now(), drives)
        conversation = stopping.stop(talk, how, wait_for_it=wait, progress=progress)
        self._recall()
        begun = begin(conversation, self.bus, self.address)
        stopping_it = asyncio.ensure_future(self._stopped(conversation, how, begun))
        self._stops.add(stopping_it)
        stopping_it.add_done_callback(self._stop_ended)
        outcome = await self._told_in_time(stopping_it, talk, progress, how)
        if outcome.key == "drives.stop_answered":
            return outcome
        return settled(outcome, stop=True)

    def _stop_ended(self, stop: asyncio.Task[Outcome]) -> None:
        """Whoever still waits for it hears how; one that nobody waits for may end with its drive's registration."""
        self._stops.discard(stop)
        if not stop.cancelled():
            stop.exception()

    async def _told_in_time(
        self, stopping_it: asyncio.Task[Outcome], talk: Talk, progress: stopping.Progress, how: Stop
    ) -> Outcome:
        """How it ended, or in time that it did not, and then it is begun anew: its reads may wait for their turn (G07).

        Whoever gives up waiting for this does not take the stop back.
        """
        while not stopping_it.done():
            left_s = progress.alarm_at - self.bus.now()
            if left_s <= TICK_S:
                stopping_it.cancel()
                self._insist_on(how)
                return stopping.unconfirmed(talk)
            await asyncio.wait({stopping_it}, timeout=left_s)
        return stopping_it.result()

    async def _stopped(
        self, conversation: Conversation[Outcome], how: Stop, begun: asyncio.Future[Answer] | None = None
    ) -> Outcome:
        """What became of a stop; where that is not known it is repeated from now on."""
        outcome = await self._talk(conversation, begun)
        if outcome.done:
            self._give_in()
        else:
            self._insist_on(how)
        return outcome

    @property
    def stop_pending(self) -> bool:
        """A stop was sent that the drive has not confirmed; it is being repeated."""
        return self._insisting is not None and not self._insisting.done()

    @property
    def stopping(self) -> bool:
        """A stop is under way, or was not confirmed and is being repeated."""
        return bool(self._stops) or self.stop_pending

    def _insist_on(self, how: Stop) -> None:
        self._give_in()
        self._old_stop = how
        self._insisting = asyncio.ensure_future(self._insist(how))

    async def _insist(self, how: Stop) -> None:
        """Repeat an unconfirmed stop until the drive confirms it, or the bus is closed for good."""
        while not self.bus.is_closed:
            outcome = await self._talk(stopping.stop(Talk(self._memory), how))
            if outcome.done:
                return
            await asyncio.sleep(INSIST_S)

    def _give_in(self) -> Stop | None:
        """End the repetition of an old stop; which one it was, None where there was none."""
        pending, task, self._insisting = self.stop_pending, self._insisting, None
        if task is not None:
            task.cancel()
        return self._old_stop if pending else None

    async def reset_fault(self) -> Outcome:
        """Reset a fault, once, while the drive reports one."""
        return await self._command(reset.reset_fault(self._wish()))

    # --- parameters ---------------------------------------------------------------------------------------------

    async def read(self, names: Iterable[str]) -> dict[str, Reading]:
        """Parameters in the manual's notation, or signals by name. Raises ProfileError for a name nobody knows."""
        return await self._talk(parameters.read(Talk(self._memory), tuple(names)))

    async def write(self, values: Mapping[str, float], save: bool = False) -> Outcome:
        """Write parameters to RAM, or with ``save`` to EEPROM; each is read back, and named in the outcome's notes."""
        return await self._command(parameters.write(Talk(self._memory), values, save))

    # --- bench proofs -------------------------------------------------------------------------------------------

    async def prove_query_coding(self, keypad_hz: float = proofs.KEYPAD_HZ) -> CodingFound:
        """DZB100: ``keypad_hz`` stands on the keypad; Q00 names the query coding, which is then kept."""
        found = await self._talk(proofs.query_coding(Talk(self._memory), keypad_hz))
        if found.settled is not None:
            await self._prove("query_coding", found.settled)
        return found

    async def prove_setpoint_coding(self, direction: Direction | str | None = None) -> CodingFound:
        """DZB100: runs at 5 Hz or less, a person watching, until one setpoint coding is left, which is then kept."""
        way = None if direction is None else Direction(direction)
        talk = self._wish()
        with self._passing(talk):
            found = await self._motion(proofs.setpoint_coding(talk, way))
        if found.settled is not None:
            await self._prove("setpoint_coding", found.settled)
        return found

    async def prove_direction(self, frequency_hz: float, watched: Callable[[], Awaitable[Direction | None]]) -> Outcome:
        """DF800: one jog of 0.5 s; ``watched`` asks the person which way it turned (None: could not tell)."""
        talk = self._wish()
        with self._passing(talk):
            outcome = settled(await self._motion(proofs.direction_jog(talk, frequency_hz)))
        seen = await watched()
        if seen is not None:
            await self._prove("direction_field", proofs.direction_field(seen))
            await self._prove("direction_proved", True)
        return outcome

    async def _prove(self, setting: str, value: Any) -> None:
        self.dialect.settle(setting, value)
        await asyncio.to_thread(self._store.put, self._proof_name(setting), json.dumps(value))

    def _proof_name(self, setting: str) -> str:
        return f"proof/{self._key}/{self.profile.model}/{setting}"

    def _proofs(self) -> dict[str, Any]:
        """What was proved on this drive before; a record that can't be read proves nothing."""
        found: dict[str, Any] = {}
        for setting in self.profile.settings:
            text = self._store.get(self._proof_name(setting))
            with contextlib.suppress(ValueError):
                found |= {} if text is None else {setting: json.loads(text)}
        return found


def _default_store(bus: Bus) -> Store:
    scheme = bus.port.url.partition(":")[0]
    return MemoryStore() if scheme in FORGETFUL else FileStore(default_path())
