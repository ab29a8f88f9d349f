"""``replug``: the adapter is unplugged at random instants and replugged under another name.

Polling must resume soon, and no command from before may act afterwards.
"""

from __future__ import annotations

from collections import Counter
from math import inf
from typing import Any

from drivebus.testing.virtual_time import running
from drivebus.values import Quality
from verification.campaign import Campaign, CampaignRun
from verification.drive_variants import DriveVariant
from verification.families.registry import variants_for
from verification.fault_injection.usb_adapter import UsbAdapter, UsbHost, reopen_ports
from verification.scenario.scenario import Scenario, SentRequest
from verification.scenario.user_command import UserCommand

COVERED = variants_for("replug")
HOTPLUG_LINE_QUALITIES = ("bytes", "clean", "bytes", "batch=16")
HOTPLUG_ADDRESSES = range(1, 4)
HOTPLUG_SETTLING_S = 2.0  # until every drive was polled for the first time
UNPLUGS_PER_BUS = 20
"""Unplugs of one bus before the next one is built."""
LOSS_DETECTED_MAX_S = 1.0
FIRST_POLL_MAX_S = 2.0
"""Longest time until the first drive is polled again, in seconds; every drive within twice that, plus the quarantine of
the DF800."""
STEP_S = 0.005
REJECTED_MAX_S = 0.5
"""Longest time until a command without a port is rejected, in seconds."""
REOPENINGS, CI_REOPENINGS = 400, 50
REPLUG_SETTLING_S = 6.0
"""Time for all interrupted operations to end, in seconds."""


