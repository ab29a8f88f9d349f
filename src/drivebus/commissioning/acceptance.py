"""Acceptance checklist: what only real wires, adapters and drives can show, one step after the other.

A step opens the bus, measures, and ends as passed, failed or skipped. Steps that need a person are skipped without one;
steps that turn the motor run only when it is allowed, and a stop follows them in every case.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import AbstractAsyncContextManager, AbstractContextManager, AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, TypeVar

from drivebus.bus import Bus, Presence
from drivebus.bus.messages import BusRequest
from drivebus.drives import Drive
from drivebus.drives.outcome import Outcome
from drivebus.errors import DrivebusError, StopUnconfirmed
from drivebus.user_input import YES_WORDS
from drivebus.values import Text

T = TypeVar("T")
StepOutcome = tuple[bool | None, dict[str, Any]]
"""Passed, failed or (None) not observable on this port; and the figures, units in their names."""

TIMING_READS = 300
"""Reads of the reply times: enough for a p99."""
WRONG_PARITY_READS = 20
"""Reads with a wrong parity; each waits for its timeout."""
FAILED_SHARE_MAX = 0.01
"""A bus on which more than 1 % of the reads fail, before their retry, is not well wired."""
QUIET_OBSERVATION_S = 3
OTHER_PARITY = {"N": "E", "E": "O", "O": "E"}
UNSOLICITED_KINDS = ("late", "foreign", "duplicate", "unsolicited", "foreign_request", "collision", "line_errors")
"""Counters that stay at zero on a well wired bus with one master."""
PERSON_TIMEOUT_S = 60.0
"""A person has this long to pull a plug or turn a switch."""
CONDITION_POLL_S = 0.02
REPLUG_POLL_MAX_S = 2.0
"""Polling continues within 2 s after the port is back."""
OFFLINE_DETECTED_MAX_S = 60.0
"""A drive that comes back is found within 60 s."""
RUN_DURATION_S = 5.0
UNKNOWN_COMM_LOSS_S = 15.0
"""Silence for a drive whose communication timer can't be read."""
COMM_LOSS_MARGIN_S = 3.0


class AcceptanceInterrupted(Exception):
    """The user ended the checklist; the findings so far are kept."""

    stop: Outcome | None = None
    """Stop of the motor that the step had started."""


class AcceptanceSession(ABC):
    """Access of the steps to bus, drive and person. ``motor``: it may turn, at ``frequency_hz`` at most."""

    def __init__(self, port: str, *, motor: bool, frequency_hz: float) -> None:
        self.port, self.motor, self.frequency_hz = port, motor, frequency_hz

    @abstractmethod
    def drive(self, serial_format: str | None = None) -> AbstractAsyncContextManager[tuple[Bus, Drive]]:
        """Open a bus with the drive for one step; ``serial_format`` such as "8E1" replaces the drive's own."""

    @abstractmethod
    async def second_instance(self) -> dict[str, Any]:
        """Read the drive's status from another process; return the JSON document that it prints."""

    @abstractmethod
    async def race(self, work: Awaitable[T]) -> T:
        """Return the result of ``work``. Raises AcceptanceInterrupted when the user ends the checklist first."""

    @abstractmethod
    async def ask(self, key: str, /, **params: Any) -> str:
        """Return the line typed after a question, in lower case and half-width characters; empty without a terminal."""

    @abstractmethod
    def progress(self, step: str) -> AbstractContextManager[Callable[[float, float], None]]:
        """Show the progress of a step that only reads; the function takes the done and the expected seconds."""

    async def confirm(self, key: str, /, **params: Any) -> bool:
        """Return whether the answer is yes."""
        return await self.ask(key, **params) in YES_WORDS


class StepRequirement(StrEnum):
    """Need of a step beside the bus."""

    NOTHING = "nothing"
    """It only reads."""
    PERSON = "person"
    """A person who pulls a plug or turns a switch."""
    MOTOR = "motor"
    """A motor that may turn, and a person who watches it."""


class StepResult(StrEnum):
    """End of a step."""

    PASSED = "passed"
    FAILED = "failed"
    SKIPPED = "skipped"
    """Not done: no person there, not wanted, or not observable on this port."""


