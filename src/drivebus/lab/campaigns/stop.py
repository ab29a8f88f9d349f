"""Stops at random instants of a full bus: the next frame on its bus, in time, and never called what it is not."""

from __future__ import annotations

from collections import defaultdict
from math import inf

from drivebus.bus import Poll, arithmetic
from drivebus.drives import StopReport, bus_stop
from drivebus.errors import StopUnconfirmed
from drivebus.lab.campaign import Campaign, Session
from drivebus.lab.kinds import KINDS, Kind
from drivebus.lab.world.crowd import ADDRESSES, Crowd
from drivebus.lab.world.loop import running
from drivebus.lab.world.stopwatch import Sent, StopWatch, Waiting
from drivebus.lab.world.wishes import Wish

A_LINE = 50
"""Instants on one line, before another one is built."""
CALM_S = 20.0
"""After the last instant every drive is heard again; so much later each one that was told to must stand."""
ALARM_S = 2.0
"""G07: confirmed or alarmed by T_stop + this + the ramp …"""
LOOKS = 16
"""… but where a drive answers at its limit, two looks and two stops may take so many transactions, and longer."""


class Line(Crowd):
    """One crowded line, and the stops that are wished on it."""

    def __init__(self, session: Session, kind: Kind, number: int) -> None:
        super().__init__(session, kind, number)
        self.watch = StopWatch(self.stand, self._left)
        self.alone_s: list[tuple[float, float]] = []
        """To the first and to the last bit, of stops that neither another stop nor a late reply held back."""
        self.turns_s = 0.0
        self.told_s = 0.0
        self.pause_s = 0.0
        """The longest that a pending stop was not repeated."""
        self.begin()
        self._check_bound()

    def _check_bound(self) -> None:
        """5.1 (3): what the product tells its user is the same bound."""
        polls = [
            (
                drive.dialect.link,
                [Poll(request, 0.0) for request, _ in drive.dialect.polls(tuple(drive.profile.signals))],
            )
            for drive in self.stand.drives.values()
        ]
        told = arithmetic(polls, self.stand.bus.line).drives[ADDRESSES[0]].stop_bound_s
        if abs(told - self.watch.times.stop_bound_s) > 1e-9:
            self.violation(f"G06 the bus tells a bound of {told:.6f} s, it is {self.watch.times.stop_bound_s:.6f} s")

    def violation(self, text: str) -> None:
        self.stand.witness.violation(text)

    # --- one instant -----------------------------------------------------------------------------------------------

    def instant(self) -> None:
        """Let a while pass, and wish for a stop."""
        self.wait()
        self._watch_pending()
        self.disturb()
        self.session.count(f"wished while {self.watch.phase()}")
        if self.rng.random() < 0.25 and not any(self.open.values()):
            self._everybody()
        else:
            self._one(self.rng.choice(ADDRESSES))

    def _watch_pending(self) -> None:
        for address, drive in self.stand.drives.items():
            if drive.stop_pending:
                since_s = self.stand.loop.time() - self.watch.stopped_at.get(address, inf)
                self.pause_s = max(self.pause_s, since_s)

    def _one(self, address: int) -> None:
        capabilities = self.stand.drives[address].profile.capabilities
        how = self.rng.choice([name for name in ("stop", "coast", "quick_stop") if name in capabilities])
        wait = self.rng.random() < 0.5
        self.watch.wished(address)
        wish = self.stand.wish(address, how, wait=wait)
        self._opened(wish)
        assert wish.task is not None
        wish.task.add_done_callback(lambda _: self._ended(wish, wait, self.watch.times.stop_bound_s))

    def _opened(self, wish: Wish) -> None:
        self.open[wish.address].append(wish)
        self.to_stand.add(wish.address)

    def _everybody(self) -> None:
        stand, everybody = self.stand, self.kind.broadcast
        hear = "broadcast_stop" in stand.drives[ADDRESSES[0]].profile.capabilities and everybody is not None
        for address in (everybody or 0,) if hear else ADDRESSES:
            self.watch.wished(address)
        wishes = [stand.witness.wished(address, "stop", ("everybody",)) for address in ADDRESSES]
        for wish in wishes:
            self._opened(wish)
        with running(stand.loop):
            stand.loop.create_task(self._stop_all(wishes))

    async def _stop_all(self, wishes: list[Wish]) -> None:
        report: StopReport = await bus_stop(self.stand.bus, list(self.stand.drives.values()))
        self.stand.bus.release()
        for wish, (_, outcome) in zip(wishes, report.outcomes, strict=True):
            wish.outcome, wish.error = outcome, None if outcome.done else StopUnconfirmed(outcome.key)
            self.stand.witness.ended(wish)
            self._ended(wish, False, inf)
        if report.confirmed != all(outcome.word == "confirmed" for _, outcome in report.outcomes):
            self.violation(f"I3 a bus stop with {report.outcomes} is called confirmed: {report.confirmed}")

    # --- what came of it -------------------------------------------------------------------------------------------

    def _left(self, one: Waiting, sent: Sent) -> None:
        first_s, last_s = sent.start - one.at, sent.end - one.at
        if one.babbled:
            self.session.count("held back by a late reply")
        elif one.turnaround or self.kind.broadcast in one.before:
            self.session.count("after a broadcast")
        else:
            self.session.count(f"after {len(one.before)} other drives' stops")
            if not one.before:
                self.alone_s.append((first_s, last_s))
        self.turns_s = max(self.turns_s, last_s)

    def _ended(self, wish: Wish, waited: bool, bound_s: float) -> None:
        self.open[wish.address].remove(wish)
        if wish.outcome is None or wish.ended_at is None:
            return self.violation(f"G07 {wish} ended with {wish.error!r}")
        unsure = isinstance(wish.error, StopUnconfirmed)
        if not wish.outcome.done and not unsure and (waited or wish.outcome.key != "drives.stop_answered"):
            self.violation(f"G07 {wish} is {wish.word}, and nobody was alarmed")
        if wish.outcome.done and unsure:
            self.violation(f"G07 {wish} is {wish.word}, told as {wish.error!r}")
        if waited and unsure and not self.stand.drives[wish.address].stop_pending:
            self.violation(f"G07 {wish} is {wish.word}, and it is not repeated")
        took_s = wish.ended_at - wish.at
        if waited:
            self.told_s = max(self.told_s, took_s - self.ramp_s)
            over_s = took_s - bound_s - self.ramp_s
            self.session.count("alarmed later than G07 says, at a drive's limit", int(over_s > ALARM_S))
            if over_s > max(ALARM_S, LOOKS * self.watch.times.probe_s if self.kind.tells else 0.0):
                self.violation(f"G07 {wish} was {wish.word} after {took_s:.3f} s")
        return None

    def finish(self) -> None:
        """Every drive hears again: in the end all stand."""
        self.calm()
        self.stand.run(CALM_S)
        self.watch.finish()
        for address in sorted(self.to_stand) if self.kind.tells else ():
            pending = self.stand.drives[address].stop_pending
            if self.stand.station(address).motor.energised or self.open[address] or pending:
                self.violation(f"G07 drive {address} was told to stop, and its motor is on or it is still being told")
        self.stand.close()


