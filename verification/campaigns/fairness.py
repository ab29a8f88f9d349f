"""``fairness``: silent stations on a full bus do not slow the others, and a station that returns is found."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from random import Random
from typing import Any

from drivebus.bus import Poll
from drivebus.bus.messages import BusRequest, BusResult
from drivebus.testing.virtual_time import running
from verification.campaign import Campaign, CampaignRun
from verification.drive_variants import DriveVariant, TimingBounds
from verification.families.modbus.facts import VC660
from verification.families.registry import variants_for
from verification.scenario.scenario import Scenario, SentRequest

COVERED = variants_for("fairness")
STATION_COUNT = 31
CYCLE_STRETCH_MAX = 1.112
"""Longest cycle of the answering stations relative to a bus without silent stations."""
PROBE_SHARE_MAX = 0.1
REDISCOVERY_MAX_S = 60.0
ON_DEMAND_REPLY_MAX_S = 2.0
"""Longest time to the reply of a returned station that a user reads; the quarantine of the DF800 is added."""
ALIVE_S, DYING_S, SETTLING_S, OBSERVATION_S = 5.0, 10.0, 20.0, 60.0
STEP_S = 0.01
MISSED_POLL_S = 0.03
"""Longer than any request on the wire, in seconds."""
CI_CASES = ((VC660, 1), (VC660, 5), (VC660, 15), (VC660, 30)) + tuple(
    (variant, 4 + 5 * place) for place, variant in enumerate(variant for variant in COVERED if variant is not VC660)
)


class FairnessBus:
    """31 stations polled as fast as possible, some of which go silent or never replied."""

    def __init__(self, campaign_run: CampaignRun, variant: DriveVariant, dead: int) -> None:
        self.campaign_run, self.variant, self.number = campaign_run, variant, dead
        self.rng: Random = campaign_run.rng(variant.name, dead)
        self.scenario = Scenario(
            campaign_run, variant, variant.addresses, name=f"{variant.name}, {dead} dead", seed=1 + dead
        )
        self.stations = {station.address: station for station in self.scenario.simulated_bus.stations}
        self.dead = self.rng.sample(variant.addresses, dead)
        self.answers: dict[int, list[float]] = defaultdict(list)
        """Times at which each station answered a poll."""
        self._requested_address = -1
        """Address of the last request; -1: none since it was reset."""
        self._reply_counts: dict[int, int] = {}
        """Replies of each station when it was restored, by address."""
        self._poll()
        self.scenario.observe_wire(self._on_transmission)

    def _poll(self) -> None:
        with running(self.scenario.loop):
            for address, drive in self.scenario.drives.items():
                self.scenario.bus.start_polling(address, [Poll(drive.dialect.echo_test_read(), 0.0)], self._on_answer)

    def _on_answer(self, answer: BusResult) -> None:
        if answer.error is None and answer.received_at is not None:
            self.answers[answer.bus_request.station].append(answer.received_at)

    def _on_transmission(self, _: Any, request: SentRequest | None) -> None:
        if request is not None:
            self._requested_address = request.address

    def silence_stations(self) -> None:
        """Silence the stations: from the start in odd cases, else one after the other at random instants."""
        if self.number % 2:
            self._silence_station(*self.dead)
        self.scenario.run(ALIVE_S)
        for at, address in sorted((self.rng.uniform(0.0, DYING_S), address) for address in self.dead):
            self.scenario.run(max(0.0, ALIVE_S + at - self.scenario.loop.time()))
            self._silence_station(address)
        self.scenario.run(ALIVE_S + DYING_S + SETTLING_S - self.scenario.loop.time())

    def _silence_station(self, *addresses: int) -> None:
        for address in addresses:
            self.stations[address].faults.silent = True
            self.scenario.oracle.trace(f"{address} is silent")

    def cycles_s(self) -> list[float]:
        """Return the mean time between two replies of each answering station."""
        since = self.scenario.loop.time()
        self.scenario.run(OBSERVATION_S)
        living = [address for address in self.scenario.drives if address not in self.dead]
        times = [[at for at in self.answers[address] if at >= since] for address in living]
        return [(answers[-1] - answers[0]) / (len(answers) - 1) for answers in times]

    # --- rediscovery -----------------------------------------------------------------------------------------------

    def _restore_station(self, address: int) -> float:
        """Let a station reply again; return the time."""
        station = self.stations[address]
        station.faults.silent, self._reply_counts[address] = False, station.reply_count
        self.scenario.oracle.trace(f"{address} replies again")
        return self.scenario.loop.time()

    def _advance(self) -> None:
        """Let a short time pass without the checks of ``Scenario.run``."""
        self.scenario.loop.run_until(self.scenario.loop.time() + STEP_S)

    def _rediscovery_s(self, address: int, at: float, within_s: float) -> float:
        """Return the seconds until the station replied; infinite after twice ``within_s``."""
        while self.scenario.loop.time() < at + 2 * within_s:
            if self.stations[address].reply_count > self._reply_counts[address]:
                return self.scenario.loop.time() - at
            self._advance()
        return float("inf")

    def revive_one(self, within_s: float) -> float:
        """Let one station return just after an unanswered request; return the seconds until it is found."""
        address = self.dead.pop()
        self._requested_address = -1
        while self._requested_address != address:
            self._advance()
        self.scenario.run(MISSED_POLL_S)
        return self._rediscovery_s(address, self._restore_station(address), within_s)

    def revive_on_demand(self) -> float:
        """Let one station return and read it at once; return the seconds until the reply."""
        address = self.dead.pop()
        at, drive = self._restore_station(address), self.scenario.drives[address]
        with running(self.scenario.loop):
            task = self.scenario.loop.create_task(
                self.scenario.bus.transact(BusRequest(station=address, request=drive.dialect.echo_test_read()))
            )
        while not task.done():
            self._advance()
        answer: BusResult = task.result()
        return float("inf") if answer.received_at is None else answer.received_at - at

    def revive_all(self, within_s: float) -> float:
        """Let all other stations return at once; return the seconds until the last one is found."""
        at = max([self._restore_station(address) for address in self.dead], default=0.0)
        return max([self._rediscovery_s(address, at, within_s) for address in self.dead], default=0.0)


def run(campaign_run: CampaignRun) -> None:
    alone: dict[str, float] = {}
    worst: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    for variant, dead in list(_cases())[: campaign_run.budget]:
        if variant.name not in alone:
            alone[variant.name] = _mean(_cycles_without_dead(campaign_run, variant)) / STATION_COUNT
        _case(campaign_run, FairnessBus(campaign_run, variant, dead), alone[variant.name], worst[variant.name])
        campaign_run.add_trials()
    for name, found in worst.items():
        campaign_run.figures[name] = {what: round(most, 4) for what, most in found.items()}


def _cases() -> Iterator[tuple[DriveVariant, int]]:
    """Yield all cases, those of the slice first."""
    yield from CI_CASES
    yield from (
        (variant, dead) for dead in range(1, STATION_COUNT) for variant in COVERED if (variant, dead) not in CI_CASES
    )


def _cycles_without_dead(campaign_run: CampaignRun, variant: DriveVariant) -> list[float]:
    """Return the cycles of a bus on which every station replies."""
    bus = FairnessBus(campaign_run, variant, 0)
    bus.scenario.run(ALIVE_S)
    cycles = bus.cycles_s()
    bus.scenario.close()
    return cycles


def _case(campaign_run: CampaignRun, bus: FairnessBus, alone_s: float, worst: dict[str, float]) -> None:
    """Run one case; ``alone_s``: seconds per poll on a bus on which every station replies."""
    bus.silence_stations()
    cycles = bus.cycles_s()
    stretch = _mean(cycles) / (alone_s * len(cycles))
    _record_worst(bus, worst, "stretch", stretch, CYCLE_STRETCH_MAX)
    worst["stretch of a single drive"] = max(worst["stretch of a single drive"], max(cycles) / (alone_s * len(cycles)))
    probe_s = TimingBounds(bus.variant, bus.scenario.simulated_bus.settings).failed_poll_s
    within_s = max(REDISCOVERY_MAX_S, bus.number * probe_s / PROBE_SHARE_MAX)
    _record_worst(bus, worst, "found after s", bus.revive_one(within_s), within_s)
    if bus.dead:
        on_demand_s = bus.revive_on_demand()
        campaign_run.count("read on demand: later than 2 s", int(on_demand_s > ON_DEMAND_REPLY_MAX_S))
        _record_worst(
            bus,
            worst,
            "found on demand after s",
            on_demand_s,
            ON_DEMAND_REPLY_MAX_S + bus.variant.identical_probe_quarantine_s,
        )
    _record_worst(bus, worst, "all found after s", bus.revive_all(within_s), within_s)
    campaign_run.count("stations revived", bus.number)
    bus.scenario.close()


def _record_worst(bus: FairnessBus, worst: dict[str, float], what: str, value: float, most: float) -> None:
    bus.scenario.oracle.trace(f"{what}: {value:.4f}")
    worst[what] = max(worst[what], value)
    if value > most:
        bus.scenario.oracle.violation(f"{what}: {value:.4f}, more than {most:.4f}")


def _mean(values: list[float]) -> float:
    return sum(values) / len(values)


CAMPAIGN = Campaign(
    name="fairness",
    summary={"en": "Silent stations don't slow the others.", "zh": "无应答的站不拖慢其他站。"},
    unit="cases",
    evidence_for=(),
    full_budget=len(COVERED) * (STATION_COUNT - 1),
    ci_budget=len(CI_CASES),
    run=run,
)
