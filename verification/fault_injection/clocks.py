"""Clock faults: a wall clock that jumps, a bus clock that stalls, kernel timers that run out, a host that sleeps."""

from __future__ import annotations

import ast
import asyncio
import errno
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

from drivebus import clock as product_clock
from drivebus.bus import Bus
from drivebus.bus import timer as timers
from drivebus.drives import Drive, MemoryStore
from drivebus.drives.outcome import Outcome
from drivebus.errors import DrivebusError, StartInhibited
from drivebus.ports import open_port
from drivebus.simulator import timer
from drivebus.simulator.timer import LoopTimer
from drivebus.testing.virtual_time import VirtualTimer, running
from verification.campaign import CampaignRun
from verification.drive_variants import DriveVariant
from verification.families.modbus.facts import VC660
from verification.fault_injection.faulty_port import PortFailureScenario
from verification.reference.effects import RequestEffect
from verification.scenario.rules import ClassifiedFrame
from verification.scenario.scenario import Scenario
from verification.scenario.user_command import SUCCESS_WORDS, UserCommand

# --- wall clock -------------------------------------------------------------------------------------------------------

YEAR_S = 365.2425 * 86400
CLOCK_JUMPS_S = {
    "+1 s": 1.0,
    "-1 s": -1.0,
    "+1 h": 3600.0,
    "-1 h": -3600.0,
    "+10 y": 10 * YEAR_S,
    "-10 y": -10 * YEAR_S,
    "summer time begins": 0.0,
    "summer time ends": 0.0,
}
"""Seconds by which each jump moves UTC; summer time moves only the local hour."""
TIME_ZONES = {"summer time begins": "CEST-2", "summer time ends": "CET-1"}
WALL_CLOCK_FUNCTIONS = {
    "time.time",
    "time.time_ns",
    "time.localtime",
    "time.gmtime",
    "time.ctime",
    "time.asctime",
    "time.strftime",
    "time.CLOCK_REALTIME",
    "datetime.now",
    "datetime.utcnow",
    "datetime.today",
    "date.today",
}
"""Functions of Python that read a wall clock, by their last two names."""


class JumpingWallClock:
    """Wall clock that advances from ``begin`` (UTC) with a monotonic clock, and jumps on demand."""

    def __init__(self, begin: datetime, elapsed: Callable[[], float]) -> None:
        self._begin, self._monotonic, self._offset = begin, elapsed, timedelta()

    def now(self) -> datetime:
        return self._begin + self._offset + timedelta(seconds=self._monotonic())

    def jump(self, name: str) -> None:
        """Apply one of CLOCK_JUMPS_S."""
        self._offset += timedelta(seconds=CLOCK_JUMPS_S[name])
        if name in TIME_ZONES:
            _set_zone(TIME_ZONES[name])


def before_midnight(seconds: float) -> datetime:
    """Return a time before a midnight of UTC, where a jump can lead to another day."""
    return datetime(2026, 3, 29, tzinfo=UTC) - timedelta(seconds=seconds)


@contextmanager
def installed_clock(clock: JumpingWallClock) -> Iterator[JumpingWallClock]:
    """Replace the product's wall clock and ``time.time`` by this clock within the context."""
    functions: dict[tuple[Any, str], Callable[[], Any]] = {
        (product_clock, "wall_clock"): clock.now,
        (time, "time"): lambda: clock.now().timestamp(),
        (time, "time_ns"): lambda: int(clock.now().timestamp() * 1e9),
    }
    before = {place: getattr(*place) for place in functions}
    zone = os.environ.get("TZ")
    _replace_functions(functions)
    _set_zone(TIME_ZONES["summer time ends"])
    try:
        yield clock
    finally:
        _replace_functions(before)
        _set_zone(zone)


def _replace_functions(functions: dict[tuple[Any, str], Callable[[], Any]]) -> None:
    for (module, name), function in functions.items():
        setattr(module, name, function)


def _set_zone(name: str | None) -> None:
    if name is None:
        os.environ.pop("TZ", None)
    else:
        os.environ["TZ"] = name
    if hasattr(time, "tzset"):  # Windows has none
        time.tzset()


