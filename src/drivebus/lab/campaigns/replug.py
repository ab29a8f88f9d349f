"""The adapter pulled at random instants and put back under another name: polled again soon, and nothing is replayed."""

from __future__ import annotations

from collections import Counter
from math import inf

from drivebus.lab.breaking.plugged import ADDRESSES, Plugged
from drivebus.lab.breaking.reopening import reopen
from drivebus.lab.campaign import Campaign, Session
from drivebus.lab.kinds import KINDS, Kind
from drivebus.lab.world.loop import running
from drivebus.lab.world.wishes import Wish

A_LINE = 20
"""Unplugs on one line, before another one is built."""
DETECTED_S = 1.0
BACK_S = 2.0
"""G09: somebody is polled again; every drive within twice that. DF800 (``alike_s``): one that was asked a question of
the fences' count just then comes so much later."""
STEP_S = 0.005
REFUSED_S = 0.5
"""Whoever asks for something while there is no port is told so within this time."""
REOPENINGS, REOPENINGS_OF_A_SLICE = 400, 50
CALM_S = 6.0
"""Until every conversation has ended that the cut has left."""


class Line(Plugged):
    """Three polled drives behind one adapter, and a user who commands them."""

    def __init__(self, session: Session, kind: Kind, number: int) -> None:
        super().__init__(session, kind, number)
        self.detected_s: list[float] = []
        self.first_s: list[float] = []
        self.back_s: list[float] = []
        """Until the first drive, and every drive, was polled again."""

    # --- one unplug ------------------------------------------------------------------------------------------------

    def unplug(self) -> None:
        """Pull it while something is going on, wish for more meanwhile, put it back, and see."""
        wishes = self._wishes()
        self.stand.run(self.rng.uniform(0.0, 1.5))
        self.session.count(f"pulled while {self.phase()}")
        motors = self._motors()
        self._pull()
        refused = self._meanwhile()
        self._return()
        self._polled_again()
        self.stand.finish(*wishes, *refused)
        self._settle(motors, [*wishes, *refused])
        self.check_handles()

    def _wishes(self) -> list[Wish]:
        """Commands that are under way when it happens."""
        wishes = []
        for address in ADDRESSES:
            if self.rng.random() < 0.5:
                what = self.rng.choice(("run", "stop", "set_frequency", "run"))
                arguments = () if what == "stop" else (self.rng.choice((5.0, 10.0, 20.0)),)
                wishes.append(self.stand.wish(address, what, *arguments))
        return wishes

    def _motors(self) -> Counter[int]:
        """How often each motor has been started."""
        return Counter({address: self.stand.station(address).motor.starts for address in ADDRESSES})

    def _pull(self) -> None:
        hangs_up = self.rng.random() < 0.7
        self.session.count("told by a hang-up" if hangs_up else "told by a write")
        at = self.now
        self.stand.witness.unplugged()
        with running(self.stand.loop):
            self.adapter.pull(hangs_up)
        while self.stand.bus.is_open and self.now < at + 2 * DETECTED_S:
            self.stand.loop.run_until(self.now + STEP_S)
        self.stand.witness.unplugged()  # what was wished until it was noticed is older than the port, too
        self.detected_s.append(self.now - at)
        if self.stand.bus.is_open:
            self.violation("G09 the port is gone, and the bus has not noticed")

    def _meanwhile(self) -> list[Wish]:
        """Nothing is sent, and whoever asks is told soon."""
        asked = len(self.asked)
        wishes = []
        self.stand.run(self.rng.uniform(0.0, 2.0))
        if self.rng.random() < 0.5:
            wishes = [self.stand.wish(self.rng.choice(ADDRESSES), "run", 10.0)]
            self.stand.run(REFUSED_S)
            if not wishes[0].over:
                self.violation(f"{wishes[0]} was not refused within {REFUSED_S} s")
        self.stand.run(self.rng.uniform(0.0, 2.0))
        if len(self.asked) != asked:
            self.violation("something was said on a line that is not there")
        return wishes

    def _return(self) -> None:
        with running(self.stand.loop):
            name = self.adapter.put_back()
        self.stand.witness.note(f"plugged in again as {name}")
        self.stand.witness.conduct.lost(self.now)  # nothing older than this may act

    def _polled_again(self) -> None:
        """A drive, and then every drive, has a value that is younger than the return."""
        at, since = self.now, {address: self.newest(address) for address in ADDRESSES}
        waiting, first_s = set(ADDRESSES), inf
        within_s = 2 * BACK_S + self.kind.alike_s
        while waiting and self.now < at + within_s:
            self.stand.loop.run_until(self.now + STEP_S)
            waiting = {address for address in waiting if self.newest(address) <= max(since[address], at)}
            if len(waiting) < len(ADDRESSES):
                first_s = min(first_s, self.now - at)
        self.first_s.append(first_s)
        self.back_s.append(self.now - at)
        self.session.count("every drive polled again: later than 2 s", int(self.back_s[-1] > BACK_S))
        if first_s > BACK_S or waiting:
            self.violation(
                f"G09 first polled again {first_s:.3f} s after the return, "
                f"never within {within_s:g} s: {waiting or '-'}"
            )
        name = self.adapter.found[-1]
        if name != self.adapter.machine.name:
            self.violation(f"F12 opened {name}, where our adapter is {self.adapter.machine.name}")

    def _settle(self, starts: Counter[int], wishes: list[Wish]) -> None:
        """Nothing that was wished before the return starts a motor after it."""
        for address, count in self._motors().items():
            moved = sum(wish.executions for wish in wishes if wish.address == address)
            if count - starts[address] > moved:
                self.violation(f"I10 the motor of {address} was started by nobody")
        self.stand.finish(*(self.stand.wish(address, "stop") for address in ADDRESSES))
        self.stand.run(CALM_S)


def run(session: Session) -> None:
    lines: list[Line] = []
    number = 0
    while session.left:
        line = Line(session, KINDS[number % len(KINDS)], number)
        for _ in range(min(A_LINE, session.left)):
            line.unplug()
            session.did()
        line.stand.close()
        lines.append(line)
        number += 1
    _figures(session, lines)
    _real(session)


def _figures(session: Session, lines: list[Line]) -> None:
    detected = sorted(one for line in lines for one in line.detected_s)
    for kind in KINDS:
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
    session.figures["names of the adapter"] = len({name for line in lines for name in line.adapter.found})


def _real(session: Session) -> None:
    """The same with real descriptors."""
    times = REOPENINGS if session.budget > CAMPAIGN.slice else REOPENINGS_OF_A_SLICE
    found = reopen(times)
    session.figures["real reopenings"] = times
    session.figures["descriptors more after them"] = found["descriptors"]
    session.machine["a hang-up of a real pty noticed at most s"] = round(found["slowest_s"], 4)
    if found["descriptors"] > 0 or found["names"] < 2:
        session.violation(f"G09 {found['descriptors']} descriptors stay open after {times} real reopenings")


CAMPAIGN = Campaign("replug", "unplugs", ("G09", "I10"), 1_000, 60, run)
