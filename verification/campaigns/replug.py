"""The adapter pulled at random instants and put back under another name: polled again soon, and nothing is replayed."""

from __future__ import annotations

from collections import Counter
from math import inf

from drivebus.testing.virtual_time import running
from verification.campaign import Campaign, CampaignRun
from verification.drive_variants import DRIVE_VARIANTS, DriveVariant
from verification.fault_injection.hotplug_bus import HOTPLUG_ADDRESSES, HotplugBus
from verification.fault_injection.port_reopening import reopen_ports
from verification.scenario.user_command import UserCommand

UNPLUGS_PER_BUS = 20
"""Unplugs on one line, before another one is built."""
LOSS_DETECTED_MAX_S = 1.0
FIRST_POLL_MAX_S = 2.0
"""Somebody is polled again; every drive within twice that. DF800 (``alike_s``): one that was asked a question of
the fences' count just then comes so much later."""
STEP_S = 0.005
REJECTED_MAX_S = 0.5
"""Whoever asks for something while there is no port is told so within this time."""
REOPENINGS, CI_REOPENINGS = 400, 50
REPLUG_SETTLING_S = 6.0
"""Until every conversation has ended that the cut has left."""


class ReplugBus(HotplugBus):
    """Three polled drives behind one adapter, and a user who commands them."""

    def __init__(self, session: CampaignRun, kind: DriveVariant, number: int) -> None:
        super().__init__(session, kind, number)
        self.detected_s: list[float] = []
        self.first_s: list[float] = []
        self.back_s: list[float] = []
        """Until the first drive, and every drive, was polled again."""

    # --- one unplug ------------------------------------------------------------------------------------------------

    def unplug(self) -> None:
        """Pull it while something is going on, wish for more meanwhile, put it back, and see."""
        commands = self._issue_commands()
        self.scenario.run(self.rng.uniform(0.0, 1.5))
        self.session.count(f"pulled while {self.phase()}")
        motors = self._motor_starts()
        self._pull()
        refused = self._check_while_unplugged()
        self._check_return()
        self._poll_delay_s()
        self.scenario.finish(*commands, *refused)
        self._check_no_late_start(motors, [*commands, *refused])
        self.check_handles()

    def _issue_commands(self) -> list[UserCommand]:
        """Commands that are under way when it happens."""
        commands = []
        for address in HOTPLUG_ADDRESSES:
            if self.rng.random() < 0.5:
                what = self.rng.choice(("run", "stop", "set_frequency", "run"))
                arguments = () if what == "stop" else (self.rng.choice((5.0, 10.0, 20.0)),)
                commands.append(self.scenario.command(address, what, *arguments))
        return commands

    def _motor_starts(self) -> Counter[int]:
        """How often each motor has been started."""
        return Counter({address: self.scenario.station(address).motor.starts for address in HOTPLUG_ADDRESSES})

    def _pull(self) -> None:
        hangs_up = self.rng.random() < 0.7
        self.session.count("told by a hang-up" if hangs_up else "told by a write")
        at = self.now
        self.scenario.oracle.on_unplugged()
        with running(self.scenario.loop):
            self.adapter.unplug(hangs_up)
        while self.scenario.bus.is_open and self.now < at + 2 * LOSS_DETECTED_MAX_S:
            self.scenario.loop.run_until(self.now + STEP_S)
        self.scenario.oracle.on_unplugged()  # what was wished until it was noticed is older than the port, too
        self.detected_s.append(self.now - at)
        if self.scenario.bus.is_open:
            self.violation("G09 the port is gone, and the bus has not noticed")

    def _check_while_unplugged(self) -> list[UserCommand]:
        """Nothing is sent, and whoever asks is told soon."""
        asked = len(self.requests)
        commands = []
        self.scenario.run(self.rng.uniform(0.0, 2.0))
        if self.rng.random() < 0.5:
            commands = [self.scenario.command(self.rng.choice(HOTPLUG_ADDRESSES), "run", 10.0)]
            self.scenario.run(REJECTED_MAX_S)
            if not commands[0].is_ended:
                self.violation(f"{commands[0]} was not refused within {REJECTED_MAX_S} s")
        self.scenario.run(self.rng.uniform(0.0, 2.0))
        if len(self.requests) != asked:
            self.violation("something was said on a line that is not there")
        return commands

    def _check_return(self) -> None:
        with running(self.scenario.loop):
            name = self.adapter.replug()
        self.scenario.oracle.trace(f"plugged in again as {name}")
        self.scenario.oracle.frame_rules.on_port_lost(self.now)  # nothing older than this may act

    def _poll_delay_s(self) -> None:
        """A drive, and then every drive, has a value that is younger than the return."""
        at, since = self.now, {address: self.newest_reading_at(address) for address in HOTPLUG_ADDRESSES}
        waiting, first_s = set(HOTPLUG_ADDRESSES), inf
        within_s = 2 * FIRST_POLL_MAX_S + self.kind.identical_probe_quarantine_s
        while waiting and self.now < at + within_s:
            self.scenario.loop.run_until(self.now + STEP_S)
            waiting = {address for address in waiting if self.newest_reading_at(address) <= max(since[address], at)}
            if len(waiting) < len(HOTPLUG_ADDRESSES):
                first_s = min(first_s, self.now - at)
        self.first_s.append(first_s)
        self.back_s.append(self.now - at)
        self.session.count("every drive polled again: later than 2 s", int(self.back_s[-1] > FIRST_POLL_MAX_S))
        if first_s > FIRST_POLL_MAX_S or waiting:
            self.violation(
                f"G09 first polled again {first_s:.3f} s after the return, "
                f"never within {within_s:g} s: {waiting or '-'}"
            )
        name = self.adapter.opened_names[-1]
        if name != self.adapter.machine.name:
            self.violation(f"F12 opened {name}, where our adapter is {self.adapter.machine.name}")

    def _check_no_late_start(self, starts: Counter[int], wishes: list[UserCommand]) -> None:
        """Nothing that was wished before the return starts a motor after it."""
        for address, count in self._motor_starts().items():
            moved = sum(user_command.executions for user_command in wishes if user_command.address == address)
            if count - starts[address] > moved:
                self.violation(f"I10 the motor of {address} was started by nobody")
        self.scenario.finish(*(self.scenario.command(address, "stop") for address in HOTPLUG_ADDRESSES))
        self.scenario.run(REPLUG_SETTLING_S)