def clock_readers(package: Path) -> set[tuple[str, str]]:
    """Return (file, function) of every read of a wall clock in the sources of a package."""
    files = {path.relative_to(package): path for path in package.rglob("*.py")}
    return {
        (name.as_posix(), read)
        for name, path in files.items()
        for read in _clock_reads(ast.parse(path.read_text(encoding="utf-8")))
    }


def _clock_reads(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            found = [".".join(ast.unparse(node).split(".")[-2:])]
        elif isinstance(node, ast.ImportFrom) and node.module == "time":
            found = [f"time.{alias.name}" for alias in node.names]
        else:
            continue
        yield from (name for name in found if name in WALL_CLOCK_FUNCTIONS)


# --- kernel timers and the bus clock ----------------------------------------------------------------------------------

TIMER_TEST_LINK = "sim://vc660@1?baud=38400&ramp=1&echo=off"
CLOCK_STALL_S = 3.0
"""Duration of a stall, in seconds."""
MAX_CLOCK_READS = 50_000
"""Largest number of readings during a stall; more mean a busy loop."""
JUDGED_TEXTS = ("after a failure", "I8", "has no end")
"""Violations that count although the bus gets a wrong time; violations of gaps and ages do not."""


class ScarceTimers:
    """Kernel timers and selector registrations of which the ``nth`` fails."""

    def __init__(self, nth: int) -> None:
        self.nth, self.calls = nth, 0

    def of(self, plain: Callable[..., Any]) -> Callable[..., Any]:
        def taken(*arguments: Any) -> Any:
            self.calls += 1
            if self.calls == self.nth:
                raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
            return plain(*arguments)

        return taken


def fail_kernel_timers(campaign_run: CampaignRun, nth: int) -> int:
    """Run a bus briefly on a real asyncio loop; return the number of timers and registrations."""
    scarce, before = ScarceTimers(nth), _open_files()
    places: tuple[Any, ...] = (timers, timer)
    plain = [module.TimerFd for module in places]
    for module, made in zip(places, plain, strict=True):
        module.TimerFd = scarce.of(made)
    try:
        word = asyncio.run(asyncio.wait_for(_run_briefly(scarce), 20.0))
        if word not in SUCCESS_WORDS:
            campaign_run.violation(f"without timer {nth} a stop ended as {word}")
    except Exception as error:
        campaign_run.violation(f"without timer {nth}: {type(error).__name__}: {error}")
    finally:
        for module, made in zip(places, plain, strict=True):
            module.TimerFd = made
    if _open_files() != before:
        campaign_run.violation(f"without timer {nth} {_open_files() - before} files stayed open")
    return scarce.calls


async def _run_briefly(scarce: ScarceTimers) -> str:
    loop: Any = asyncio.get_running_loop()
    loop.add_reader = scarce.of(loop.add_reader)
    async with Bus(open_port(TIMER_TEST_LINK)) as bus:
        drive = Drive(bus, "vc660", 1, store=MemoryStore())
        await drive.status()
        await drive.run(5.0)
        return str((await drive.stop()).status)


def _open_files() -> int:
    """Return the number of open files; 0 where the system does not report it."""
    listed = Path("/proc/self/fd")
    return len(list(listed.iterdir())) if listed.exists() else 0


class StalledClock:
    """Clock that stalls for CLOCK_STALL_S from its ``nth`` reading on."""

    def __init__(self, now: Callable[[], float], nth: int) -> None:
        self._now, self.nth, self.reads, self._stuck_at = now, nth, 0, 0.0
        self.stalled_reads = 0
        """Readings during the stall."""

    def __call__(self) -> float:
        self.reads += 1
        now = self._now()
        if self.reads == self.nth:
            self._stuck_at = now
        if (
            not self.reads >= self.nth > 0
            or now >= self._stuck_at + CLOCK_STALL_S
            or self.stalled_reads > MAX_CLOCK_READS
        ):
            return now
        self.stalled_reads += 1
        return self._stuck_at


class UntimedPortScenario(PortFailureScenario):
    """Scenario whose readings are not checked by age."""

    def monitor(self, address: int) -> None:
        with running(self.loop):
            self.scenario.drives[address].monitor(period_s=0.5)


def stall_clock(campaign_run: CampaignRun, nth: int) -> int:
    """Stall the bus clock at its ``nth`` reading; return the number of readings."""
    own = CampaignRun(campaign="failures", seed=campaign_run.seed, budget=1)
    trial = UntimedPortScenario(own, VC660, f"clock/{nth}")
    clock = StalledClock(trial.loop.time, nth)
    trial.scenario.bus._clock = clock
    trial.scenario.oracle.on_reply_accepted = lambda answer: None  # type: ignore[method-assign]
    try:
        trial.run()
        trial.scenario.run(CLOCK_STALL_S)
        reads = clock.reads
        if clock.stalled_reads > MAX_CLOCK_READS:
            trial.violation("a stalled clock causes a busy loop")
        if not trial.check_works():
            trial.violation("the bus does not work again")
        trial.scenario.close()
    except DrivebusError as error:
        reads = clock.reads
        trial.violation(f"{type(error).__name__} escaped: {error}")
    for text in own.violations:
        if any(rule in text for rule in JUDGED_TEXTS):
            campaign_run.violation(text)
    return reads


# --- host sleep -------------------------------------------------------------------------------------------------------

SUSPEND_DURATIONS_S = (10.0, 3600.0)
"""Durations of a sleep, in seconds: longer than any command is valid."""
COMMANDS_BEFORE_SLEEP_S = 0.6
"""Time before the sleep in which commands are given, in seconds: some are then queued, some on the wire."""
JOG_STOP_MAX_S = 1.0
"""Longest time from the end of the sleep to the stop of a jog, in seconds: the lease of 0.5 s, a frame and its gap."""
SLEEP_RAMP_S = 1
FIRST_ADDRESS, RUNNING_ADDRESS, JOGGED_ADDRESS = 1, 2, 3


def suspend_host(scenario: Scenario, seconds: float, *, suspended: bool, reader_first: bool) -> None:
    """Stop the host for some seconds; drives and wire continue, and received bytes wait in the kernel.

    ``suspended``: the loop's clock stands still (suspend), else all clocks continue (SIGSTOP). ``reader_first``: the
    waiting bytes are read before the timers fire.
    """
    port: Any = scenario.port
    receive, held = port.receive, list[tuple[bytes, int]]()
    port.receive = lambda data, line_errors: held.append((data, line_errors))
    scenario.loop.suspend(seconds, is_simulator_timer, lambda timer: suspended and not is_bus_timer(timer))
    port.receive = receive
    if held:
        later = scenario.loop.call_soon if reader_first else partial(scenario.loop.call_later, 0.0)
        later(receive, b"".join(data for data, _ in held), sum(line_errors for _, line_errors in held))


def is_simulator_timer(timer: VirtualTimer) -> bool:
    return isinstance(getattr(timer.callback, "__self__", None), LoopTimer)


def is_bus_timer(timer: VirtualTimer) -> bool:
    """Return whether this is the bus's timer, whose clock continues during a suspend."""
    return isinstance(getattr(timer.callback, "__self__", None), timers.EventLoopTimer)


class HostSleepScenario:
    """Bus whose host sleeps during a run, a setpoint, a jog or a stop."""

    def __init__(self, campaign_run: CampaignRun, variant: DriveVariant, name: str, rng: Random) -> None:
        self.campaign_run, self.variant, self.rng = campaign_run, variant, rng
        self.scenario = Scenario(
            campaign_run,
            variant,
            (FIRST_ADDRESS, RUNNING_ADDRESS, JOGGED_ADDRESS),
            name=name,
            seed=rng.randrange(2**31),
            ramp=SLEEP_RAMP_S,
        )
        self.frames: list[ClassifiedFrame] = []
        self.woke_at = float("inf")
        frame_rules: Any = self.scenario.oracle.frame_rules
        self._check_request, frame_rules.on_request = frame_rules.on_request, self._on_frame

    def _on_frame(self, frame: ClassifiedFrame, last_received_at: float, *, answered: bool) -> None:
        self._check_request(frame, last_received_at, answered=answered)
        self.frames.append(frame)
        command = frame.user_command
        if (
            command is not None
            and frame.start >= self.woke_at > command.at
            and frame.effect in (RequestEffect.MOTION, RequestEffect.SETTING)
        ):
            self.scenario.oracle.violation(f"{frame.effect} for {command} was sent after the sleep")

    def play(self) -> None:
        scenario, rng = self.scenario, self.rng
        for address in rng.sample((FIRST_ADDRESS, RUNNING_ADDRESS, JOGGED_ADDRESS), 2):
            scenario.monitor(address)
        scenario.finish(scenario.command(RUNNING_ADDRESS, "run", 5.0))
        jog = self._jog() if rng.random() < 0.5 else None
        scenario.run(rng.uniform(0.5, 1.0))
        commands = self._issue_commands()
        suspend_host(
            scenario,
            rng.choice(SUSPEND_DURATIONS_S),
            suspended=rng.random() < 0.5,
            reader_first=rng.random() < 0.5,
        )
        self.woke_at = scenario.loop.time()
        scenario.oracle.trace("awake")
        turning = scenario.station(JOGGED_ADDRESS).motor.energised
        if rng.random() < 0.5:
            commands.append(scenario.command(RUNNING_ADDRESS, "stop"))
        if jog is not None:
            self._check_jog_ended(turning=turning)
            commands.append(jog)
        scenario.finish(*commands)
        scenario.run(SLEEP_RAMP_S + 1.0)
        for user_command in commands:
            self._check_ended(user_command)
        scenario.close()

    def _issue_commands(self) -> list[UserCommand]:
        """Give commands at random instants before the sleep."""
        scenario, rng = self.scenario, self.rng
        stop = rng.random() < 0.3
        planned = {
            rng.uniform(0.0, COMMANDS_BEFORE_SLEEP_S): (FIRST_ADDRESS, "run", 5.0),
            rng.uniform(0.0, COMMANDS_BEFORE_SLEEP_S): (RUNNING_ADDRESS, "stop")
            if stop
            else (RUNNING_ADDRESS, "set_frequency", 3.0),
        }
        commands, began = list[UserCommand](), scenario.loop.time()
        for at in sorted(planned):
            scenario.run(began + at - scenario.loop.time())
            commands.append(scenario.command(*planned[at]))
        scenario.run(began + COMMANDS_BEFORE_SLEEP_S - scenario.loop.time())
        return commands

    def _jog(self) -> UserCommand | None:
        if "jog" not in self.scenario.drives[JOGGED_ADDRESS].profile.capabilities:
            return None
        command = self.scenario.command_by(self._hold_jog, JOGGED_ADDRESS, "jog")
        self.scenario.run(2.0)
        return command

    async def _hold_jog(self) -> Outcome | None:
        """Jog and renew the lease until it expires."""
        async with self.scenario.drives[JOGGED_ADDRESS].jog(2.0 if self.variant.model == "dzb100" else None) as lease:
            try:
                while not lease.expired:
                    await asyncio.sleep(0.1)
                    lease.renew()
            except StartInhibited:
                self.campaign_run.count("leases lost over the sleep")
        return lease.start_outcome

    def _check_jog_ended(self, *, turning: bool) -> None:
        self.scenario.run(JOG_STOP_MAX_S)
        stops = (
            frame for frame in self.frames if frame.effect is RequestEffect.STOP and frame.address == JOGGED_ADDRESS
        )
        if turning and not any(self.woke_at <= stop.start for stop in stops):
            self.scenario.oracle.violation(f"T13 a jog goes on {JOG_STOP_MAX_S} s after the sleep")

    def _check_ended(self, command: UserCommand) -> None:
        """Check that stops were received and confirmed or reported, and count commands that were queued during the
        sleep."""
        queued = not any(frame.user_command is command for frame in self.frames)
        if not command.is_stop and command.method != "jog" and command.at < self.woke_at and queued:
            self.campaign_run.count(f"asleep over an unsent {command.method}: {command.result_word}")
        message = ("confirmed" if self.variant.reports_running else "acknowledged", "unknown")
        history = self.scenario.oracle.histories[command.address]
        if command.is_stop and (
            command.result_word not in message or history.stop_received_at < command.at or history.on
        ):
            motor = "on" if history.on else "off"
            self.scenario.oracle.violation(f"{command} ended as {command.result_word}, the motor is {motor}")
