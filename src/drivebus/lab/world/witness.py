"""The observer of a stand: sees the bytes on the copper, the motors and what users were told, and nothing else.

It shares no code with the bus, the drives or the codecs: what a frame does it reads with ``manual``, times it knows
from ``kinds``. Every event is held against the invariants I1 to I12, here and in ``conduct``, ``writes`` and
``truth``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf
from typing import Any

from drivebus import seams
from drivebus.lab.bounds import character_s
from drivebus.lab.campaign import Session
from drivebus.lab.kinds import Kind
from drivebus.lab.manual import Does, request
from drivebus.lab.world.conduct import Conduct, Frame
from drivebus.lab.world.deeds import Deeds
from drivebus.lab.world.outcomes import check_outcome
from drivebus.lab.world.wishes import Wish
from drivebus.lab.world.writes import Writes
from drivebus.message import Answer

REMEMBERED = 64
"""So many frames and deliveries are remembered: an answer refers to one of the last few."""


class Witness:
    """Watches one bench. Everything that it finds goes to the session."""

    def __init__(self, session: Session, kind: Kind, bench: Any, name: str, now: Callable[[], float]) -> None:
        self.session, self.kind, self.bench, self.name, self.now = session, kind, bench, name, now
        self.frames = self.replies = self.accepted = self.made = 0
        self.wishes: dict[int, list[Wish]] = {}
        """Open wishes by address."""
        self.conduct = Conduct(kind, character_s(bench.line), self.violation)
        self._writes = Writes(kind, self.violation)
        self._asked: deque[tuple[Any, Frame]] = deque(maxlen=REMEMBERED)
        self._said: deque[tuple[Any, Frame | None]] = deque(maxlen=REMEMBERED)
        """Replies, with the request that caused each."""
        self._heard: deque[tuple[float, Any]] = deque(maxlen=REMEMBERED)
        """What reached a host, and when."""
        self.heard_at: dict[Any, float] = {}
        """When each drive was last heard at all."""
        self._heard_end = -inf
        """The end of the last character that reached a host: what collided with an earlier one is swallowed."""
        self._obeying: Frame | None = None
        self._asking: list[tuple[bytes, Wish]] = []
        """Frames that users' commands wait for."""
        self.deeds: dict[int, Deeds] = {}
        """What became of each drive, by address."""
        self._tap()

    # --- the tap on the copper -----------------------------------------------------------------------------------

    def _tap(self) -> None:
        bench = self.bench
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
            self.heard_at[getattr(said.talker, "address", None)] = self.now()
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
        heard, deeds = station.heard, Deeds(station, self.now, self.note)
        self.deeds[station.address] = deeds

        def on_heard(message: Any, codec: Any, line: Any, now: float, **named: Any) -> Any:
            station.advance(now)
            before = _state(station)
            frames = station.frames
            said = heard(message, codec, line, now, **named)
            if self._obeying is not None and station.frames > frames:
                deeds.heard(self._obeying)
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
        frame = Frame(said.start, said.end, address, does, self._asker(data, does))
        self._line(f"> {address} {does} {data.hex()}", said.start)
        last_end = self._asked[-1][1].end if self._asked else 0.0
        answered = any(last_end < one.end <= said.start + 1e-9 for _, one in reversed(self._heard))
        if does is not Does.READ and address not in self.deeds:
            self.session.count("acting frames to drives that are not there (G19)")
        if does is not Does.READ:
            self._writes.sent(frame, data, seams.wall_clock().date())
        self.conduct.asked(frame, self._heard_end, answered)
        self._asked.append((said, frame))

    def _acted(self, station: Any, frame: Frame, was_on: bool) -> None:
        """I2, I11: a frame changed something in this station."""
        started = station.motor.energised and not was_on
        if frame.does is Does.READ or (frame.does is Does.STOP and started):
            self.violation(f"I11 a {frame.does} changed station {station.address}")
        if not started:
            return
        self.note(f"motor {station.address} on")
        deeds, wish = self.deeds[station.address], frame.wish
        stood_unseen = deeds.stood_unseen
        deeds.switched_on(wish)
        if wish is None:
            return
        wish.executions += 1
        if wish.executions > 1 and not stood_unseen:
            self.violation(f"I2 {wish} switched the motor on {wish.executions} times")
        elif wish.executions > 1:
            self.session.count("resent after a person at the drive had stopped it unseen (ruling 6)")

    @contextmanager
    def asking(self, wish: Wish, data: bytes) -> Iterator[None]:
        """While this lasts, a frame of these bytes is this wish's."""
        entry = data, wish
        self._asking.append(entry)
        try:
            yield
        finally:
            self._asking.remove(entry)

    def _asker(self, data: bytes, does: Does) -> Wish | None:
        """The wish that this frame serves; stops and what follows them need none."""
        if does in (Does.READ, Does.STOP, Does.REST):
            return None
        wish = next((wish for asked, wish in self._asking if asked == data), None)
        if wish is not None:
            wish.sent += 1
        return wish

    # --- what users wish and are told ----------------------------------------------------------------------------

    def wished(self, address: int, what: str, arguments: tuple[Any, ...]) -> Wish:
        """A user gives a command now."""
        self.made += 1
        wish = Wish(self.made, address, what, arguments, self.now(), seams.wall_clock().date())
        self.wishes.setdefault(address, []).append(wish)
        if address in self.deeds:
            self.deeds[address].wished(wish)
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
        deeds = self.deeds.get(wish.address)
        if deeds is None and wish.word in ("confirmed", "acknowledged"):
            self.violation(f"G19 {wish}: {wish.word}, and there is no such drive")
        elif deeds is not None:
            check_outcome(wish, deeds, self.kind.tells, self.violation)

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
