"""``stop``: stops at random instants of a full bus.

A stop must be the next frame on its bus, in time, and its outcome must be true.
"""

from __future__ import annotations

import asyncio
from collections import defaultdict
from math import inf, nextafter

from drivebus.bus import Poll, estimate_bus_load
from drivebus.bus.messages import BusRequest, RequestPriority
from drivebus.drives import StopReport, stop_bus
from drivebus.errors import StopUnconfirmed
from drivebus.testing.virtual_time import running
from verification.campaign import Campaign, CampaignRun
from verification.drive_variants import DriveVariant
from verification.families.registry import variants_for
from verification.scenario.scenario import Scenario, SentRequest
from verification.scenario.stop_timer import PendingStop, StopTimer
from verification.scenario.user_command import UserCommand

COVERED = variants_for("stop")
LOAD_LINE_QUALITIES = ("bytes", "lossy,bytes", "late=0.1:0.12,bytes", "late=0.2:1.5", "clean", "noisy,bytes")
LOAD_RAMPS_S = (2.0, 0.5, 8.0)
READER_PRIORITIES = (
    (),
    (RequestPriority.PARAMETER,),
    tuple(priority for priority in RequestPriority if priority is not RequestPriority.STOP),
)
"""Priorities in which a read of each drive always waits, besides polls as fast as possible."""
LOAD_ADDRESSES = range(1, 6)


INSTANTS_PER_BUS = 50
"""Instants of one bus before the next one is built."""
STOP_SETTLING_S = 20.0
"""Time after the last instant until every commanded drive must have stopped, in seconds."""
UNCONFIRMED_ALARM_MAX_S = 2.0
"""Longest time after stop bound and ramp until a stop is confirmed or alarmed, in seconds."""
TRANSACTIONS_AT_LIMIT = 16
"""The same as a number of failed polls, if that is longer: a drive may reply as late as its limit allows."""
TRANSACTIONS_PER_OTHER_STOP = 2
"""Failed polls by which each other stop of the drive at that time prolongs it."""


