"""The host does not run for a while: stopped (SIGSTOP, a frozen machine) or suspended. Drives and wire go on.

What comes meanwhile waits in the kernel. After a stop all clocks have gone on; after a suspend only the bus's has
(CLOCK_BOOTTIME), the loop's (CLOCK_MONOTONIC) stood still, and whoever slept by it sleeps on.
"""

from __future__ import annotations

import asyncio
from functools import partial
from random import Random
from typing import Any

from drivebus.bus import timer as timers
from drivebus.drives.outcome import Outcome
from drivebus.errors import StartInhibited
from drivebus.simulator.timer import LoopTimer
from drivebus.testing.virtual_time import VirtualTimer
from verification.campaign import CampaignRun
from verification.drive_variants import DriveVariant
from verification.reference.request_effects import RequestEffect
from verification.scenario.frame_rules import ClassifiedFrame
from verification.scenario.scenario import Scenario
from verification.scenario.user_command import UserCommand

SUSPEND_DURATIONS_S = (10.0, 3600.0)
"""Longer than any command may be old."""
COMMANDS_BEFORE_SLEEP_S = 0.6
"""Wishes are made within this time before the host falls asleep: some are queued then, some on the wire."""
JOG_STOP_MAX_S = 1.0
"""A jog that the sleep left turning is told to stop so soon after it: the lease of 0.5 s, a frame and its gap."""
SLEEP_RAMP_S = 1
FIRST_ADDRESS, RUNNING_ADDRESS, JOGGED_ADDRESS = 1, 2, 3


def suspend_host(stand: Scenario, seconds: float, *, suspended: bool, reader_first: bool) -> None:
    """``reader_first``: awake again, the host hears what waits before its alarm rings, else after."""
    port: Any = stand.port
    hear, held = port.receive, list[tuple[bytes, int]]()
    port.receive = lambda data, marks: held.append((data, marks))
    stand.loop.suspend(seconds, is_simulator_timer, lambda timer: suspended and not is_bus_timer(timer))
    port.receive = hear
    if held:
        later = stand.loop.call_soon if reader_first else partial(stand.loop.call_later, 0.0)
        later(hear, b"".join(data for data, _ in held), sum(marks for _, marks in held))


def is_simulator_timer(timer: VirtualTimer) -> bool:
    return isinstance(getattr(timer.callback, "__self__", None), LoopTimer)


def is_bus_timer(timer: VirtualTimer) -> bool:
    """Its alarm is set on the clock that goes on."""
    return isinstance(getattr(timer.callback, "__self__", None), timers._LoopTimer)