@dataclass(frozen=True, slots=True)
class StepFinding:
    """Result of one step. ``figures`` are the measurements, units in their names."""

    step: str
    verdict: StepResult
    figures: Mapping[str, Any] = field(default_factory=dict)
    reason: str = ""
    """Message key of the reason, where there is one."""


async def run_step(name: str, session: AcceptanceSession) -> StepFinding:
    """Run one step, or skip it where its requirement is not met."""
    requirement, step = ACCEPTANCE_STEPS[name]
    if requirement is StepRequirement.MOTOR and not session.motor:
        return StepFinding(name, StepResult.SKIPPED, reason="acceptance.no_motor")
    if requirement is not StepRequirement.NOTHING and not await session.confirm(
        f"acceptance.ask.{name}", frequency_hz=session.frequency_hz
    ):
        return StepFinding(name, StepResult.SKIPPED, reason="acceptance.not_confirmed")
    try:
        good, figures = await step(session)
    except DrivebusError as error:
        return StepFinding(name, StepResult.FAILED, {"error": error}, "acceptance.not_completed")
    if good is None:
        return StepFinding(name, StepResult.SKIPPED, figures, f"acceptance.not.{name}")
    return StepFinding(
        name, StepResult.PASSED if good else StepResult.FAILED, figures, "" if good else f"acceptance.bad.{name}"
    )


# --- steps that only read ---------------------------------------------------------------------------------------------


async def check_port(session: AcceptanceSession) -> StepOutcome:
    """Report the port's capabilities: line timing, parity check, direction control."""
    async with session.drive() as (bus, _):
        able = bus.port.capabilities
        return True, {
            "identity": bus.port.identity,
            "serial": str(bus.settings),
            "line_timing": able.has_line_timing,
            "parity": able.parity,
            "direction_control": able.direction_control,
        }


async def check_exclusive(session: AcceptanceSession) -> StepOutcome:
    """Check that a second program can't open the port."""
    if session.port.startswith(("sim:", "memory:", "tcp:", "rfc2217:")):
        return None, {}
    async with session.drive():
        error = (await session.race(session.second_instance())).get("error", {})
    return error.get("type") == "PortUnavailable", {"refused": error["text"]} if error else {}


async def check_quiet(session: AcceptanceSession) -> StepOutcome:
    """Check that no byte arrives while drivebus sends nothing."""
    async with session.drive() as (bus, _):
        await session.race(_observe(session))
        received = bus.statistics().bytes_received
    return received == 0, {"observed_s": QUIET_OBSERVATION_S, "bytes_received": received}


async def check_reply_times(session: AcceptanceSession) -> StepOutcome:
    """Measure the reply times and failures of 300 reads."""
    async with session.drive() as (bus, drive):
        await session.race(_send_reads(session, "reply_times", bus, drive, TIMING_READS))
        statistics = bus.statistics().stations[drive.address]
    figures: dict[str, Any] = {
        f"reply_{name}_ms": _ms(getattr(statistics, f"reply_{name}_s")) for name in ("p50", "p95", "p99")
    }
    figures |= {"reads": statistics.transactions, "damaged": statistics.damaged, "errors": dict(statistics.errors)}
    figures["least_possible_ms"] = _ms(_min_reply_s(bus, drive))
    return statistics.error_rate <= FAILED_SHARE_MAX and statistics.replies >= TIMING_READS, figures


async def check_stray_replies(session: AcceptanceSession) -> StepOutcome:
    """Check that 300 reads bring no late, foreign or second reply."""
    async with session.drive() as (bus, drive):
        await session.race(_send_reads(session, "stray_replies", bus, drive, TIMING_READS))
        counters = bus.statistics().counters
    stray = {name: counters.get(name, 0) for name in UNSOLICITED_KINDS}
    return not any(stray.values()), stray


