"""``commands``: two users command drives over a bus that loses 10 % of the frames each way.

Replies are duplicated and delayed, the echo setting may be wrong, and drives go silent, reboot, trip, and are started
and stopped at their keypads. An episode ends with a good bus: then every stop must have been received. The oracle
compares each outcome with the motor and counts executions (I2).
"""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Any

from drivebus.simulator.motor import Trip
from verification.campaign import Campaign, CampaignRun
from verification.drive_variants import DriveVariant
from verification.families.campaigns import written_parameter
from verification.families.registry import variants_for
from verification.scenario.scenario import Scenario
from verification.scenario.user_command import UserCommand

COVERED = variants_for("commands")
PRESENT, ABSENT = (1, 2), 3
BAUD, RAMP_S = 38400, 1
COMMANDS_PER_EPISODE = 40
COMMANDS_PER_WRONG_ECHO_EPISODE = 8
"""Fewer, because with a wrong echo setting the master distrusts a station after its first failure."""
LINE_LOSS = "loss=0.1"
COMMAND_LINE_QUALITIES = (
    "",
    "",
    ",late=0.02:1",
    ",duplicate=0.02",
    ",late=0.03:0.3,duplicate=0.01",
    ",bytes",
    ",batch=8",
)
UNPACED_SHARE = 0.3
"""Share of ports that do not know when their last bit is out (TCP), so that time does not reveal an echo."""
RIGHT_ECHO_SETTINGS = (("", "off"),) * 12 + (("echo", "on"), ("echo", "detect"), ("", "detect"))
ECHO_SETTINGS = RIGHT_ECHO_SETTINGS + (("echo", "off"), ("", "on")) * 6
"""Behaviour of the adapter ("echo" or none), and the echo setting of the port."""
MEAN_PAUSE_S = 0.6
"""Mean time between two commands of one user, in seconds."""
MEAN_FAULT_PAUSE_S = 5.0
"""Mean time between two drive faults, in seconds."""
MAX_SILENCE_S = 1.5
"""Longest time that a drive is silent, in seconds; its power fails for twice that at most."""
WAITING_USER_SHARE = 0.7
"""Share of commands whose user waits for the outcome before the next command."""
IMMEDIATE_COMMAND_SHARE = 0.15
"""Share of run commands that a stop follows within ``IMMEDIATE_COMMAND_MAX_S``."""
IMMEDIATE_COMMAND_MAX_S = 0.3
SETTLING_TIME_S = 90.0
"""Time on the restored bus within which every stop must end, in seconds."""
FREQUENCIES_HZ = (2.0, 3.0, 5.0)
COMMAND_WEIGHTS = {
    "run": 6,
    "stop": 5,
    "set_frequency": 2,
    "reset_fault": 1,
    "write": 2,
    "jog": 1,
    "coast": 1,
    "quick_stop": 1,
}