class ReplugBus:
    """Three polled drives behind one adapter, which the bus finds by its identity, and a user who commands them."""

    def __init__(self, campaign_run: CampaignRun, variant: DriveVariant, number: int) -> None:
        self.campaign_run, self.variant, self.rng = campaign_run, variant, campaign_run.rng(number)
        machine = UsbHost(campaign_run.rng("machine", number), "FT4ZK1X9" if number % 3 else None)
        self.adapter: Any = None
        self.scenario = Scenario(
            campaign_run,
            variant,
            HOTPLUG_ADDRESSES,
            name=f"{variant.name}/{number}",
            line_quality=HOTPLUG_LINE_QUALITIES[number % len(HOTPLUG_LINE_QUALITIES)],
            seed=number,
            wrap_port=lambda port: self._attach_adapter(port, machine),
        )
        for address in HOTPLUG_ADDRESSES:
            self.scenario.monitor(address)
        self.requests: list[SentRequest] = []
        self.scenario.observe_wire(self._on_transmission)
        self.scenario.run(HOTPLUG_SETTLING_S)
        self.initial_handles = self._open_handles()
        self.detected_s: list[float] = []
        self.first_s: list[float] = []
        """Seconds from each replug until the first drive was polled."""
        self.back_s: list[float] = []
        """Seconds from each replug until every drive was polled."""

    def _attach_adapter(self, port: Any, machine: UsbHost) -> UsbAdapter:
        adapter = self.adapter = UsbAdapter(port, machine)
        return adapter

    def _on_transmission(self, _: Any, request: SentRequest | None) -> None:
        if request is not None:
            self.requests.append(request)

    @property
    def now(self) -> float:
        return self.scenario.loop.time()

    def violation(self, text: str) -> None:
        self.scenario.oracle.violation(text)

    def phase(self) -> str:
        transaction = self.scenario.bus.core.transaction
        if transaction is None:
            return "idle or in a gap"
        if self.now < transaction.tx_end_at:
            return "sending"
        return "receiving a reply" if transaction.received_count else "waiting for a reply"

    def newest_reading_at(self, address: int) -> float:
        """Return the time of the newest value that is not bad (values of the DF800 are uncertain, as its scales are
        unpublished)."""
        readings = self.scenario.monitors[address].status().readings.values()
        return max(
            (reading.source_time or 0.0 for reading in readings if reading.quality is not Quality.BAD), default=0.0
        )

    def _open_handles(self) -> dict[str, int]:
        """Return the numbers of open ports, running tasks and queued requests."""
        loop, drives = self.scenario.loop, self.scenario.drives.values()
        return {
            "ports": self.adapter.opened - self.adapter.closed,
            "hosts": len(self.scenario.simulated_bus.masters),
            "tasks": len(loop.tasks) - sum(drive.stop_pending for drive in drives),
            "queued": len(self.scenario.bus.core.scheduler),
            "polls": len(self.scenario.bus.core.scheduler.poll_schedule.heap),
        }

    def check_handles(self) -> None:
        """Check that the numbers are those before the first unplug."""
        found = self._open_handles()
        for what, count in self.initial_handles.items():
            if what != "queued" and found[what] != count:
                self.violation(f"{found[what]} {what} after a replug, {count} before")

    # --- one unplug ------------------------------------------------------------------------------------------------

    def unplug(self) -> None:
        """Unplug the adapter during operation, give commands meanwhile, replug it, and check the result."""
        commands = self._issue_commands()
        self.scenario.run(self.rng.uniform(0.0, 1.5))
        self.campaign_run.count(f"unplugged while {self.phase()}")
        motors = self._motor_starts()
        self._pull()
        refused = self._check_while_unplugged()
        self._check_return()
        self._poll_delay_s()
        self.scenario.finish(*commands, *refused)
        self._check_no_late_start(motors, [*commands, *refused])
        self.check_handles()

    def _issue_commands(self) -> list[UserCommand]:
        """Give commands that are in progress when the adapter is unplugged."""
        commands = []
        for address in HOTPLUG_ADDRESSES:
            if self.rng.random() < 0.5:
                what = self.rng.choice(("run", "stop", "set_frequency", "run"))
                arguments = () if what == "stop" else (self.rng.choice((5.0, 10.0, 20.0)),)
                commands.append(self.scenario.command(address, what, *arguments))
        return commands

    def _motor_starts(self) -> Counter[int]:
        """Return the number of starts of each motor."""
        return Counter({address: self.scenario.station(address).motor.starts for address in HOTPLUG_ADDRESSES})

    def _pull(self) -> None:
        hangs_up = self.rng.random() < 0.7
        self.campaign_run.count("reported by a hang-up" if hangs_up else "reported by a failed write")
        at = self.now
        self.scenario.oracle.on_unplugged()
        with running(self.scenario.loop):
            self.adapter.unplug(hangs_up=hangs_up)
        while self.scenario.bus.is_open and self.now < at + 2 * LOSS_DETECTED_MAX_S:
            self.scenario.loop.run_until(self.now + STEP_S)
        self.scenario.oracle.on_unplugged()  # commands given until the loss was detected are older than the port, too
        self.detected_s.append(self.now - at)
        if self.scenario.bus.is_open:
            self.violation("the port is lost, and the bus has not detected it")

    def _check_while_unplugged(self) -> list[UserCommand]:
        """Check that nothing is sent and that commands are rejected soon."""
        sent = len(self.requests)
        commands = []
        self.scenario.run(self.rng.uniform(0.0, 2.0))
        if self.rng.random() < 0.5:
            commands = [self.scenario.command(self.rng.choice(HOTPLUG_ADDRESSES), "run", 10.0)]
            self.scenario.run(REJECTED_MAX_S)
            if not commands[0].is_ended:
                self.violation(f"{commands[0]} was not rejected within {REJECTED_MAX_S} s")
        self.scenario.run(self.rng.uniform(0.0, 2.0))
        if len(self.requests) != sent:
            self.violation("a request was sent without a port")
        return commands

    def _check_return(self) -> None:
        with running(self.scenario.loop):
            name = self.adapter.replug()
        self.scenario.oracle.trace(f"plugged in again as {name}")
        self.scenario.oracle.frame_rules.on_port_lost(self.now)  # nothing older than this may act

    def _poll_delay_s(self) -> None:
        """Measure the time until the first and until every drive has a value from after the replug."""
        at, since = self.now, {address: self.newest_reading_at(address) for address in HOTPLUG_ADDRESSES}
        waiting, first_s = set(HOTPLUG_ADDRESSES), inf
        within_s = 2 * FIRST_POLL_MAX_S + self.variant.identical_probe_quarantine_s
        while waiting and self.now < at + within_s:
            self.scenario.loop.run_until(self.now + STEP_S)
            waiting = {address for address in waiting if self.newest_reading_at(address) <= max(since[address], at)}
            if len(waiting) < len(HOTPLUG_ADDRESSES):
                first_s = min(first_s, self.now - at)
        self.first_s.append(first_s)
        self.back_s.append(self.now - at)
        self.campaign_run.count("every drive polled again: later than 2 s", int(self.back_s[-1] > FIRST_POLL_MAX_S))
        if first_s > FIRST_POLL_MAX_S or waiting:
            self.violation(
                f"first polled again {first_s:.3f} s after the return, never within {within_s:g} s: {waiting or '-'}"
            )
        name = self.adapter.opened_names[-1]
        if name != self.adapter.machine.name:
            self.violation(f"opened the wrong adapter {name} instead of {self.adapter.machine.name}")

    def _check_no_late_start(self, starts: Counter[int], commands: list[UserCommand]) -> None:
        """Check that no command from before the replug starts a motor after it."""
        for address, count in self._motor_starts().items():
            moved = sum(user_command.executions for user_command in commands if user_command.address == address)
            if count - starts[address] > moved:
                self.violation(f"I10 the motor of {address} was started without a command")
        self.scenario.finish(*(self.scenario.command(address, "stop") for address in HOTPLUG_ADDRESSES))
        self.scenario.run(REPLUG_SETTLING_S)