def run(session: Session) -> None:
    found: dict[str, list[Line]] = defaultdict(list)
    number = 0
    while session.left:
        kind = KINDS[number % len(KINDS)]
        line = Line(session, kind, number)
        for _ in range(min(A_LINE, session.left)):
            line.instant()
            session.did()
        line.finish()
        found[kind.name].append(line)
        number += 1
    session.figures.update({name: _figures(lines) for name, lines in found.items()})


def _figures(lines: list[Line]) -> dict[str, float]:
    """Milliseconds and seconds of virtual time."""
    bound_s = lines[0].watch.times.stop_bound_s
    first = sorted(first for line in lines for first, _ in line.alone_s)
    last = sorted(last for line in lines for _, last in line.alone_s)
    shares = {f"p{share:g}": last[min(len(last) - 1, int(len(last) * share / 100))] for share in (50, 99, 99.9, 100)}
    return {
        "bound ms": round(bound_s * 1000, 3),
        **{f"last bit {name} ms": round(value * 1000, 3) for name, value in shares.items()},
        "first bit at most ms": round(first[-1] * 1000, 3),
        "worst / bound": round(last[-1] / bound_s, 4),
        "last bit after other stops, at most ms": round(max(line.turns_s for line in lines) * 1000, 3),
        "confirmed or alarmed, less the ramp, at most s": round(max(line.told_s for line in lines), 3),
        "not repeated while pending, at most s": round(max(line.pause_s for line in lines), 3),
    }


CAMPAIGN = Campaign("stop", "instants", ("G06", "G07", "I3"), 100_000, 600, run)