class CommandEpisode:
    """Bus with two drives and an address without a drive."""

    def __init__(self, campaign_run: CampaignRun, variant: DriveVariant, number: int) -> None:
        self.campaign_run, self.variant = campaign_run, variant
        self.written_parameter = written_parameter(variant.model)
        self.rng = rng = campaign_run.rng(variant.name, number)
        self.adapter, setting = rng.choice(ECHO_SETTINGS)
        self.echoes_right = setting == "detect" or (self.adapter == "echo") is (setting == "on")
        self.scenario = scenario = Scenario(
            campaign_run,
            variant,
            PRESENT,
            name=f"{variant.name}/{number}",
            baud=BAUD,
            ramp=RAMP_S,
            echo=setting,
            seed=rng.randrange(2**31),
        )
        scenario.simulated_bus.line_quality = (
            LINE_LOSS + rng.choice(COMMAND_LINE_QUALITIES) + ("," + self.adapter if self.adapter else "")
        )
        scenario.bus.core.has_line_timing = rng.random() >= UNPACED_SHARE
        batched = self.adapter == "echo" and scenario.simulated_bus.line_quality.batch_s > 0.0
        scenario.oracle.frame_rules.echo_may_look_damaged = (
            not self.echoes_right or not scenario.bus.core.has_line_timing or batched
        )
        campaign_run.count(f"echo {self.adapter or 'no'}, set {setting}")
        self.addresses: tuple[int, ...] = (1, ABSENT, ABSENT) if not self.echoes_right else PRESENT
        if self.echoes_right and rng.random() < 0.2:
            self.addresses = (*PRESENT, ABSENT)
        if ABSENT in self.addresses:
            scenario.add_absent(ABSENT)
        capable = scenario.drives[PRESENT[0]].profile.capabilities
        self.what = [name for name in COMMAND_WEIGHTS if name in capable]
        self.commands: list[UserCommand] = []

    def play(self, most: int) -> None:
        """Run commands and faults, restore the bus, and check the final state."""
        commands = min(most, COMMANDS_PER_EPISODE if self.echoes_right else COMMANDS_PER_WRONG_ECHO_EPISODE)
        loop = self.scenario.loop
        users: dict[int, UserCommand | None] = {0: None, 1: None}
        command_at = [self._next_time(MEAN_PAUSE_S), self._next_time(MEAN_PAUSE_S)]
        fault_at = self._next_time(MEAN_FAULT_PAUSE_S)
        while len(self.commands) < commands:
            at = min(*command_at, fault_at)
            loop.run_until(at)
            if at == fault_at:
                self._disturb()
                fault_at = self._next_time(MEAN_FAULT_PAUSE_S)
                continue
            user = command_at.index(at)
            command_at[user] = self._next_time(MEAN_PAUSE_S)
            last = users[user]
            if last is None or last.is_ended:
                command = self._random_command(self.rng.choice(self.addresses))
                users[user] = command if self.rng.random() < WAITING_USER_SHARE else None
        self._restore_line()
        self._check_final_state()
        self._check_out_of_range()
        self.scenario.close()

    def _next_time(self, mean_s: float) -> float:
        return self.scenario.loop.time() + self.rng.expovariate(1.0 / mean_s)

    # --- commands ------------------------------------------------------------------------------------------------

    def _random_command(self, address: int) -> UserCommand:
        what = self.rng.choices(self.what, [COMMAND_WEIGHTS[name] for name in self.what])[0]
        command = self._issue_command(address, what)
        if what == "run" and self.rng.random() < IMMEDIATE_COMMAND_SHARE:
            self.scenario.run(self.rng.choice((0.0, self.rng.uniform(0.0, IMMEDIATE_COMMAND_MAX_S))))
            self._issue_command(address, "stop")
        return command

    def _issue_command(self, address: int, what: str) -> UserCommand:
        scenario, rng = self.scenario, self.rng
        hz = rng.choice(FREQUENCIES_HZ)
        match what:
            case "run":
                backward = rng.random() < 0.2
                user_command = scenario.command(address, what, hz, *(("reverse",) if backward else ()))
            case "set_frequency":
                user_command = scenario.command(address, what, hz)
            case "write":
                parameter = self.written_parameter
                value = {parameter.notation: float(rng.randrange(1, 20))}
                user_command = scenario.command(address, what, value, save=parameter.saved)
            case "jog":
                user_command = scenario.command_by(partial(self._jog, address, rng.uniform(0.0, 1.0)), address, what)
            case "reset_fault":
                user_command = scenario.command(address, what)
            case _:
                user_command = scenario.command(address, what, wait=rng.random() < 0.7)
        self.commands.append(user_command)
        assert user_command.task is not None
        user_command.task.add_done_callback(lambda _: self._on_command_ended(user_command))
        return user_command

    async def _jog(self, address: int, seconds: float) -> Any:
        """Jog without renewals, at times longer than the lease."""
        hz = 2.0 if self.variant.model == "dzb100" else None
        async with self.scenario.drives[address].jog(hz) as lease:
            await asyncio.sleep(seconds)
        return lease.start_outcome

    def _on_command_ended(self, command: UserCommand) -> None:
        """Check that an unconfirmed stop is repeated and that a written value is in the drive."""
        drive = self.scenario.drives[command.address]
        newer = any(other.is_motion and other.at >= command.at for other in self._commands_of(command.address))
        if command.is_stop and command.result_word == "unknown" and not drive.stop_pending and not newer:
            others = [
                other for other in self._commands_of(command.address) if other.is_stop and other.number > command.number
            ]
            if not others:
                self.scenario.oracle.violation(f"lost stop: {command} was given up")
        history = self.scenario.oracle.histories.get(command.address)
        if command.method == "write" and history is not None and history.is_undisturbed(command):
            self._check_written(command, history.station)

    def _check_written(self, command: UserCommand, station: Any) -> None:
        parameter = self.written_parameter
        (wanted,) = command.arguments[0].values()
        there = station.memory[parameter.memory_key] == round(wanted * parameter.counts_per_unit)
        if (command.succeeded and not there) or (command.result_word == "failed" and there):
            self.scenario.oracle.violation(
                f"{command}: {command.result_word}, and the drive holds {station.memory[parameter.memory_key]}"
            )

    def _commands_of(self, address: int) -> list[UserCommand]:
        return [command for command in self.commands if command.address == address]

    # --- drive faults --------------------------------------------------------------------------------------------

    def _disturb(self) -> None:
        rng = self.rng
        station = self.scenario.station(rng.choice(PRESENT))
        match rng.randrange(7):
            case 0:
                station.faults.silent = True
                self.scenario.loop.call_later(rng.uniform(0.0, MAX_SILENCE_S), self._restore_station, station)
            case 1:
                station.faults.mute = True
                self.scenario.loop.call_later(rng.uniform(0.0, MAX_SILENCE_S), self._restore_station, station)
            case 2:
                station.power_cycle(rng.uniform(0.2, 2 * MAX_SILENCE_S))
            case 3:
                station.trip(rng.choice(list(Trip)))
            case 4:
                station.keypad_run(rng.choice(FREQUENCIES_HZ))
            case _:
                station.keypad_stop()

    def _restore_station(self, station: Any) -> None:
        station.faults.silent = station.faults.mute = False

    # --- final state ---------------------------------------------------------------------------------------------

    def _restore_line(self) -> None:
        """Restore the line and its settings, and let all commands end."""
        scenario, loop = self.scenario, self.scenario.loop
        right = self.adapter if self.echoes_right else {"echo": "", "": "echo"}[self.adapter]
        scenario.simulated_bus.line_quality = f"batch={1000 * scenario.simulated_bus.line_quality.batch_s:g}" + (
            "," + right if right else ""
        )
        for address in PRESENT:
            self._restore_station(scenario.station(address))
        end = loop.time() + SETTLING_TIME_S
        while loop.time() < end and not self._all_settled():
            scenario.run(1.0)
        scenario.finish(*(command for command in self.commands if command.address != ABSENT), within_s=1.0)
        scenario.run(RAMP_S)

    def _all_settled(self) -> bool:
        pending = any(self.scenario.drives[address].stop_pending for address in PRESENT)
        return not pending and all(command.is_ended for command in self.commands if command.address != ABSENT)

    def _check_final_state(self) -> None:
        """Check that no stop is lost."""
        for address in sorted({*self.addresses}):
            stops = [command for command in self._commands_of(address) if command.is_stop]
            if stops:
                self._check_last_stop(stops[-1], pending=self.scenario.drives[address].stop_pending)

    def _check_last_stop(self, stop: UserCommand, *, pending: bool) -> None:
        newer = [
            command for command in self._commands_of(stop.address) if command.is_motion and command.number > stop.number
        ]
        violation = self.scenario.oracle.violation
        history = self.scenario.oracle.histories.get(stop.address)
        if history is None:
            if not newer and stop.is_ended and not pending:
                violation(f"absent drive: {stop} was given up")
            return
        self.scenario.station(stop.address)  # computes the motor up to now
        overruled = any(command.frames_sent for command in newer)
        if pending and not overruled:
            violation(f"lost stop: {stop} is not done {SETTLING_TIME_S} s after the bus was restored")
        if history.stop_received_at < stop.at and not overruled and not self.variant.reports_running:
            violation(f"lost stop: {stop} ended as {stop.result_word}, and the drive never received it")
        # a run is also sent as a new frequency to a motor that ran
        run_since = any(command.method == "run" and command.frames_sent for command in newer)
        by_another = history.on_at > stop.at and (
            history.started_for is None or history.started_for.number > stop.number
        )
        if history.on and not run_since and not by_another:
            violation(f"lost stop: {stop} ended as {stop.result_word}, and the motor is on")
        self.campaign_run.count("stops checked at the end")

    def _check_out_of_range(self) -> None:
        """Check that values out of range are rejected before anything is sent (I7)."""
        parameter = self.written_parameter
        too_fast, address = self.variant.maximum_hz + 0.1, PRESENT[0]
        for user_command in (
            self.scenario.command(address, "run", too_fast),
            self.scenario.command(address, "set_frequency", too_fast),
            self.scenario.command(address, "write", {parameter.notation: 1e6}, save=parameter.saved),
        ):
            self.scenario.finish(user_command)
            if user_command.result_word != "LimitError" or user_command.frames_sent:
                self.scenario.oracle.violation(
                    f"I7 {user_command}: {user_command.result_word}, and {user_command.frames_sent} frames left for it"
                )


def run(campaign_run: CampaignRun) -> None:
    """Run episodes, the variants in turn."""
    number = 0
    while campaign_run.remaining:
        episode = CommandEpisode(campaign_run, COVERED[number % len(COVERED)], number)
        episode.play(campaign_run.remaining)
        campaign_run.count("requests", episode.scenario.oracle.request_count)
        campaign_run.count("to absent drives", sum(command.address == ABSENT for command in episode.commands))
        campaign_run.count("motors switched on", sum(command.executions for command in episode.commands))
        campaign_run.add_trials(len(episode.commands))
        number += 1


CAMPAIGN = Campaign(
    name="commands",
    summary={"en": "Commands on a lossy line.", "zh": "丢帧线路上的命令。"},
    unit="commands",
    evidence_for=(
        "I1",
        "I2",
        "I3",
    ),
    full_budget=10**6,
    ci_budget=1500,
    run=run,
)