def run(campaign_run: CampaignRun) -> None:
    buses: list[ReplugBus] = []
    number = 0
    while campaign_run.remaining:
        bus = ReplugBus(campaign_run, COVERED[number % len(COVERED)], number)
        for _ in range(min(UNPLUGS_PER_BUS, campaign_run.remaining)):
            bus.unplug()
            campaign_run.add_trials()
        bus.scenario.close()
        buses.append(bus)
        number += 1
    _figures(campaign_run, buses)
    _reopen_real_ports(campaign_run)


def _figures(campaign_run: CampaignRun, buses: list[ReplugBus]) -> None:
    detected = sorted(seconds for bus in buses for seconds in bus.detected_s)
    for variant in COVERED:
        back = sorted(seconds for bus in buses if bus.variant is variant for seconds in bus.back_s)
        if back:
            campaign_run.figures[variant.name] = {
                "polled again at most s": round(
                    max(seconds for bus in buses if bus.variant is variant for seconds in bus.first_s), 3
                ),
                "every drive polled again p50 s": round(back[len(back) // 2], 3),
                "every drive polled again at most s": round(back[-1], 3),
            }
    campaign_run.figures["noticed at most s"] = round(detected[-1], 3)
    campaign_run.figures["names of the adapter"] = len({name for bus in buses for name in bus.adapter.opened_names})


def _reopen_real_ports(campaign_run: CampaignRun) -> None:
    """Repeat the replug with real file descriptors."""
    times = REOPENINGS if campaign_run.budget > CAMPAIGN.ci_budget else CI_REOPENINGS
    found = reopen_ports(times)
    campaign_run.figures["real reopenings"] = times
    campaign_run.figures["descriptors more after them"] = found["descriptors"]
    campaign_run.machine["a hang-up of a real pty noticed at most s"] = round(found["slowest_s"], 4)
    if found["descriptors"] > 0 or found["names"] < 2:
        campaign_run.violation(f"{found['descriptors']} descriptors stay open after {times} real reopenings")


CAMPAIGN = Campaign(
    name="replug",
    summary={"en": "The adapter unplugged and replugged.", "zh": "拔插适配器。"},
    unit="unplugs",
    evidence_for=("I10",),
    full_budget=1_000,
    ci_budget=60,
    run=run,
)
