"""Stops at random instants of a full bus: the next frame on its bus, in time, and never called what it is not."""

from __future__ import annotations

from collections import defaultdict
from math import inf

from drivebus.bus import Poll, estimate_bus_load
from drivebus.drives import StopReport, stop_bus
from drivebus.errors import StopUnconfirmed
from drivebus.testing.virtual_time import running
from verification.campaign import Campaign, CampaignRun
from verification.drive_variants import DRIVE_VARIANTS, DriveVariant
from verification.scenario.load_generator import LOAD_ADDRESSES, LoadGenerator
from verification.scenario.stop_timer import PendingStop, SentRequest, StopTimer
from verification.scenario.user_command import UserCommand

INSTANTS_PER_BUS = 50
"""Instants on one line, before another one is built."""
STOP_SETTLING_S = 20.0
"""After the last instant every drive is heard again; so much later each one that was told to must stand."""
UNCONFIRMED_ALARM_MAX_S = 2.0
"""Confirmed or alarmed by T_stop + this + the ramp …"""
TRANSACTIONS_AT_LIMIT = 16
"""… but where a drive answers at its limit, two looks and two stops may take so many transactions, and longer."""


class StopBus(LoadGenerator):
    """One crowded line, and the stops that are wished on it."""

    def __init__(self, session: CampaignRun, kind: DriveVariant, number: int) -> None:
        super().__init__(session, kind, number)
        self.stop_timer = StopTimer(self.stand, self._on_stop_sent)
        self.undelayed_s: list[tuple[float, float]] = []
        """To the first and to the last bit, of stops that neither another stop nor a late reply held back."""
        self.worst_after_other_stops_s = 0.0
        self.worst_confirmation_s = 0.0
        self.worst_repeat_pause_s = 0.0
        """The longest that a pending stop was not repeated."""
        self.start_load()
        self._check_reported_bound()

    def _check_reported_bound(self) -> None:
        """5.1 (3): what the product tells its user is the same bound."""
        polls = [
            (
                drive.dialect.station_config,
                [Poll(request, 0.0) for request, _ in drive.dialect.polls(tuple(drive.profile.signals))],
            )
            for drive in self.stand.drives.values()
        ]
        message = estimate_bus_load(polls, self.stand.bus.settings).drives[LOAD_ADDRESSES[0]].stop_bound_s
        if abs(message - self.stop_timer.bounds.stop_bound_s) > 1e-9:
            self.violation(
                f"G06 the bus tells a bound of {message:.6f} s, it is {self.stop_timer.bounds.stop_bound_s:.6f} s"
            )

    def violation(self, text: str) -> None:
        self.stand.oracle.violation(text)

    # --- one instant -----------------------------------------------------------------------------------------------

    def run_instant(self) -> None:
        """Let a while pass, and wish for a stop."""
        self.wait_random()
        self._measure_pending()
        self.disturb_drives()
        self.session.count(f"wished while {self.stop_timer.phase()}")
        if self.rng.random() < 0.25 and not any(self.open_commands.values()):
            self._stop_bus()
        else:
            self._stop_one(self.rng.choice(LOAD_ADDRESSES))

    def _measure_pending(self) -> None:
        for address, drive in self.stand.drives.items():
            if drive.stop_pending:
                since_s = self.stand.loop.time() - self.stop_timer.stopped_at.get(address, inf)
                self.worst_repeat_pause_s = max(self.worst_repeat_pause_s, since_s)

    def _stop_one(self, address: int) -> None:
        capabilities = self.stand.drives[address].profile.capabilities
        how = self.rng.choice([name for name in ("stop", "coast", "quick_stop") if name in capabilities])
        wait = self.rng.random() < 0.5
        self.stop_timer.on_stop_command(address)
        user_command = self.stand.command(address, how, wait=wait)
        self._on_command(user_command)
        assert user_command.task is not None
        user_command.task.add_done_callback(
            lambda _: self._on_stop_ended(user_command, wait, self.stop_timer.bounds.stop_bound_s)
        )

    def _on_command(self, wish: UserCommand) -> None:
        self.open_commands[wish.address].append(wish)
        self.drives_to_stop.add(wish.address)

    def _stop_bus(self) -> None:
        stand, everybody = self.stand, self.kind.broadcast
        hear = "broadcast_stop" in stand.drives[LOAD_ADDRESSES[0]].profile.capabilities and everybody is not None
        for address in (everybody or 0,) if hear else LOAD_ADDRESSES:
            self.stop_timer.on_stop_command(address)
        commands = [stand.oracle.on_command(address, "stop", ("everybody",)) for address in LOAD_ADDRESSES]
        for command in commands:
            self._on_command(command)
        with running(stand.loop):
            stand.loop.create_task(self._await_bus_stop(commands))

    async def _await_bus_stop(self, wishes: list[UserCommand]) -> None:
        report: StopReport = await stop_bus(self.stand.bus, list(self.stand.drives.values()))
        self.stand.bus.release_start()
        for command, (_, outcome) in zip(wishes, report.outcomes, strict=True):
            command.outcome, command.error = outcome, None if outcome.succeeded else StopUnconfirmed(outcome.key)
            self.stand.oracle.on_command_ended(command)
            self._on_stop_ended(command, False, inf)
        if report.confirmed != all(outcome.status == "confirmed" for _, outcome in report.outcomes):
            self.violation(f"I3 a bus stop with {report.outcomes} is called confirmed: {report.confirmed}")

    # --- what came of it -------------------------------------------------------------------------------------------

    def _on_stop_sent(self, one: PendingStop, sent: SentRequest) -> None:
        first_s, last_s = sent.start - one.at, sent.end - one.at
        if one.foreign_traffic:
            self.session.count("held back by a late reply")
        elif one.after_broadcast or self.kind.broadcast in one.earlier_stops:
            self.session.count("after a broadcast")
        else:
            self.session.count(f"after {len(one.earlier_stops)} other drives' stops")
            if not one.earlier_stops:
                self.undelayed_s.append((first_s, last_s))
        self.worst_after_other_stops_s = max(self.worst_after_other_stops_s, last_s)

    def _on_stop_ended(self, wish: UserCommand, waited: bool, bound_s: float) -> None:
        self.open_commands[wish.address].remove(wish)
        if wish.outcome is None or wish.ended_at is None:
            return self.violation(f"G07 {wish} ended with {wish.error!r}")
        unsure = isinstance(wish.error, StopUnconfirmed)
        if not wish.outcome.succeeded and not unsure and (waited or wish.outcome.key != "drives.stop_answered"):
            self.violation(f"G07 {wish} is {wish.result_word}, and nobody was alarmed")
        if wish.outcome.succeeded and unsure:
            self.violation(f"G07 {wish} is {wish.result_word}, told as {wish.error!r}")
        if waited and unsure and not self.stand.drives[wish.address].stop_pending:
            self.violation(f"G07 {wish} is {wish.result_word}, and it is not repeated")
        took_s = wish.ended_at - wish.at
        if waited:
            self.worst_confirmation_s = max(self.worst_confirmation_s, took_s - self.ramp_s)
            over_s = took_s - bound_s - self.ramp_s
            self.session.count("alarmed later than G07 says, at a drive's limit", int(over_s > UNCONFIRMED_ALARM_MAX_S))
            if over_s > max(
                UNCONFIRMED_ALARM_MAX_S,
                TRANSACTIONS_AT_LIMIT * self.stop_timer.bounds.failed_poll_s if self.kind.reports_running else 0.0,
            ):
                self.violation(f"G07 {wish} was {wish.result_word} after {took_s:.3f} s")
        return None

    def finish(self) -> None:
        """Every drive hears again: in the end all stand."""
        self.restore_line()
        self.stand.run(STOP_SETTLING_S)
        self.stop_timer.finish()
        for address in sorted(self.drives_to_stop) if self.kind.reports_running else ():
            pending = self.stand.drives[address].stop_pending
            if self.stand.station(address).motor.energised or self.open_commands[address] or pending:
                self.violation(f"G07 drive {address} was told to stop, and its motor is on or it is still being told")
        self.stand.close()


