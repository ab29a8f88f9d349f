"""``commands`` (G05, G19): users command drives over a line that loses 10 % of the frames each way.

Two users at once run, stop, jog, set, reset and write at random, at times on a line that doubles and delays replies or
with an echo set wrong, while drives fall silent, reboot, trip, and are started and stopped at their keypads. An
episode ends with the line made good: then every stop must have been heard. The witness holds each outcome against the
motor (``outcomes``), counts executions (I2) and knows that an absent drive can say nothing (G19).
"""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Any

from drivebus.lab.campaign import Campaign, Session
from drivebus.lab.kinds import KINDS, Kind
from drivebus.lab.world.stand import Stand
from drivebus.lab.world.wishes import Wish
from drivebus.sim.motor import Trip

PRESENT, ABSENT = (1, 2), 3
BAUD, RAMP_S = 38400, 1
AN_EPISODE, WITH_WRONG_ECHO = 40, 8
"""Commands on one line; then another one is built: soon, where a station that failed once is believed no more."""
LOSS = "loss=0.1"
WEATHERS = ("", "", ",late=0.02:1", ",duplicate=0.02", ",late=0.03:0.3,duplicate=0.01", ",bytes", ",batch=8")
UNPACED = 0.3
"""Of the ports don't know when their last bit is out (TCP): there an echo can't be told by its time."""
RIGHT = (("", "off"),) * 12 + (("echo", "on"), ("echo", "detect"), ("", "detect"))
ECHOES = RIGHT + (("echo", "off"), ("", "on")) * 6
"""What the adapter does, and what the port is told."""
PAUSE_S, TROUBLE_S, LASTS_S = 0.6, 5.0, 1.5
"""Mean time between two commands of one user and between two things that go wrong; how long silence lasts."""
PATIENT = 0.7
"""Of the commands are waited for by their user before the next."""
AT_ONCE = 0.15
"""Of the runs are followed by a stop within ``SOON_S``."""
SOON_S = 0.3
CALM_S = 90.0
FREQUENCIES_HZ = (2.0, 3.0, 5.0)
WRITES = {
    "c320": ("F0.2", False, 0x0_02, 100),
    "dzb100": ("10", True, 10, 10),
    "vc660": ("F00.02", False, 2, 100),
    "df800": ("F1.00", True, 100, 100),
}
"""A parameter that may be written while the drive runs: its notation, saved or not, where it lies, raw per unit."""
WISHES = {
    "run": 6, "stop": 5, "set_frequency": 2, "reset_fault": 1, "write": 2, "jog": 1, "coast": 1, "quick_stop": 1,
}  # fmt: skip