async def check_parity(session: AcceptanceSession) -> StepOutcome:
    """Check that no reply is accepted with another parity than the drive's, where the port checks parity."""
    async with session.drive() as (bus, _):
        settings, checks_parity = bus.settings, bus.port.capabilities.parity
    if not checks_parity or session.port.startswith("sim:"):
        return None, {}
    other = f"{settings.data_bits}{OTHER_PARITY[settings.parity]}{settings.stop_bits}"
    async with session.drive(other) as (bus, drive):
        await session.race(_send_reads(session, "parity", bus, drive, WRONG_PARITY_READS))
        statistics = bus.statistics().stations[drive.address]
    return statistics.replies == 0, {"format": other, "reads": WRONG_PARITY_READS, "accepted": statistics.replies}


async def _observe(session: AcceptanceSession) -> None:
    with session.progress("quiet") as show:
        for done_s in range(QUIET_OBSERVATION_S):
            show(done_s, QUIET_OBSERVATION_S)
            await asyncio.sleep(1)


async def _send_reads(session: AcceptanceSession, step: str, bus: Bus, drive: Drive, count: int) -> None:
    started_at = bus.now()
    with session.progress(step) as show:
        for done in range(1, count + 1):
            await bus.transact(BusRequest(station=drive.address, request=drive.dialect.echo_test_read()))
            spent_s = bus.now() - started_at
            show(spent_s, spent_s * count / done)


def _min_reply_s(bus: Bus, drive: Drive) -> float:
    """Return the time of the reply's own characters: drive and adapter without any delay."""
    return bus.settings.seconds(drive.dialect.codec.reply_size(drive.dialect.echo_test_read()))


def _ms(seconds: float | None) -> float | None:
    return None if seconds is None else round(1000 * seconds, 3)


# --- steps that need a person -----------------------------------------------------------------------------------------


async def check_unplug(session: AcceptanceSession) -> StepOutcome:
    """Check that the loss of the adapter is detected, and that polling continues on the same adapter afterwards."""
    async with session.drive() as (bus, drive):
        with drive.monitor():
            if not await session.race(_wait_until(lambda: not bus.is_open)):
                return False, {"noticed": False}
            lost_at = bus.now()
            if not await session.race(_wait_until(lambda: bus.is_open)):
                return False, {"noticed": True, "back": False}
            back = bus.now()
            answered = await session.race(_wait_until(lambda: _replied_since(bus, drive, back)))
            figures: dict[str, Any] = {
                "away_s": round(back - lost_at, 3),
                "polling_after_s": round(bus.now() - back, 3),
            }
            return answered and bus.now() - back <= REPLUG_POLL_MAX_S, figures


async def check_power_loss(session: AcceptanceSession) -> StepOutcome:
    """Check that a drive without power is reported offline, and found again."""
    async with session.drive() as (bus, drive):
        with drive.monitor():
            if not await session.race(_wait_until(lambda: bus.presence(drive.address) is Presence.OFFLINE)):
                return False, {"offline": False}
            offline_at = bus.now()
            answered = await session.race(
                _wait_until(lambda: _replied_since(bus, drive, offline_at), PERSON_TIMEOUT_S + OFFLINE_DETECTED_MAX_S)
            )
            await session.race(replies_now(bus, drive))
            return answered, {"offline": True, "away_s": round(bus.now() - offline_at, 3)}


async def replies_now(bus: Bus, drive: Drive) -> bool:
    """Return whether the drive replies to a read now."""
    try:
        return (
            await bus.transact(BusRequest(station=drive.address, request=drive.dialect.echo_test_read()))
        ).error is None
    except DrivebusError:
        return False


def _replied_since(bus: Bus, drive: Drive, when: float) -> bool:
    replied_at = bus.health(drive.address).last_reply_at
    return replied_at is not None and replied_at > when


async def _wait_until(condition: Callable[[], bool], timeout_s: float = PERSON_TIMEOUT_S) -> bool:
    for _ in range(int(timeout_s / CONDITION_POLL_S)):
        if condition():
            return True
        await asyncio.sleep(CONDITION_POLL_S)
    return False


# --- steps that turn the motor ----------------------------------------------------------------------------------------