def run(session: CampaignRun) -> None:
    found: dict[str, list[StopBus]] = defaultdict(list)
    number = 0
    while session.remaining:
        kind = DRIVE_VARIANTS[number % len(DRIVE_VARIANTS)]
        line = StopBus(session, kind, number)
        for _ in range(min(INSTANTS_PER_BUS, session.remaining)):
            line.run_instant()
            session.add_trials()
        line.finish()
        found[kind.name].append(line)
        number += 1
    session.figures.update({name: _figures(lines) for name, lines in found.items()})


def _figures(lines: list[StopBus]) -> dict[str, float]:
    """Milliseconds and seconds of virtual time."""
    bound_s = lines[0].stop_timer.bounds.stop_bound_s
    first = sorted(first for line in lines for first, _ in line.undelayed_s)
    last = sorted(last for line in lines for _, last in line.undelayed_s)
    shares = {f"p{share:g}": last[min(len(last) - 1, int(len(last) * share / 100))] for share in (50, 99, 99.9, 100)}
    return {
        "bound ms": round(bound_s * 1000, 3),
        **{f"last bit {name} ms": round(value * 1000, 3) for name, value in shares.items()},
        "first bit at most ms": round(first[-1] * 1000, 3),
        "worst / bound": round(last[-1] / bound_s, 4),
        "last bit after other stops, at most ms": round(
            max(line.worst_after_other_stops_s for line in lines) * 1000, 3
        ),
        "confirmed or alarmed, less the ramp, at most s": round(max(line.worst_confirmation_s for line in lines), 3),
        "not repeated while pending, at most s": round(max(line.worst_repeat_pause_s for line in lines), 3),
    }


CAMPAIGN = Campaign(
    name="stop",
    summary={"en": "Stops at random instants.", "zh": "随机时刻的停止。"},
    unit="instants",
    evidence_for=("I3",),
    full_budget=100_000,
    ci_budget=600,
    run=run,
)
