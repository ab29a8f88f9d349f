"""The C320 family's dialect: profile data in, requests and readings out. Source: C320 manual 2.3 and 2.4.

A reply does not say which class it answers, so nothing here takes a command's own reply for its confirmation.
"""

from __future__ import annotations

from typing import Any

from drivebus.drives.book import Book, Facts
from drivebus.drives.dialect import (
    Frame,
    Refusal,
    Stop,
    frequency_word,
    parameter_reading,
    period_of,
    reading_of,
    shows,
    signals_in,
    whole_request,
)
from drivebus.drives.sifang_maps import RESPONSES, STATES, STOPS, effect_of, fence_keys
from drivebus.drives.state import Direction, DriveState, Verdict
from drivebus.errors import CapabilityError
from drivebus.message import Codec, Effect, StationLink, StationTiming, WriteClass
from drivebus.profiles.model import DriveProfile, Parameter
from drivebus.protocols.sifang import (
    Control,
    Operation,
    ReadIdentity,
    ReadMonitor,
    ReadParameter,
    Reply,
    SifangCodec,
    State,
    WriteParameter,
)
from drivebus.reading import Quality, Reading, missing

ENOUGH = 4
"""With so many fence tags the bus and our conversations have their own; draft profiles list fewer and share them."""


class SifangDialect:
    """C320 and its sisters (see ``dialect.Dialect``)."""

    can_tell = True
    state_names: tuple[str, ...] = ("state",)
    carries_frequency = True

    def __init__(
        self, profile: DriveProfile, address: int, encoding: Any, settings: dict[str, Any], timing: StationTiming
    ) -> None:
        self.profile, self.address, self.settings = profile, address, settings
        digits, nibble = settings.get("digits", "strict"), bool(settings.get("nibble", False))
        self.codec: Codec = SifangCodec(encoding=encoding, digits=digits, nibble=nibble)
        self._tags = fence_keys(profile)
        self._signals = signals_in(profile, "monitor")
        self._count = 0
        self._last_read: ReadParameter | None = None
        extra = {"stop": self._control(Operation.STOP), "longest": (WriteParameter(address, 0, 0, 0),)}
        self.link = StationLink(address, self.codec, timing, self.effect, self._bus_fence, profile.model, extra)

    def effect(self, frame: bytes) -> Effect:
        """What these bytes do: the operation counts in every class (T01); what can't be read may move."""
        heard = whole_request(self.codec, frame)
        return Effect.MOTION if heard is None else effect_of(heard.request, heard.operation)

    def _bus_fence(self, n: int) -> ReadParameter:
        tags = self._tags[0::2] if len(self._tags) >= ENOUGH else self._tags
        return self._tagged(self._other_group(tags, self._last_read) or tags, n)

    def fence(self, avoid: Any = None) -> ReadParameter:
        tags = self._tags[1::2] if len(self._tags) >= ENOUGH else self._tags
        tags = self._other_group(tags, avoid) or self._other_group(self._tags, avoid) or tags
        self._count += 1
        return self._tagged(tags, self._count)

    @staticmethod
    def _other_group(tags: list[tuple[int, int]], request: Any) -> list[tuple[int, int]]:
        """Tags whose reply can't be that of ``request``: in a fault only the group is echoed."""
        return [tag for tag in tags if not isinstance(request, ReadParameter) or tag[0] != request.group]

    def _tagged(self, tags: list[tuple[int, int]], n: int) -> ReadParameter:
        group, item = tags[n % len(tags)]
        return ReadParameter(self.address, group, item)

    def proves(self, reply: Reply) -> bool:
        """A short reply (6, 7, 8) echoes nothing but the address."""
        return reply.state is not None

    def clashes(self, request: Any) -> bool:
        """Parameter F0.n and monitor d.n share their echo, so do write and read; in a fault the item is gone (T04)."""
        return isinstance(request, ReadParameter)

    def state_reads(self) -> tuple[Any, ...]:
        """Every full reply carries the state; the output frequency is wanted with it."""
        return tuple(request for request, _ in self.polls(("output_frequency",))[:1])

    def polls(self, names: tuple[str, ...]) -> tuple[tuple[Any, float], ...]:
        wanted = {self.profile.signals[name].locator[1] for name in names if self._is_monitor(name)}
        if not wanted:  # every reply carries the state, so any monitor will do
            wanted = {min(self._signals, default=0)}
        return tuple((self._monitor(index), self._period(index, names)) for index in sorted(wanted))

    def _is_monitor(self, name: str) -> bool:
        return name in self.profile.signals and self.profile.signals[name].locator[0] == "monitor"

    def _period(self, index: int, names: tuple[str, ...]) -> float:
        at = tuple(s.name for s in self._signals.get(index, []))
        return period_of(self.profile, tuple(n for n in at if n in names) or at)

    def _monitor(self, index: int) -> ReadMonitor:
        bcd = self.settings.get("monitor_index") == "bcd"
        return ReadMonitor(self.address, int(str(index), 16) if bcd else index)

    def _index(self, item: int) -> int:
        return int(f"{item:X}") if self.settings.get("monitor_index") == "bcd" else item

    def facts(self, request: Any, reply: Reply, at: float | None) -> Facts:
        if isinstance(request, Control):
            known = request.expected_item is not None and reply.item == request.expected_item
            return self._monitored(request.expected_item, reply, at) if known else {}
        if reply.state is None:
            return {}
        found = {"state": Reading(reply.state.name.lower(), "", Quality.GOOD, at, None, int(reply.state))}
        if reply.fault_code is not None:
            found["fault"] = Reading(reply.fault_code, "", Quality.GOOD, at, None, reply.fault_code)
        if isinstance(request, ReadMonitor):
            found |= self._monitored(request.item, reply, at)
        return found

    def _monitored(self, item: int | None, reply: Reply, at: float | None) -> dict[str, Reading]:
        signals = self._signals.get(self._index(item or 0), [])
        if reply.response != 0 or reply.data is None:
            return {signal.name: missing("drives.refused_read", signal.unit) for signal in signals}
        found = {signal.name: reading_of(signal, reply.data, at) for signal in signals}
        if reply.item is not None:
            return found
        if reply.data == 0:  # in a fault nobody can tell "0" from "not carried out" (manual 2.4.6): None is never 0.0
            return {signal.name: missing("drives.item_not_echoed", signal.unit) for signal in signals}
        return {name: _unechoed(reading) for name, reading in found.items()}

    def judge(self, book: Book) -> Verdict | None:
        """Two agreeing states; of two different turning states (a ramp between them) the newer one."""
        pair = book.raw_pair("state")
        if pair is None or any(raw not in STATES for raw in pair):
            return None
        (older, _), (state, direction) = STATES[pair[0]], STATES[pair[1]]
        if older is not state and not (older.turning and state.turning):
            return None
        if state is not DriveState.FAULT:
            return Verdict(state, direction)
        code = book.agreed("fault")
        return None if code is None else Verdict(state, None, code)

    def plain_read(self) -> Any:
        return self.state_reads()[0]

    def fault_reads(self) -> tuple[Any, ...]:
        return ()

    def setpoint_reads(self) -> tuple[Any, ...]:
        return self.polls_of("set_frequency")

    def polls_of(self, name: str) -> tuple[Any, ...]:
        """The request of one monitor; empty where the profile does not name it."""
        return (self._monitor(self.profile.signals[name].locator[1]),) if self._is_monitor(name) else ()

    def setpoint_shown(self, book: Book, word: int, frequency_hz: float) -> bool | None:
        return shows(book, self.profile, frequency_hz)

    def can_wait(self) -> bool:
        return self._is_monitor("output_frequency")

    def stop_seen(self, book: Book) -> bool:
        """An emergency stop stands until it is reset (2.4.6); a frequency that is shown with it says otherwise."""
        pair = book.raw_pair("output_frequency")
        return book.agreed("state") != State.EMERGENCY_STOP or pair is None or not pair[1]

    def start_seen(self, book: Book) -> bool:
        return False

    def refusal(self, reply: Reply) -> Refusal | None:
        """Response codes 1 to 8 (manual 2.4.3)."""
        key = RESPONSES.get(int(reply.response))
        return None if key is None else Refusal(key, int(reply.response))

    def setpoint_word(self, frequency_hz: float) -> int:
        return frequency_word(self.profile, frequency_hz)

    def frequency_of(self, word: int) -> float:
        return self.profile.setpoint_scale.value(word)

    def start(self, direction: Direction | None, word: int) -> tuple[Frame, ...]:
        reverse = direction is Direction.REVERSE
        return self._edge(Operation.RUN_REVERSE_AT if reverse else Operation.RUN_FORWARD_AT, word)

    def set_frequency(self, word: int, book: Book) -> tuple[Frame, ...]:
        return (Frame(self._control(Operation.SET_FREQUENCY, word), WriteClass.ABSOLUTE),)

    def jog(self, direction: Direction, word: int | None) -> tuple[Frame, ...]:
        reverse = direction is Direction.REVERSE
        if word is None:
            return self._edge(Operation.JOG_REVERSE if reverse else Operation.JOG_FORWARD)
        return self._edge(Operation.JOG_REVERSE_AT if reverse else Operation.JOG_FORWARD_AT, word)

    def stop(self, how: Stop) -> tuple[Any, ...]:
        if how not in STOPS:
            raise CapabilityError("drives.cannot", model=self.profile.model, what=how.value)
        return (self._control(STOPS[how]),)

    def stop_everyone(self) -> tuple[Any, ...]:
        broadcast = self.profile.broadcast
        return () if broadcast is None else (Control(broadcast, Operation.STOP),)

    def reset(self) -> tuple[Frame, ...]:
        return self._edge(Operation.RESET_FAULT)

    def _edge(self, operation: Operation, word: int = 0) -> tuple[Frame, ...]:
        return (Frame(self._control(operation, word), WriteClass.EDGE),)

    def _control(self, operation: Operation, word: int = 0) -> Control:
        item = self.settings.get("class4_item")
        return Control(self.address, operation, word, item if isinstance(item, int) and item >= 0 else None)

    def read_parameter(self, parameter: Parameter) -> Any:
        space, index = parameter.locator
        if space == "monitor":
            return self._monitor(index)
        return ReadParameter(self.address, index >> 8, index & 0xFF)

    def parameter_raw(self, reply: Reply) -> int | None:
        hidden = reply.item is None and not reply.data
        return reply.data if reply.response == 0 and not hidden else None

    def parameter_reading(self, parameter: Parameter, raw: int, at: float | None) -> Reading:
        return parameter_reading(parameter, raw, at)

    def parameter_word(self, parameter: Parameter, value: float) -> int:
        return parameter.scale.raw(value)

    def write_parameter(self, parameter: Parameter, raw: int, save: bool) -> Frame:
        index = parameter.locator[1]
        request = WriteParameter(self.address, index >> 8, index & 0xFF, raw, save)
        return Frame(request, WriteClass.EEPROM if save else WriteClass.ABSOLUTE)

    def lawful(self, frame: bytes) -> bool:
        """An operation only in a control frame (T07), and nothing but a stop to everybody (matrix: broadcast X)."""
        heard = whole_request(self.codec, frame)
        if heard is None or heard.request.address == self.profile.broadcast:
            return False
        return isinstance(heard.request, Control) or heard.operation is Operation.NONE

    def settle(self, setting: str, value: Any) -> None:
        self.settings[setting] = value

    def noted(self, request: Any) -> None:
        """The last parameter read, so that the bus's next fence is not like it."""
        if isinstance(request, ReadParameter):
            self._last_read = request

    def identity_reads(self) -> tuple[ReadIdentity, ...]:
        """Class 0, groups 0 to 3."""
        return tuple(ReadIdentity(self.address, group) for group in range(4))


def _unechoed(reading: Reading) -> Reading:
    """In a fault the reply does not say which monitor it carries (T05)."""
    return Reading(
        reading.value, reading.unit, Quality.UNCERTAIN, reading.source_time, "drives.item_not_echoed", reading.raw
    )
