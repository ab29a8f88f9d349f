"""Command word of a register-based drive: composed for a command, and decoded for its effect on the motor."""

from __future__ import annotations

from drivebus.drives.dialects.base import Hold, StopMode
from drivebus.drives.state import Direction
from drivebus.errors import CapabilityError
from drivebus.profiles.words import MOTION_VALUES, STOP_COMMANDS, CommandMap
from drivebus.protocols.codec import Effect

STOP_BITS = frozenset(STOP_COMMANDS)
DIRECTION_BITS = frozenset({"forward", "reverse"})
HOLD_BITS = frozenset(Hold)
JOG_BITS = frozenset({"jog_forward", "jog_reverse"})


class CommandBits:
    """Command word whose bits are commands and levels, composed and decoded by the profile's map.

    On a VC660 every write sets all levels, so a stop word 0002H also means "forward": ``levels`` keeps what was sent.
    """

    def __init__(self, commands: CommandMap) -> None:
        self.map = commands
        self._rewrites_levels = commands.rewrite_levels_after_pulse
        self.levels: int | None = None
        """Direction level that the drive holds; None until one was sent or read."""
        self._holds: frozenset[str] | None = None if HOLD_BITS & commands.bits.keys() else frozenset()
        """Holds that were sent and that no accepted word has ended; None: any, as long as nothing was read or sent."""
        self._last_was_edge = False
        """The last word that was sent held a start or reset: the next one completes that edge, and so is no stop."""

    def active_names(self, word: int) -> frozenset[str]:
        """Return the bits and field values in a word; those whose value is 0 are not counted."""
        return frozenset(n for n, b in self.map.bits.items() if b.value and word & b.mask == b.value)

    def is_mapped(self, word: int) -> bool:
        """Return whether a word has mapped bits only: no direction toggle and no reserved bit."""
        covered = 0
        for name in self.active_names(word):
            covered |= self.map.bits[name].mask
        return word & ~covered & 0xFFFF == 0

    def effect(self, word: int) -> Effect:
        """Return the effect of a word. One that only stops, or repeats the held levels, is a stop.

        A word without the hold that the drive may be in lets its motor run, unless it stops it.
        """
        names = self.active_names(word)
        holds = names & HOLD_BITS
        if not self.is_mapped(word) or not names <= STOP_BITS | DIRECTION_BITS | HOLD_BITS | {"reset"}:
            return Effect.MOTION
        keeps_direction = word & self._direction_mask() == (self.levels or 0)
        if names & STOP_BITS:
            only_stops = not holds and "reset" not in names and (self._rewrites_levels or not names & DIRECTION_BITS)
            return Effect.STOP if only_stops else Effect.MOTION
        if "reset" in names:
            return Effect.SETTING if keeps_direction and holds == (self._holds or frozenset()) else Effect.MOTION
        if holds == {Hold.PAUSE}:
            return Effect.SETTING if keeps_direction else Effect.MOTION
        if holds and keeps_direction and holds == self._holds and self._last_was_edge:  # completes a reset
            return Effect.SETTING
        if holds or self._holds != frozenset() or not keeps_direction:
            return Effect.MOTION
        return Effect.SETTING if self._last_was_edge else Effect.STOP

    def _direction_mask(self) -> int:
        mask = 0
        for name in DIRECTION_BITS:
            if name in self.map.bits:
                mask |= self.map.bits[name].mask
        return mask

    def on_sent(self, word: int) -> None:
        """Record that a word was sent."""
        names = self.active_names(word)
        self._last_was_edge = bool(names & {"start", "reset"})
        if names & JOG_BITS:  # a jog begins at standstill, and its end must not depend on a reply
            self._holds = frozenset()
        elif holds := names & HOLD_BITS:
            self._holds = holds | (self._holds or frozenset())
        if self._rewrites_levels:
            self.levels = word & self._direction_mask()

    def on_accepted(self, word: int) -> None:
        """Record that the drive accepted the word that was sent last."""
        self._holds = self.active_names(word) & HOLD_BITS

    def learn_levels(self, *, reverse: bool, paused: bool) -> None:
        """Adopt the set direction that the drive reports, unless a word was sent, and any pause."""
        if self.levels is None:
            self.adopt_direction(reverse=reverse)
        if self._holds is None:
            self._holds = frozenset()
        if paused and Hold.PAUSE in self.map.bits:
            self._holds |= {Hold.PAUSE}

    def adopt_direction(self, *, reverse: bool) -> None:
        """Adopt the set direction of a verified state, also where another one was sent."""
        if self._rewrites_levels:
            self.levels = self.map.bits["reverse"].value if reverse and "reverse" in self.map.bits else 0

    def start(self, direction: Direction | None) -> tuple[int, ...]:
        """Return the words of a start. Raises CapabilityError for a direction that the map lacks."""
        level = 0 if direction is None else self._direction_level(direction)
        return self._pulse_and_levels(self._bit("start"), level)

    def jog(self, direction: Direction) -> tuple[int, ...]:
        """Return the words of a jog, a level that stands until jog_stop."""
        return (self._bit(f"jog_{direction.value}") | (self.levels or 0),)

    def stop(self, mode: StopMode, model: str) -> tuple[int, ...]:
        """Return the pulse with the held levels, then the levels alone."""
        name = "jog_stop" if mode is StopMode.JOG_STOP else mode.value
        if name not in self.map.bits:
            raise CapabilityError("drives.cannot", model=model, what=mode.value)
        pulse = self.map.bits[name].value
        return self._pulse_and_levels(pulse, self.levels or 0) if pulse else (self.levels or 0,)

    def reset(self, model: str) -> tuple[int, ...]:
        """Return the pulse with all held levels, then these alone."""
        if "reset" not in self.map.bits:
            raise CapabilityError("drives.cannot", model=model, what="reset_fault")
        levels = self.levels or 0
        for hold in self._holds or ():
            levels |= self.map.bits[hold].value
        return self._pulse_and_levels(self.map.bits["reset"].value, levels)

    def hold(self, hold: Hold, model: str) -> int:
        """Return the word of a hold with the held direction. Raises CapabilityError for a model without it."""
        if hold not in self.map.bits:
            raise CapabilityError("drives.cannot", model=model, what=hold.value)
        return self.map.bits[hold].value | (self.levels or 0)

    def end_hold(self) -> int:
        """Return the held direction alone."""
        return self.levels or 0

    def _pulse_and_levels(self, pulse: int, level: int) -> tuple[int, ...]:
        return (pulse | level, level) if self._rewrites_levels else (pulse | level,)

    def _bit(self, name: str) -> int:
        if name not in self.map.bits:
            raise CapabilityError("drives.no_command_bit", what=name)
        return self.map.bits[name].value

    def _direction_level(self, direction: Direction) -> int:
        if direction is Direction.FORWARD and direction.value not in self.map.bits:
            return 0
        return self._bit(direction.value)