class HostSleepScenario:
    """One line whose host falls asleep over a run, a setpoint, a write, a jog or a stop."""

    def __init__(self, session: CampaignRun, kind: DriveVariant, name: str, chance: Random) -> None:
        self.session, self.kind, self.rng = session, kind, chance
        self.scenario = Scenario(
            session,
            kind,
            (FIRST_ADDRESS, RUNNING_ADDRESS, JOGGED_ADDRESS),
            name=name,
            seed=chance.randrange(2**31),
            ramp=SLEEP_RAMP_S,
        )
        self.frames: list[ClassifiedFrame] = []
        self.woke_at = float("inf")
        conduct: Any = self.scenario.oracle.frame_rules
        self._asked, conduct.on_request = conduct.on_request, self._on_frame

    def _on_frame(self, frame: ClassifiedFrame, *more: Any) -> None:
        self._asked(frame, *more)
        self.frames.append(frame)
        command = frame.user_command
        if (
            command is not None
            and frame.start >= self.woke_at > command.at
            and frame.effect in (RequestEffect.MOTION, RequestEffect.SETTING)
        ):
            self.scenario.oracle.violation(f"6.6 {frame.effect} for {command} was sent after the sleep")

    def play(self) -> None:
        stand, chance = self.scenario, self.rng
        for address in chance.sample((FIRST_ADDRESS, RUNNING_ADDRESS, JOGGED_ADDRESS), 2):
            stand.monitor(address)
        stand.finish(stand.command(RUNNING_ADDRESS, "run", 5.0))
        jog = self._jog() if chance.random() < 0.5 else None
        stand.run(chance.uniform(0.5, 1.0))
        commands = self._issue_commands()
        suspend_host(
            stand,
            chance.choice(SUSPEND_DURATIONS_S),
            suspended=chance.random() < 0.5,
            reader_first=chance.random() < 0.5,
        )
        self.woke_at = stand.loop.time()
        stand.oracle.trace("awake")
        turning = stand.station(JOGGED_ADDRESS).motor.energised
        if chance.random() < 0.5:
            commands.append(stand.command(RUNNING_ADDRESS, "stop"))
        if jog is not None:
            self._check_jog_ended(turning)
            commands.append(jog)
        stand.finish(*commands)
        stand.run(SLEEP_RAMP_S + 1.0)
        for user_command in commands:
            self._check_ended(user_command)
        stand.close()

    def _issue_commands(self) -> list[UserCommand]:
        """Before the sleep, at instants of their own."""
        stand, chance = self.scenario, self.rng
        stop = chance.random() < 0.3
        requested = {
            chance.uniform(0.0, COMMANDS_BEFORE_SLEEP_S): (FIRST_ADDRESS, "run", 5.0),
            chance.uniform(0.0, COMMANDS_BEFORE_SLEEP_S): (RUNNING_ADDRESS, "stop")
            if stop
            else (RUNNING_ADDRESS, "set_frequency", 3.0),
        }
        commands, began = list[UserCommand](), stand.loop.time()
        for at in sorted(requested):
            stand.run(began + at - stand.loop.time())
            commands.append(stand.command(*requested[at]))
        stand.run(began + COMMANDS_BEFORE_SLEEP_S - stand.loop.time())
        return commands

    def _jog(self) -> UserCommand | None:
        if "jog" not in self.scenario.drives[JOGGED_ADDRESS].profile.capabilities:
            return None
        command = self.scenario.command_by(self._hold_jog, JOGGED_ADDRESS, "jog")
        self.scenario.run(2.0)
        return command

    async def _hold_jog(self) -> Outcome | None:
        """A program that renews whenever it runs."""
        async with self.scenario.drives[JOGGED_ADDRESS].jog(2.0 if self.kind.model == "dzb100" else None) as lease:
            try:
                while not lease.expired:
                    await asyncio.sleep(0.1)
                    lease.renew()
            except StartInhibited:
                self.session.count("leases lost over the sleep")
        return lease.start_outcome

    def _check_jog_ended(self, turning: bool) -> None:
        self.scenario.run(JOG_STOP_MAX_S)
        stops = (one for one in self.frames if one.effect is RequestEffect.STOP and one.address == JOGGED_ADDRESS)
        if turning and not any(self.woke_at <= one.start for one in stops):
            self.scenario.oracle.violation(f"T13 a jog goes on {JOG_STOP_MAX_S} s after the sleep")

    def _check_ended(self, wish: UserCommand) -> None:
        """Stops are heard, and confirmed or alarmed; what was not sent before is told to be too old."""
        queued = not any(frame.user_command is wish for frame in self.frames)
        if not wish.is_stop and wish.method != "jog" and wish.at < self.woke_at and queued:
            self.session.count(f"asleep over an unsent {wish.method}: {wish.result_word}")
        message = ("confirmed" if self.kind.reports_running else "acknowledged", "unknown")
        deeds = self.scenario.oracle.histories[wish.address]
        if wish.is_stop and (wish.result_word not in message or deeds.stop_received_at < wish.at or deeds.on):
            motor = "on" if deeds.on else "off"
            self.scenario.oracle.violation(f"6.6 {wish} ended as {wish.result_word}, the motor is {motor}")