async def check_run_and_stop(session: AcceptanceSession) -> StepOutcome:
    """Start and stop the motor, and compare the outcomes with what a person sees."""
    async with session.drive() as (bus, drive), _stop_afterwards(drive) as outcomes:
        begun = bus.now()
        outcomes["run"] = str((await session.race(drive.run(session.frequency_hz))).status)
        outcomes["started_s"] = round(bus.now() - begun, 3)
        await session.race(asyncio.sleep(RUN_DURATION_S))
        turned = await session.confirm("acceptance.ask.turns")
    stood = await session.confirm("acceptance.ask.stands")
    return turned and stood and outcomes["stop"] in ("confirmed", "acknowledged"), outcomes


async def check_comm_loss(session: AcceptanceSession) -> StepOutcome:
    """Compare the drive's reaction to silence with the reaction that its parameters announce."""
    async with session.drive() as (_, drive):
        report = await session.race(drive.comm_loss_behaviour())
        async with _stop_on_error(drive):
            await session.race(drive.run(session.frequency_hz))
    value = report.time.value if report.time is not None else None
    alone_s = (float(value) if isinstance(value, int | float) else UNKNOWN_COMM_LOSS_S) + COMM_LOSS_MARGIN_S
    try:
        await session.race(asyncio.sleep(alone_s))
        turns = await session.confirm("acceptance.ask.still_turns", seconds=round(alone_s))
    except BaseException as error:
        async with _drive_to_stop(session) as drive:
            await _stop_after(error, drive)
        raise
    async with _drive_to_stop(session) as drive, _stop_afterwards(drive) as outcomes:
        outcomes |= {"announces_trip": report.stops_on_comm_loss, "alone_s": alone_s, "still_turned": turns}
    return (None if report.stops_on_comm_loss is None else report.stops_on_comm_loss is not turns), outcomes


@asynccontextmanager
async def _drive_to_stop(session: AcceptanceSession) -> AsyncIterator[Drive]:
    """Open the bus again for the stop of a motor that runs. Raises StopUnconfirmed where that fails."""
    async with AsyncExitStack() as stack:
        try:
            _, drive = await stack.enter_async_context(session.drive())
        except DrivebusError as error:
            raise StopUnconfirmed("drives.stop_not_sent_port", why=Text.per_language(error.text)) from error
        yield drive


@asynccontextmanager
async def _stop_afterwards(drive: Drive) -> AsyncIterator[dict[str, Any]]:
    """Send a stop at the end in every case, and add its outcome to the figures. Raises StopUnconfirmed."""
    outcomes: dict[str, Any] = {}
    async with _stop_on_error(drive):
        yield outcomes
    outcomes["stop"] = str((await drive.stop()).status)


@asynccontextmanager
async def _stop_on_error(drive: Drive) -> AsyncIterator[None]:
    """Send a stop where the step fails or is interrupted. Raises StopUnconfirmed."""
    try:
        yield
    except BaseException as error:
        await _stop_after(error, drive)
        raise


async def _stop_after(error: BaseException, drive: Drive) -> None:
    """Stop the drive; an interruption carries the outcome."""
    stopped = await drive.stop()
    if isinstance(error, AcceptanceInterrupted):
        error.stop = stopped


AcceptanceStep = Callable[[AcceptanceSession], Awaitable[StepOutcome]]
ACCEPTANCE_STEPS: Mapping[str, tuple[StepRequirement, AcceptanceStep]] = {
    "port": (StepRequirement.NOTHING, check_port),
    "exclusive": (StepRequirement.NOTHING, check_exclusive),
    "quiet": (StepRequirement.NOTHING, check_quiet),
    "reply_times": (StepRequirement.NOTHING, check_reply_times),
    "stray_replies": (StepRequirement.NOTHING, check_stray_replies),
    "parity": (StepRequirement.NOTHING, check_parity),
    "unplug": (StepRequirement.PERSON, check_unplug),
    "power": (StepRequirement.PERSON, check_power_loss),
    "run_and_stop": (StepRequirement.MOTOR, check_run_and_stop),
    "comm_loss": (StepRequirement.MOTOR, check_comm_loss),
}
"""In this order: no motor turns before all steps that only read have run."""