class StopBus:
    """Bus under load, and the stops that are commanded on it.

    ``number`` selects line quality, ramp and reader priorities.
    """

    def __init__(self, campaign_run: CampaignRun, variant: DriveVariant, number: int) -> None:
        self.campaign_run, self.variant, self.rng = campaign_run, variant, campaign_run.rng(number)
        turn = number // len(COVERED)
        self.ramp_s, self.reader_priorities = (
            LOAD_RAMPS_S[turn % len(LOAD_RAMPS_S)],
            READER_PRIORITIES[turn % len(READER_PRIORITIES)],
        )
        line_quality = LOAD_LINE_QUALITIES[turn % len(LOAD_LINE_QUALITIES)]
        self.scenario = Scenario(
            campaign_run,
            variant,
            LOAD_ADDRESSES,
            name=f"{variant.name}/{number}",
            line_quality=line_quality,
            ramp=self.ramp_s,
            seed=number,
        )
        self.drives_to_stop: set[int] = set()
        """Drives that were not started since their last stop."""
        self.open_commands: dict[int, list[UserCommand]] = {address: [] for address in LOAD_ADDRESSES}
        """Stops in progress, by address."""
        self.most_concurrent: dict[UserCommand, int] = {}
        """Most stops of the same drive at one time, for each stop in progress."""
        self._reader_tasks: list[asyncio.Task[None]] = []
        self.stop_timer = StopTimer(self.scenario, self._on_stop_sent)
        self.undelayed_s: list[tuple[float, float]] = []
        """Seconds to the first and to the last bit of stops that neither another stop nor a late reply delayed."""
        self.worst_after_other_stops_s = 0.0
        self.worst_confirmation_s = 0.0
        self.worst_repeat_pause_s = 0.0
        """Longest time without a repetition of a pending stop, in seconds."""
        self.start_load()
        self._check_reported_bound()

    def start_load(self) -> None:
        """Start polls as fast as possible and endless reads."""
        with running(self.scenario.loop):
            for address, drive in self.scenario.drives.items():
                polls = [Poll(request, 0.0) for request, _ in drive.dialect.polls(tuple(drive.profile.signals))]
                self.scenario.bus.start_polling(address, polls, lambda answer: None)
                for priority in self.reader_priorities:
                    self._reader_tasks.append(self.scenario.loop.create_task(self._read_repeatedly(address, priority)))

    async def _read_repeatedly(self, address: int, priority: RequestPriority) -> None:
        drive = self.scenario.drives[address]
        requests = [drive.dialect.read_parameter(p) for p in drive.profile.parameters.values() if p.readable]
        while not self.scenario.bus.is_closed:
            await self.scenario.bus.transact(
                BusRequest(station=address, request=self.rng.choice(requests), priority=priority)
            )

    def wait_random(self) -> None:
        """Let a random time pass, at times exactly to the next event or just before it."""
        self.scenario.run(self.rng.uniform(0.0, 0.4))
        when = self.scenario.loop.next_at()
        if when is not None and self.rng.random() < 0.2:
            self.scenario.loop.run_until(when if self.rng.random() < 0.5 else nextafter(when, 0.0))

    def disturb_drives(self) -> None:
        """Change a drive's fault at random, and start motors at the keypad or over the bus."""
        rng, address = self.rng, self.rng.choice(LOAD_ADDRESSES)
        if rng.random() < 0.1:
            self.fault(address, rng.choice(("silent", "mute", "slow", "", "")))
        if self.open_commands[address] or self.scenario.drives[address].stop_pending:
            return
        if rng.random() < 0.5:
            self.drives_to_stop.discard(address)
            self.scenario.station(address).keypad_run(rng.choice((5.0, 20.0, 50.0)))
        elif rng.random() < 0.3:
            self.drives_to_stop.discard(address)
            self.scenario.command(address, "run", rng.choice((5.0, 20.0)))

    def fault(self, address: int, what: str) -> None:
        faults = self.scenario.station(address).faults
        faults.silent, faults.mute = what == "silent", what == "mute"
        faults.added_delay_s = self.rng.uniform(0.0, 0.15) if what == "slow" else 0.0

    def restore_line(self) -> None:
        """Restore the line and all drives, and end the reads."""
        self.scenario.simulated_bus.line_quality = "clean"
        with running(self.scenario.loop):
            for task in self._reader_tasks:
                task.cancel()
        for address in LOAD_ADDRESSES:
            self.fault(address, "")

    def _check_reported_bound(self) -> None:
        """Check that the product reports the same bound to its user."""
        polls = [
            (
                drive.dialect.station_config,
                [Poll(request, 0.0) for request, _ in drive.dialect.polls(tuple(drive.profile.signals))],
            )
            for drive in self.scenario.drives.values()
        ]
        reported_s = estimate_bus_load(polls, self.scenario.bus.settings).drives[LOAD_ADDRESSES[0]].stop_bound_s
        if abs(reported_s - self.stop_timer.bounds.stop_bound_s) > 1e-9:
            self.violation(
                f"the bus reports a bound of {reported_s:.6f} s, it is {self.stop_timer.bounds.stop_bound_s:.6f} s"
            )

    def violation(self, text: str) -> None:
        self.scenario.oracle.violation(text)

    # --- one instant -----------------------------------------------------------------------------------------------

    def run_instant(self) -> None:
        """Let a random time pass and command a stop."""
        self.wait_random()
        self._measure_pending()
        self.disturb_drives()
        self.campaign_run.count(f"commanded while {self.stop_timer.phase()}")
        if self.rng.random() < 0.25 and not any(self.open_commands.values()):
            self._stop_bus()
        else:
            self._stop_one(self.rng.choice(LOAD_ADDRESSES))

    def _measure_pending(self) -> None:
        for address, drive in self.scenario.drives.items():
            if drive.stop_pending:
                since_s = self.scenario.loop.time() - self.stop_timer.stopped_at.get(address, inf)
                self.worst_repeat_pause_s = max(self.worst_repeat_pause_s, since_s)

    def _stop_one(self, address: int) -> None:
        capabilities = self.scenario.drives[address].profile.capabilities
        method = self.rng.choice([name for name in ("stop", "coast", "quick_stop") if name in capabilities])
        wait = self.rng.random() < 0.5
        self.stop_timer.on_stop_command(address)
        user_command = self.scenario.command(address, method, wait=wait)
        self._on_command(user_command)
        assert user_command.task is not None
        user_command.task.add_done_callback(
            lambda _: self._on_stop_ended(user_command, waited=wait, bound_s=self.stop_timer.bounds.stop_bound_s)
        )

    def _on_command(self, command: UserCommand) -> None:
        commands = self.open_commands[command.address]
        commands.append(command)
        self.most_concurrent |= {each: max(self.most_concurrent.get(each, 1), len(commands)) for each in commands}
        self.drives_to_stop.add(command.address)

    def _stop_bus(self) -> None:
        scenario, broadcast_address = self.scenario, self.variant.broadcast
        can_broadcast = (
            "broadcast_stop" in scenario.drives[LOAD_ADDRESSES[0]].profile.capabilities
            and broadcast_address is not None
        )
        for address in (broadcast_address or 0,) if can_broadcast else LOAD_ADDRESSES:
            self.stop_timer.on_stop_command(address)
        commands = [scenario.oracle.on_command(address, "stop", ("all drives",)) for address in LOAD_ADDRESSES]
        for command in commands:
            self._on_command(command)
        with running(scenario.loop):
            scenario.loop.create_task(self._await_bus_stop(commands))

    async def _await_bus_stop(self, commands: list[UserCommand]) -> None:
        report: StopReport = await stop_bus(self.scenario.bus, list(self.scenario.drives.values()))
        self.scenario.bus.release_start()
        for command, (_, outcome) in zip(commands, report.outcomes, strict=True):
            command.outcome, command.error = outcome, None if outcome.succeeded else StopUnconfirmed(outcome.key)
            self.scenario.oracle.on_command_ended(command)
            self._on_stop_ended(command, waited=False, bound_s=inf)
        if report.confirmed != all(outcome.status == "confirmed" for _, outcome in report.outcomes):
            self.violation(f"I3 a bus stop with {report.outcomes} is called confirmed: {report.confirmed}")

    # --- results ---------------------------------------------------------------------------------------------------

    def _on_stop_sent(self, stop: PendingStop, sent: SentRequest) -> None:
        first_s, last_s = sent.start - stop.at, sent.end - stop.at
        if stop.foreign_traffic:
            self.campaign_run.count("held back by a late reply")
        elif stop.after_broadcast or self.variant.broadcast in stop.earlier_stops:
            self.campaign_run.count("after a broadcast")
        else:
            self.campaign_run.count(f"after {len(stop.earlier_stops)} other drives' stops")
            if not stop.earlier_stops:
                self.undelayed_s.append((first_s, last_s))
        self.worst_after_other_stops_s = max(self.worst_after_other_stops_s, last_s)

    def _on_stop_ended(self, command: UserCommand, *, waited: bool, bound_s: float) -> None:
        self.open_commands[command.address].remove(command)
        other_stops = self.most_concurrent.pop(command) - 1
        if command.outcome is None or command.ended_at is None:
            return self.violation(f"{command} ended with {command.error!r}")
        unconfirmed = isinstance(command.error, StopUnconfirmed)
        if (
            not command.outcome.succeeded
            and not unconfirmed
            and (waited or command.outcome.key != "drives.stop_answered")
        ):
            self.violation(f"{command} is {command.result_word} without an alarm")
        if command.outcome.succeeded and unconfirmed:
            self.violation(f"{command} is {command.result_word}, reported as {command.error!r}")
        if waited and unconfirmed and not self.scenario.drives[command.address].stop_pending:
            self.violation(f"{command} is {command.result_word}, and it is not repeated")
        took_s = command.ended_at - command.at
        if waited:
            self.worst_confirmation_s = max(self.worst_confirmation_s, took_s - self.ramp_s)
            over_s = took_s - bound_s - self.ramp_s
            self.campaign_run.count("alarmed late, at a drive's limit", int(over_s > UNCONFIRMED_ALARM_MAX_S))
            transactions = TRANSACTIONS_AT_LIMIT + TRANSACTIONS_PER_OTHER_STOP * other_stops
            if over_s > max(
                UNCONFIRMED_ALARM_MAX_S,
                transactions * self.stop_timer.bounds.failed_poll_s if self.variant.reports_running else 0.0,
            ):
                self.violation(f"{command} was {command.result_word} after {took_s:.3f} s")
        return None

    def finish(self) -> None:
        """Restore all drives and check that every stop has taken effect."""
        self.restore_line()
        self.scenario.run(STOP_SETTLING_S)
        self.stop_timer.finish()
        for address in sorted(self.drives_to_stop) if self.variant.reports_running else ():
            pending = self.scenario.drives[address].stop_pending
            if self.scenario.station(address).motor.energised or self.open_commands[address] or pending:
                self.violation(f"drive {address} got a stop, and its motor is on or the stop is still repeated")
        self.scenario.close()