class CommandValues:
    """Command word that is a number: every write is one whole command, and no level is held."""

    def __init__(self, commands: CommandMap) -> None:
        self.map = commands

    def active_names(self, word: int) -> frozenset[str]:
        """Return the commands that a word means."""
        return frozenset(name for name, value in self.map.values.items() if value == word)

    def is_mapped(self, word: int) -> bool:
        """Return whether a word is one of the commands, or prepares a start."""
        return word in self.map.values.values() or self.map.prepares(word)

    def effect(self, word: int) -> Effect:
        """Return the effect of a word. One that no command has, and that prepares no start, may move the motor."""
        names = self.active_names(word)
        if names & MOTION_VALUES or not (names or self.map.prepares(word)):
            return Effect.MOTION
        return Effect.STOP if names and names <= STOP_BITS else Effect.SETTING

    def on_sent(self, word: int) -> None:
        """Do nothing: no level is held from one word to the next."""

    def on_accepted(self, word: int) -> None:
        """Do nothing: no level is held from one word to the next."""

    def learn_levels(self, *, reverse: bool, paused: bool) -> None:
        """Do nothing: each start names its direction."""

    def adopt_direction(self, *, reverse: bool) -> None:
        """Do nothing: each start names its direction."""

    def start(self, direction: Direction | None) -> tuple[int, ...]:
        """Return the word of a start, forward where none is given. Raises CapabilityError where the map lacks it."""
        return (self._value(f"start_{(direction or Direction.FORWARD).value}"),)

    def jog(self, direction: Direction) -> tuple[int, ...]:
        return (self._value(f"jog_{direction.value}"),)

    def stop(self, mode: StopMode, model: str) -> tuple[int, ...]:
        """Return the word of a stop; a jog without a stop of its own ends with the ordinary one."""
        name = "jog_stop" if mode is StopMode.JOG_STOP and "jog_stop" in self.map.values else mode.value
        name = "stop" if name == StopMode.JOG_STOP.value else name
        if name not in self.map.values:
            raise CapabilityError("drives.cannot", model=model, what=mode.value)
        return (self.map.values[name],)

    def reset(self, model: str) -> tuple[int, ...]:
        if "reset" not in self.map.values:
            raise CapabilityError("drives.cannot", model=model, what="reset_fault")
        return (self.map.values["reset"],)

    def hold(self, hold: Hold, model: str) -> int:
        raise CapabilityError("drives.cannot", model=model, what=hold.value)

    def end_hold(self) -> int:
        raise CapabilityError("drives.no_command_bit", what=Hold.RAMP.value)

    def _value(self, name: str) -> int:
        if name not in self.map.values:
            raise CapabilityError("drives.no_command_bit", what=name)
        return self.map.values[name]


CommandWord = CommandBits | CommandValues


def make_command_word(commands: CommandMap) -> CommandWord:
    """Return the command word of a map, whose options are resolved."""
    return CommandValues(commands) if commands.values else CommandBits(commands)
