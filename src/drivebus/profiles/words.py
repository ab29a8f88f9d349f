"""Command word and status word of a register-based model as frozen values, and the words before a start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal


@dataclass(frozen=True, slots=True)
class CommandBit:
    """Bit of a command word, or value of its field under ``mask``."""

    mask: int
    value: int
    pulse: bool = False
    """It acts on its edge; otherwise it is a level that every write sets."""


STOP_COMMANDS = ("stop", "coast", "quick_stop", "jog_stop")
"""Commands that are sent without a permit."""
MOTION_COMMANDS = ("start", "jog_forward", "jog_reverse")
"""Commands of a word of bits that move the motor."""
MOTION_VALUES = frozenset({"start_forward", "start_reverse", "jog_forward", "jog_reverse"})
"""Commands of a word that is a number that move the motor."""


@dataclass(frozen=True, slots=True)
class FixedWrite:
    """Value that is written to a register of its own."""

    register: int
    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandMap:
    """Command word of a register-based model. The model can't do what is absent from ``bits`` and ``values``."""

    register: int
    bits: Mapping[str, CommandBit]
    """Name (``schema.CommandName``) to its bit."""
    setpoint_register: int
    rewrite_levels_after_pulse: bool
    values: Mapping[str, int]
    """Name (``schema.CommandValueName``) to the whole word, where the command word is a number. Then there are no
    ``bits``."""
    variants: Mapping[str, Mapping[str, Mapping[str, CommandBit]]]
    """Option to its values to the bits that apply only under that value."""
    words: int
    """Registers of the command word, such as run and direction: a frame writes them all."""
    written_to: Literal["register", "coils", "coil"]
    """coils: the bits of the word are the coils from ``register`` on, in one frame; coil: the word counts from
    ``register`` to the one coil that is switched on."""
    coil_count: int
    """Coils of the word where it is written to coils."""
    reset: FixedWrite | None
    """Fault reset outside the command word."""
    unlock: FixedWrite | None
    """Write without which the drive rejects every command; it moves nothing."""
    preparation: tuple[StartStep, ...]
    """Words before a start, in their order."""
    ready: WordMatch | None
    """Status in which a start word may be sent; None where any stopped state will do."""
    reset_on_edge: bool
    """The stop word is sent before the reset, so that the bit of the reset rises."""

    @property
    def space(self) -> str:
        """Space of the command word's locator."""
        return "holding" if self.written_to == "register" else "coil"

    @property
    def status_steps(self) -> tuple[StartStep, ...]:
        """Words before a start that the status asks for."""
        return tuple(step for step in self.preparation if step.when is not None)

    def prepares(self, word: int) -> bool:
        """Return whether a word is one of those before a start."""
        return any(step.word == word for step in self.preparation)

    def resolved(self, options: Mapping[str, Any]) -> CommandMap:
        """Return the map with the bits of these option values added; an unknown value adds none."""
        bits = dict(self.bits)
        for setting, choices in self.variants.items():
            bits |= choices.get(str(options.get(setting)), {})
        return replace(self, bits=bits, variants={})


@dataclass(frozen=True, slots=True)
class WordMatch:
    """Part of a status word and the value that it must have."""

    mask: int
    value: int

    def matches(self, word: int) -> bool:
        """Return whether a status word has the value."""
        return word & self.mask == self.value


@dataclass(frozen=True, slots=True, kw_only=True)
class StartStep:
    """Word that a drive needs before it accepts a start; it moves nothing."""

    when: WordMatch | None
    """Status in which the word is sent; None for a word before every start, which its reply alone confirms."""
    word: int
    until: WordMatch | None
    """Status that the word brings about; None without ``when``."""
    timeout_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusMap:
    """Status word of a register-based model: bit masks by name, or the name of each value."""

    register: int
    bits: Mapping[str, int]
    """Name (``schema.StatusName``) to its mask."""
    reserved_mask: int
    """Bits that must read 0; otherwise the word is rejected."""
    fault_registers: tuple[int, ...]
    values: Mapping[int, str]
    """Value to its state (``schema.StatusValueName``), of a status word that is a number; any other is rejected."""
    mask: int
    """Part of the word that ``values`` count."""
    numbers_fault: bool
    """A fault register holds the number of one fault, 0 for none; otherwise a bit for each."""
    fault_mask: int
    """Field of the number; its lowest bit counts 1."""
    standstill: Literal["status", "output_frequency", "output_speed", "status_alone"]
    """output_frequency: a word without motion means decelerating until the signal output_frequency reads 0. status:
    that signal need not be read, but contradicts such a word; status_alone: it does not, being not 0 at rest."""
    space: Literal["holding", "input", "coil", "discrete"]
    """Space of the status word; the bits of one of coils are those from ``register`` on."""

    @property
    def standstill_signal(self) -> str | None:
        """Signal that must read 0 before the drive counts as stopped; None where the word alone can show that."""
        return None if self.standstill in ("status", "status_alone") else self.standstill

    @property
    def bit_count(self) -> int:
        """Bits that the profile names, from the lowest of the word to the highest."""
        return max(mask.bit_length() for mask in self.bits.values() or (self.mask,))

    def set_bits(self, word: int) -> tuple[str, ...]:
        """Return the names of the bits that a word has set; empty where the word is a number."""
        return tuple(name for name, mask in self.bits.items() if word & mask)

    def fault_number(self, word: int) -> int:
        """Return the number in the field of a fault register."""
        return (word & self.fault_mask) // (self.fault_mask & -self.fault_mask)

    @property
    def shows_fault(self) -> bool:
        """Whether the status word itself shows that the drive is in fault."""
        return "fault" in self.bits or "fault" in self.values.values()

    def reports_fault(self, word: int) -> bool:
        """Return whether a valid status word shows that the drive is in fault, also where it still turns."""
        if not self.values:
            return bool(word & self.bits.get("fault", 0))
        value, bits = word & self.mask, self._fault_bits
        beside_motion = bool(bits) and value & bits == bits and self.values.get(value ^ bits) == self.values[value]
        return self.values[value] == "fault" or beside_motion

    @property
    def _fault_bits(self) -> int:
        """Bits that all values "fault" share and no other value has, except one that names a motion."""
        shared, other = 0xFFFF, 0
        for value, name in self.values.items():
            shared &= value if name == "fault" else 0xFFFF
            other |= value if name in ("stopped", "not_ready") else 0
        return shared & ~other if self.shows_fault else 0