def run(campaign_run: CampaignRun) -> None:
    found: dict[str, list[StopBus]] = defaultdict(list)
    number = 0
    while campaign_run.remaining:
        variant = COVERED[number % len(COVERED)]
        bus = StopBus(campaign_run, variant, number)
        for _ in range(min(INSTANTS_PER_BUS, campaign_run.remaining)):
            bus.run_instant()
            campaign_run.add_trials()
        bus.finish()
        found[variant.name].append(bus)
        number += 1
    campaign_run.figures.update({name: _figures(buses) for name, buses in found.items()})


def _figures(buses: list[StopBus]) -> dict[str, float]:
    """Return the figures of one variant, in milliseconds and seconds of virtual time."""
    bound_s = buses[0].stop_timer.bounds.stop_bound_s
    first = sorted(first for bus in buses for first, _ in bus.undelayed_s)
    last = sorted(last for bus in buses for _, last in bus.undelayed_s)
    shares = {f"p{share:g}": last[min(len(last) - 1, int(len(last) * share / 100))] for share in (50, 99, 99.9, 100)}
    return {
        "bound ms": round(bound_s * 1000, 3),
        **{f"last bit {name} ms": round(value * 1000, 3) for name, value in shares.items()},
        "first bit at most ms": round(first[-1] * 1000, 3),
        "worst / bound": round(last[-1] / bound_s, 4),
        "last bit after other stops, at most ms": round(max(bus.worst_after_other_stops_s for bus in buses) * 1000, 3),
        "confirmed or alarmed, less the ramp, at most s": round(max(bus.worst_confirmation_s for bus in buses), 3),
        "not repeated while pending, at most s": round(max(bus.worst_repeat_pause_s for bus in buses), 3),
    }


CAMPAIGN = Campaign(
    name="stop",
    summary={"en": "Stops at random instants.", "zh": "随机时刻的停止。"},
    unit="instants",
    evidence_for=("I3",),
    full_budget=100_000,
    ci_budget=4_000,
    run=run,
)