class Episode:
    """One line with two drives and a gap where a third should be."""

    def __init__(self, session: Session, kind: Kind, number: int) -> None:
        self.session, self.kind = session, kind
        self.chance = chance = session.rng(kind.name, number)
        self.adapter, setting = chance.choice(ECHOES)
        self.echoes_right = setting == "detect" or (self.adapter == "echo") is (setting == "on")
        self.stand = stand = Stand(
            session, kind, PRESENT, name=f"{kind.name}/{number}", baud=BAUD, ramp=RAMP_S, echo=setting,
            seed=chance.randrange(2**31),
        )  # fmt: skip
        stand.bench.weather = LOSS + chance.choice(WEATHERS) + ("," + self.adapter if self.adapter else "")
        stand.bus.core.paced = chance.random() >= UNPACED
        batched = self.adapter == "echo" and stand.bench.weather.batch_s > 0.0
        stand.witness.conduct.misled = not self.echoes_right or not stand.bus.core.paced or batched
        session.count(f"echo {self.adapter or 'no'}, set {setting}")
        self.addresses: tuple[int, ...] = (1, ABSENT, ABSENT) if not self.echoes_right else PRESENT
        if self.echoes_right and chance.random() < 0.2:
            self.addresses = (*PRESENT, ABSENT)
        if ABSENT in self.addresses:
            stand.drives[ABSENT] = stand._drive(ABSENT)
        capable = stand.drives[PRESENT[0]].profile.capabilities
        self.what = [name for name in WISHES if name in capable]
        self.wishes: list[Wish] = []

    def play(self, most: int) -> None:
        """Commands of two users, and what goes wrong meanwhile; then calm, and the truth."""
        commands = min(most, AN_EPISODE if self.echoes_right else WITH_WRONG_ECHO)
        loop = self.stand.loop
        users: dict[int, Wish | None] = {0: None, 1: None}
        turns = [self._soon(PAUSE_S), self._soon(PAUSE_S)]
        trouble = self._soon(TROUBLE_S)
        while len(self.wishes) < commands:
            at = min(*turns, trouble)
            loop.run_until(at)
            if at == trouble:
                self._trouble()
                trouble = self._soon(TROUBLE_S)
                continue
            user = turns.index(at)
            turns[user] = self._soon(PAUSE_S)
            last = users[user]
            if last is None or last.over:
                wish = self._wish(self.chance.choice(self.addresses))
                users[user] = wish if self.chance.random() < PATIENT else None
        self._calm()
        self._truth()
        self._beyond()
        self.stand.close()

    def _soon(self, mean_s: float) -> float:
        return self.stand.loop.time() + self.chance.expovariate(1.0 / mean_s)

    # --- what users do -------------------------------------------------------------------------------------------

    def _wish(self, address: int) -> Wish:
        what = self.chance.choices(self.what, [WISHES[name] for name in self.what])[0]
        wish = self._give(address, what)
        if what == "run" and self.chance.random() < AT_ONCE:
            self.stand.run(self.chance.choice((0.0, self.chance.uniform(0.0, SOON_S))))
            self._give(address, "stop")
        return wish

    def _give(self, address: int, what: str) -> Wish:
        stand, chance = self.stand, self.chance
        hz = chance.choice(FREQUENCIES_HZ)
        match what:
            case "run":
                backward = chance.random() < 0.2
                wish = stand.wish(address, what, hz, *(("reverse",) if backward else ()))
            case "set_frequency":
                wish = stand.wish(address, what, hz)
            case "write":
                notation, save, _, _ = WRITES[self.kind.model]
                wish = stand.wish(address, what, {notation: float(chance.randrange(1, 20))}, save)
            case "jog":
                wish = stand.wish_by(partial(self._jog, address, chance.uniform(0.0, 1.0)), address, what)
            case "reset_fault":
                wish = stand.wish(address, what)
            case _:
                wish = stand.wish(address, what, chance.random() < 0.7)
        self.wishes.append(wish)
        assert wish.task is not None
        wish.task.add_done_callback(lambda _: self._ended(wish))
        return wish

    async def _jog(self, address: int, seconds: float) -> Any:
        """A hand on the key; at times longer than the lease without a renewal."""
        hz = 2.0 if self.kind.model == "dzb100" else None
        async with self.stand.drives[address].jog(hz) as lease:
            await asyncio.sleep(seconds)
        return lease.begun

    def _ended(self, wish: Wish) -> None:
        """A stop that is not known to have worked goes on (F17); a written value is there."""
        drive = self.stand.drives[wish.address]
        newer = any(one.moves and one.at >= wish.at for one in self._of(wish.address))
        if wish.stops and wish.word == "unknown" and not drive.stop_pending and not newer:
            others = [one for one in self._of(wish.address) if one.stops and one.number > wish.number]
            if not others:
                self.stand.witness.violation(f"G05 {wish}: given up")
        deeds = self.stand.witness.deeds.get(wish.address)
        if wish.what == "write" and deeds is not None and deeds.alone(wish):
            self._written(wish, deeds.station)

    def _written(self, wish: Wish, station: Any) -> None:
        _, _, key, raw = WRITES[self.kind.model]
        (wanted,) = wish.arguments[0].values()
        there = station.memory[key] == round(wanted * raw)
        if (wish.word in ("confirmed", "acknowledged") and not there) or (wish.word == "failed" and there):
            self.stand.witness.violation(f"{wish}: {wish.word}, and the drive holds {station.memory[key]}")

    def _of(self, address: int) -> list[Wish]:
        return [wish for wish in self.wishes if wish.address == address]

    # --- what goes wrong -----------------------------------------------------------------------------------------

    def _trouble(self) -> None:
        chance = self.chance
        station = self.stand.station(chance.choice(PRESENT))
        match chance.randrange(7):
            case 0:
                station.faults.silent = True
                self.stand.loop.call_later(chance.uniform(0.0, LASTS_S), self._hears, station)
            case 1:
                station.faults.mute = True
                self.stand.loop.call_later(chance.uniform(0.0, LASTS_S), self._hears, station)
            case 2:
                station.power_cycle(chance.uniform(0.2, 2 * LASTS_S))
            case 3:
                station.trip(chance.choice(list(Trip)))
            case 4:
                station.press_run(chance.choice(FREQUENCIES_HZ))
            case _:
                station.press_stop()

    def _hears(self, station: Any) -> None:
        station.faults.silent = station.faults.mute = False

    # --- the end -------------------------------------------------------------------------------------------------

    def _calm(self) -> None:
        """The line and its settings are made good; everybody gets the time to say what became of it."""
        stand, loop = self.stand, self.stand.loop
        right = self.adapter if self.echoes_right else {"echo": "", "": "echo"}[self.adapter]
        stand.bench.weather = f"batch={1000 * stand.bench.weather.batch_s:g}" + ("," + right if right else "")
        for address in PRESENT:
            self._hears(stand.station(address))
        end = loop.time() + CALM_S
        while loop.time() < end and not self._settled():
            stand.run(1.0)
        stand.finish(*(wish for wish in self.wishes if wish.address != ABSENT), within_s=1.0)
        stand.run(RAMP_S)

    def _settled(self) -> bool:
        pending = any(self.stand.drives[address].stop_pending for address in PRESENT)
        return not pending and all(wish.over for wish in self.wishes if wish.address != ABSENT)

    def _truth(self) -> None:
        """G05: no stop is lost."""
        for address in sorted({*self.addresses}):
            stops = [wish for wish in self._of(address) if wish.stops]
            if stops:
                self._last_stop(stops[-1], self.stand.drives[address].stop_pending)

    def _last_stop(self, stop: Wish, pending: bool) -> None:
        newer = [one for one in self._of(stop.address) if one.moves and one.number > stop.number]
        tell = self.stand.witness.violation
        deeds = self.stand.witness.deeds.get(stop.address)
        if deeds is None:
            if not newer and stop.over and not pending:
                tell(f"G05 {stop}: given up, and there is no such drive")
            return
        self.stand.station(stop.address)
        overruled = any(one.sent for one in newer)
        if pending and not overruled:
            tell(f"G05 {stop}: not done {CALM_S} s after all was well")
        if deeds.stop_heard_at < stop.at and not overruled and not self.kind.tells:
            tell(f"G05 {stop}: {stop.word}, and the drive never heard it")
        run_since = any(one.what == "run" and one.sent for one in newer)  # also as a new frequency of a motor that ran
        by_another = deeds.on_at > stop.at and (deeds.on_for is None or deeds.on_for.number > stop.number)
        if deeds.on and not run_since and not by_another:
            tell(f"G05 {stop}: {stop.word}, and the motor is on")
        self.session.count("stops looked at in the end")

    def _beyond(self) -> None:
        """I7: what is out of range is refused before anything is sent for it."""
        notation, save, _, _ = WRITES[self.kind.model]
        too_fast, address = self.kind.maximum_hz + 0.1, PRESENT[0]
        for wish in (
            self.stand.wish(address, "run", too_fast),
            self.stand.wish(address, "set_frequency", too_fast),
            self.stand.wish(address, "write", {notation: 1e6}, save),
        ):
            self.stand.finish(wish)
            if wish.word != "LimitError" or wish.sent:
                self.stand.witness.violation(f"I7 {wish}: {wish.word}, and {wish.sent} frames left for it")


def run(session: Session) -> None:
    """Episodes, the kinds in turn."""
    number = 0
    while session.left:
        episode = Episode(session, KINDS[number % len(KINDS)], number)
        episode.play(session.left)
        session.count("requests", episode.stand.witness.frames)
        session.count("to absent drives", sum(wish.address == ABSENT for wish in episode.wishes))
        session.count("motors switched on", sum(wish.executions for wish in episode.wishes))
        session.did(len(episode.wishes))
        number += 1


CAMPAIGN = Campaign("commands", "commands", ("G05", "G19", "I1", "I2", "I3", "F03", "F16", "F17"), 10**6, 1500, run)