def run(session: CampaignRun) -> None:
    lines: list[ReplugBus] = []
    number = 0
    while session.remaining:
        line = ReplugBus(session, DRIVE_VARIANTS[number % len(DRIVE_VARIANTS)], number)
        for _ in range(min(UNPLUGS_PER_BUS, session.remaining)):
            line.unplug()
            session.add_trials()
        line.scenario.close()
        lines.append(line)
        number += 1
    _figures(session, lines)
    _reopen_real_ports(session)


def _figures(session: CampaignRun, lines: list[ReplugBus]) -> None:
    detected = sorted(one for line in lines for one in line.detected_s)
    for kind in DRIVE_VARIANTS:
        back = sorted(one for line in lines if line.kind is kind for one in line.back_s)
        if back:
            session.figures[kind.name] = {
                "polled again at most s": round(
                    max(one for line in lines if line.kind is kind for one in line.first_s), 3
                ),
                "every drive polled again p50 s": round(back[len(back) // 2], 3),
                "every drive polled again at most s": round(back[-1], 3),
            }
    session.figures["noticed at most s"] = round(detected[-1], 3)
    session.figures["names of the adapter"] = len({name for line in lines for name in line.adapter.opened_names})


def _reopen_real_ports(session: CampaignRun) -> None:
    """The same with real descriptors."""
    times = REOPENINGS if session.budget > CAMPAIGN.ci_budget else CI_REOPENINGS
    found = reopen_ports(times)
    session.figures["real reopenings"] = times
    session.figures["descriptors more after them"] = found["descriptors"]
    session.machine["a hang-up of a real pty noticed at most s"] = round(found["slowest_s"], 4)
    if found["descriptors"] > 0 or found["names"] < 2:
        session.violation(f"G09 {found['descriptors']} descriptors stay open after {times} real reopenings")


CAMPAIGN = Campaign(
    name="replug",
    summary={"en": "The adapter pulled and put back.", "zh": "拔插适配器。"},
    unit="unplugs",
    evidence_for=("I10",),
    full_budget=1_000,
    ci_budget=60,
    run=run,
)
