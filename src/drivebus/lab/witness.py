"""The observer of a stand: sees the bytes on the copper, the motors and what users were told, and nothing else.

It shares no code with the bus, the drives or the codecs: what a frame does it reads with ``manual``, times it knows
from ``kinds``. Every event is held against the invariants I1 to I12, here and in ``conduct`` and ``truth``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from math import inf
from typing import Any

from drivebus.lab.campaign import Session
from drivebus.lab.conduct import Conduct, Frame
from drivebus.lab.kinds import Kind
from drivebus.lab.manual import Does, request
from drivebus.lab.truth import check_outcome
from drivebus.lab.wishes import Wish
from drivebus.message import Answer
from drivebus.sim.bench import Bench

REMEMBERED = 64
"""So many frames and deliveries are remembered: an answer refers to one of the last few."""


class Witness:
    """Watches one bench. Everything that it finds goes to the session."""

    def __init__(self, session: Session, kind: Kind, bench: Bench, name: str, now: Callable[[], float]) -> None:
        self.session, self.kind, self.bench, self.name, self.now = session, kind, bench, name, now
        self.frames = self.replies = self.accepted = self.made = 0
        self.wishes: dict[int, list[Wish]] = {}
        """Open wishes by address."""
        self.conduct = Conduct(kind, bench.line.character_s, self.violation)
        self._asked: deque[tuple[Any, Frame]] = deque(maxlen=REMEMBERED)
        self._said: deque[tuple[Any, Frame | None]] = deque(maxlen=REMEMBERED)
        """Replies, with the request that caused each."""
        self._heard: deque[tuple[float, Any]] = deque(maxlen=REMEMBERED)
        """What reached a host, and when."""
        self._heard_end = -inf
        """The end of the last character that reached a host: what collided with an earlier one is swallowed."""
        self._obeying: Frame | None = None
        self._tap()

    # --- the tap on the copper -----------------------------------------------------------------------------------

    def _tap(self) -> None:
        bench: Any = self.bench
        bench.now()  # the bench moves into this loop: its wire is a new one
        say, to_hosts, dispatch = bench.wire.say, bench._to_hosts, bench._dispatch

        def on_say(talker: Any, data: bytes, *more: Any, **named: Any) -> Any:
            said = say(talker, data, *more, **named)
            if hasattr(talker, "hear"):
                self._on_request(said, data)
            else:
                self.replies += 1
                self._said.append((said, self._obeying))
                self._line(f"< {talker.address} {data.hex()}", said.start)
            return said

        def on_to_hosts(said: Any, first: int, last: int) -> None:
            self._heard.append((self.now(), said))
            kept = [index for index in range(first, last) if index not in said.dropped]
            if kept:
                self._heard_end = max(self._heard_end, said.start + (kept[-1] + 1) * said.character_s)
            to_hosts(said, first, last)

        def on_dispatch(frame: Any, stations: Any, said: Any, now: float) -> None:
            self._obeying = next((known for one, known in reversed(self._asked) if one is said), None)
            dispatch(frame, stations, said, now)
            self._obeying = None

        bench.wire.say, bench._to_hosts, bench._dispatch = on_say, on_to_hosts, on_dispatch
        for station in bench.stations:
            self.watch(station)

    def watch(self, station: Any) -> None:
        """See what each frame does to the motor of this station (for one that joins later)."""
        heard = station.heard

        def on_heard(message: Any, codec: Any, line: Any, now: float, **named: Any) -> Any:
            station.advance(now)
            before = _state(station)
            said = heard(message, codec, line, now, **named)
            if _state(station) != before and self._obeying is not None:
                self._acted(station, self._obeying, was_on=bool(before[0]))
            return said

        station.heard = on_heard

    def _on_request(self, said: Any, data: bytes) -> None:
        self.frames += 1
        try:
            address, does = request(self.kind.model, self.kind.encoding, data)
        except (ValueError, IndexError) as error:
            self.violation(f"I7 no manual knows the request {data.hex(' ')}: {error}")
            return
        frame = Frame(said.start, said.end, address, does)
        self._line(f"> {address} {does} {data.hex()}", said.start)
        last_end = self._asked[-1][1].end if self._asked else 0.0
        answered = any(last_end < one.end <= said.start + 1e-9 for _, one in reversed(self._heard))
        wish = self._wish_of(address, does)
        self.conduct.asked(frame, wish, self._heard_end, answered)
        self._asked.append((said, frame))

    def _acted(self, station: Any, frame: Frame, was_on: bool) -> None:
        """I2, I11: a frame changed something in this station."""
        started = station.motor.energised and not was_on
        if frame.does is Does.READ or (frame.does is Does.STOP and started):
            self.violation(f"I11 a {frame.does} changed station {station.address}")
        if not started:
            return
        self.note(f"motor {station.address} on")
        wish = self._wish_of(station.address, Does.MOVE)
        if wish is not None:
            wish.executions += 1
            if wish.executions > 1:
                self.violation(f"I2 {wish} switched the motor on {wish.executions} times")

    def _wish_of(self, address: int, does: Does) -> Wish | None:
        """The newest open wish that such a frame can belong to."""
        if does in (Does.READ, Does.STOP):
            return None
        for wish in reversed(self.wishes.get(address, ())):
            new_frequency = wish.what == "set_frequency" and self.kind.model == "dzb100"  # its frame is a run command
            if not wish.stops and (wish.moves or new_frequency or does is not Does.MOVE):
                return wish
        return None

    # --- what users wish and are told ----------------------------------------------------------------------------

    def wished(self, address: int, what: str, arguments: tuple[Any, ...]) -> Wish:
        """A user gives a command now."""
        self.made += 1
        wish = Wish(self.made, address, what, arguments, self.now())
        self.wishes.setdefault(address, []).append(wish)
        self.note(f"* {wish}")
        if wish.stops:
            self.conduct.stop_wished(wish, bool(self.bench.hosts))
        return wish

    def ended(self, wish: Wish) -> None:
        """The user has been told; was it true?"""
        wish.ended_at = self.now()
        self.wishes[wish.address].remove(wish)
        self.session.count(f"{wish.what}: {wish.word}")
        self.note(f"= {wish} {wish.word}")
        self.bench.advance()
        for station in self.bench.stations:
            if station.address == wish.address:
                since = [one for one in self.wishes[wish.address] if one.moves]
                check_outcome(wish, station, self.kind.tells, bool(since), self.violation)

    def answered(self, answer: Answer) -> None:
        """I5: an accepted reply is the one that the station gave to this very request."""
        if answer.error is not None or answer.reply is None:
            return
        self.accepted += 1
        for said, cause in reversed(self._said):
            if cause is not None and cause.start == answer.sent_at and (answer.received_at, said) in self._heard:
                return
        self.violation(f"I5 {answer.received.hex()} was taken for the answer to {answer.sent.hex()}")

    def unplugged(self) -> None:
        """The adapter is pulled now."""
        self.conduct.lost(self.now())
        self.note("unplugged")

    # --- telling -------------------------------------------------------------------------------------------------

    def note(self, text: str) -> None:
        """One line of the trace, now."""
        self._line(text, self.now())

    def _line(self, text: str, at: float) -> None:
        self.session.line(f"{at:.6f} {self.name} {text}")

    def violation(self, text: str) -> None:
        """Of this line, at this moment."""
        self.session.violation(f"seed {self.session.seed}, {self.now():.6f} s, {self.name}: {text}")


def _state(station: Any) -> tuple[object, ...]:
    motor, memory = station.motor, station.memory
    return (
        motor.energised,
        motor.target_hz,
        station.setpoint_hz,
        memory.ram_writes.total(),
        memory.eeprom_writes.total(),
    )
