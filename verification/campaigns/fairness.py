"""Dead stations on a full line: the living keep their cycle, and whoever comes back is found."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from random import Random
from typing import Any

from drivebus.bus import Poll
from drivebus.bus.messages import BusRequest, BusResult
from drivebus.testing.virtual_time import running
from verification.campaign import Campaign, CampaignRun
from verification.drive_variants import C320, C320_HEX, DRIVE_VARIANTS, VC660, DriveVariant
from verification.reference.request_effects import classify_request
from verification.scenario.scenario import Scenario
from verification.timing_bounds import TimingBounds

STATION_COUNT = 31
CYCLE_STRETCH_MAX = 1.112
"""The most that any number of dead stations may cost the living."""
PROBE_SHARE_MAX = 0.1
REDISCOVERY_MAX_S = 60.0
ON_DEMAND_REPLY_MAX_S = 2.0
"""A station that somebody asks by hand is found within this time; DF800, whose fences are alike, that much later."""
ALIVE_S, DYING_S, SETTLING_S, OBSERVATION_S = 5.0, 10.0, 20.0, 60.0
STEP_S = 0.01
MISSED_POLL_S = 0.03
"""Longer than any question is on the wire."""
CI_CASES = ((VC660, 1), (VC660, 5), (VC660, 15), (VC660, 30)) + tuple(
    (kind, 4 + 5 * place) for place, kind in enumerate(kind for kind in DRIVE_VARIANTS if kind is not VC660)
)


def addresses_of(kind: DriveVariant) -> range:
    """31 stations: C320 has the addresses 0 to 30, 31 is its broadcast."""
    return range(31) if kind in (C320, C320_HEX) else range(1, 32)


class FairnessBus:
    """31 stations that are polled as fast as the bus goes; some of them die or were never there."""

    def __init__(self, session: CampaignRun, kind: DriveVariant, dead: int) -> None:
        self.session, self.kind, self.number = session, kind, dead
        self.rng: Random = session.rng(kind.name, dead)
        self.scenario = Scenario(session, kind, addresses_of(kind), name=f"{kind.name}, {dead} dead", seed=1 + dead)
        self.stations = {station.address: station for station in self.scenario.bench.stations}
        self.dead = self.rng.sample(addresses_of(kind), dead)
        self.answers: dict[int, list[float]] = defaultdict(list)
        """When each station answered a poll."""
        self._requested_at = -1
        """Whom the host spoke to last."""
        self._replied_at: dict[int, int] = {}
        self._poll()
        self._observe_wire()

    def _poll(self) -> None:
        with running(self.scenario.loop):
            for address, drive in self.scenario.drives.items():
                self.scenario.bus.start_polling(address, [Poll(drive.dialect.echo_test_read(), 0.0)], self._on_answer)

    def _on_answer(self, answer: BusResult) -> None:
        if answer.error is None and answer.received_at is not None:
            self.answers[answer.bus_request.station].append(answer.received_at)

    def _observe_wire(self) -> None:
        wire: Any = self.scenario.bench.wire
        say = wire.transmit

        def on_say(talker: Any, data: bytes, *more: Any, **named: Any) -> Any:
            if hasattr(talker, "receive"):
                self._requested_at = classify_request(self.kind.model, self.kind.encoding, data)[0]
            return say(talker, data, *more, **named)

        wire.transmit = on_say

    def silence_stations(self) -> None:
        """Every other case: they were never there; else they die one after the other at random instants."""
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
        """Mean time between two answers of each living station."""
        since = self.scenario.loop.time()
        self.scenario.run(OBSERVATION_S)
        living = [address for address in self.scenario.drives if address not in self.dead]
        times = [[at for at in self.answers[address] if at >= since] for address in living]
        return [(one[-1] - one[0]) / (len(one) - 1) for one in times]

    # --- coming back -----------------------------------------------------------------------------------------------

    def _restore_station(self, address: int) -> float:
        """The station hears again; when that was."""
        station = self.stations[address]
        station.faults.silent, self._replied_at[address] = False, station.reply_count
        self.scenario.oracle.trace(f"{address} hears again")
        return self.scenario.loop.time()

    def _advance(self) -> None:
        """A short while, without the look around that ``stand.run`` ends with."""
        self.scenario.loop.run_until(self.scenario.loop.time() + STEP_S)

    def _rediscovery_s(self, address: int, at: float, within_s: float) -> float:
        """Seconds until it was asked and answered; twice ``within_s`` is watched, and no more."""
        while self.scenario.loop.time() < at + 2 * within_s:
            if self.stations[address].reply_count > self._replied_at[address]:
                return self.scenario.loop.time() - at
            self._advance()
        return float("inf")

    def revive_one(self, within_s: float) -> float:
        """One station comes back while the others stay dead, just when it has been asked in vain."""
        address = self.dead.pop()
        self._requested_at = -1
        while self._requested_at != address:
            self._advance()
        self.scenario.run(MISSED_POLL_S)
        return self._rediscovery_s(address, self._restore_station(address), within_s)

    def revive_on_demand(self) -> float:
        """One comes back, and somebody asks it at once. Seconds until the answer is there."""
        address = self.dead.pop()
        at, drive = self._restore_station(address), self.scenario.drives[address]
        with running(self.scenario.loop):
            asking = self.scenario.loop.create_task(
                self.scenario.bus.transact(BusRequest(address, drive.dialect.echo_test_read()))
            )
        while not asking.done():
            self._advance()
        answer: BusResult = asking.result()
        return float("inf") if answer.received_at is None else answer.received_at - at

    def revive_all(self, within_s: float) -> float:
        """All the others come back at once; the last one counts."""
        at = max([self._restore_station(address) for address in self.dead], default=0.0)
        return max([self._rediscovery_s(address, at, within_s) for address in self.dead], default=0.0)


def run(session: CampaignRun) -> None:
    alone: dict[str, float] = {}
    worst: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    for kind, dead in list(_cases())[: session.budget]:
        if kind.name not in alone:
            alone[kind.name] = _mean(_cycles_without_dead(session, kind)) / STATION_COUNT
        _case(session, FairnessBus(session, kind, dead), alone[kind.name], worst[kind.name])
        session.add_trials()
    for name, found in worst.items():
        session.figures[name] = {what: round(most, 4) for what, most in found.items()}


def _cases() -> Iterator[tuple[DriveVariant, int]]:
    """Those of the slice first."""
    yield from CI_CASES
    yield from (
        (kind, dead) for dead in range(1, STATION_COUNT) for kind in DRIVE_VARIANTS if (kind, dead) not in CI_CASES
    )


def _cycles_without_dead(session: CampaignRun, kind: DriveVariant) -> list[float]:
    """The cycles of a line on which nobody is dead."""
    line = FairnessBus(session, kind, 0)
    line.scenario.run(ALIVE_S)
    cycles = line.cycles_s()
    line.scenario.close()
    return cycles


def _case(session: CampaignRun, line: FairnessBus, alone_s: float, worst: dict[str, float]) -> None:
    """``alone_s``: what one poll costs on a line on which nobody is dead."""
    line.silence_stations()
    cycles = line.cycles_s()
    stretch = _mean(cycles) / (alone_s * len(cycles))
    _record_worst(line, worst, "stretch", stretch, CYCLE_STRETCH_MAX)
    worst["stretch of a single drive"] = max(worst["stretch of a single drive"], max(cycles) / (alone_s * len(cycles)))
    probe_s = TimingBounds(line.kind, line.scenario.bench.settings).failed_poll_s
    within_s = max(REDISCOVERY_MAX_S, line.number * probe_s / PROBE_SHARE_MAX)
    _record_worst(line, worst, "found after s", line.revive_one(within_s), within_s)
    if line.dead:
        asked_s = line.revive_on_demand()
        session.count("asked by hand: later than 2 s", int(asked_s > ON_DEMAND_REPLY_MAX_S))
        _record_worst(
            line,
            worst,
            "asked and found after s",
            asked_s,
            ON_DEMAND_REPLY_MAX_S + line.kind.identical_probe_quarantine_s,
        )
    _record_worst(line, worst, "all found after s", line.revive_all(within_s), within_s)
    session.count("stations revived", line.number)
    line.scenario.close()


def _record_worst(line: FairnessBus, worst: dict[str, float], what: str, value: float, most: float) -> None:
    line.scenario.oracle.trace(f"{what}: {value:.4f}")
    worst[what] = max(worst[what], value)
    if value > most:
        line.scenario.oracle.violation(f"G08 {what}: {value:.4f}, more than {most:.4f}")


def _mean(values: list[float]) -> float:
    return sum(values) / len(values)


CAMPAIGN = Campaign(
    name="fairness",
    summary={"en": "Silent stations don't slow the others.", "zh": "无应答的站不拖慢其他站。"},
    unit="cases",
    evidence_for=(),
    full_budget=len(DRIVE_VARIANTS) * (STATION_COUNT - 1),
    ci_budget=len(CI_CASES),
    run=run,
)
