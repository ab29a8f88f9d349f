"""Questions about a Modbus drive, in the order in which its manual gives the facts.

An answer is kept as the text that the user wrote, so that an unfinished dialogue can be continued. ``UNKNOWN`` stands
for a fact that the manual does not give: it becomes an open question of the profile, or a function that the profile
lacks, and never a guess; only the step of the setpoint is assumed then, and marked so.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

from drivebus.protocols.modbus.messages import MAX_READ
from drivebus.serial_settings import SerialSettings

T = TypeVar("T")
UNKNOWN = "?"
Answers = Mapping[str, str]
"""Name of each question to the text of its answer."""

MARKED_HEX = re.compile(r"0[xX]([0-9A-Fa-f]{1,4})|([0-9A-Fa-f]{1,5})[hH]")
MARKED_DECIMAL = re.compile(r"([0-9]{1,5})[dD]|([0-9])")
"""A number of several digits without a mark may be either: it is rejected."""
NUMBERING = ("hex", "decimal", "40001", "one")
"""How a manual numbers registers: hexadecimal or decimal as on the wire, or from 40001 or 1 for register 0."""
LEAST_READ = 2
"""Registers in one read where the manual gives no number: the sync probe needs two."""
FIRST_REGISTER = {"decimal": 0, "40001": 40001, "one": 1}

Kind = Literal[
    "name", "text", "format", "addresses", "choice", "register", "neighbour", "word", "bit", "number", "rejected_read"
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """Question about one fact, with the texts ``profile_new.ask_<name>`` and ``profile_new.expect_<kind>``."""

    name: str
    kind: Kind
    default: str | None = None
    """Offered answer."""
    may_be_unknown: bool = False
    """The manual may lack the fact, although no answer is offered."""
    choices: tuple[str, ...] = ()
    span: tuple[float, float] = (0.0, 0.0)
    """Lowest and highest number."""
    is_asked: Callable[[Answers], bool] = lambda answers: True

    @property
    def accepts_unknown(self) -> bool:
        return self.may_be_unknown or self.default == UNKNOWN


def parse_word(text: str) -> int:
    """Return a word 0 to 65535, written 0012H, 0x12, 18d, or as one digit. Raises ValueError."""
    if match := MARKED_HEX.fullmatch(text):
        value = int(match[1] or match[2], 16)
    elif match := MARKED_DECIMAL.fullmatch(text):
        value = int(match[1] or match[2])
    else:
        raise ValueError(text)
    return _require(value, value <= 0xFFFF)


def parse_register(text: str, numbering: str) -> int:
    """Return the address on the wire of a register as the manual numbers it. Raises ValueError.

    An address with H or 0x is always that of the wire.
    """
    if MARKED_HEX.fullmatch(text):
        return parse_word(text)
    value = int(text, 16) if numbering == "hex" else int(text) - FIRST_REGISTER[numbering]
    return _require(value, 0 <= value <= 0xFFFF)


def parse_answer(question: Question, text: str, answers: Answers) -> Any:
    """Return the fact that an answer gives; a bit as its mask. Raises ValueError."""
    match question.kind:
        case "word":
            return parse_word(text)
        case "register":
            return parse_register(text, answers["numbering"])
        case "neighbour":
            register = parse_register(text, answers["numbering"])
            known = readable_registers(answers)
            own = {register} if known else {register, register + 1}
            is_beside = not known or bool({register - 1, register + 1} & known)
            return _require(register, is_beside and max(own) <= 0xFFFF and not own & (known | _written(answers)))
        case "number":
            return _require(float(text), question.span[0] <= float(text) <= question.span[1])
        case "rejected_read":
            return _require(int(text), most_registers(answers) < int(text) <= MAX_READ)
        case "bit":
            return 1 << _require(int(text), 0 <= int(text) <= 15)
        case "addresses":
            low, _, high = text.partition("-")
            return _require((int(low), int(high)), 1 <= int(low) <= int(high) <= 247)
        case "format":
            SerialSettings.parse(9600, text)
            return text
        case "choice":
            return _require(text, text in question.choices)
        case "name":
            return _require(text, re.fullmatch(r"[a-z][a-z0-9_]*", text) is not None)
        case "text":
            return _require(text, bool(text.strip()))


def _require(value: T, holds: bool) -> T:
    """Return the value. Raises ValueError if the condition does not hold."""
    if not holds:
        raise ValueError(value)
    return value


def is_known(answers: Answers, name: str) -> bool:
    """Return whether a question has an answer other than ``UNKNOWN``."""
    return answers.get(name, UNKNOWN) != UNKNOWN


def _with(name: str, value: str | None = None) -> Callable[[Answers], bool]:
    """Return a condition: another fact is known, or has one value."""
    return lambda answers: is_known(answers, name) if value is None else answers.get(name) == value


def _has_state_and_frequency(answers: Answers) -> bool:
    return is_known(answers, "status_register") and is_known(answers, "frequency_register")


def readable_registers(answers: Answers) -> set[int]:
    """Return the registers that the answers name and that each poll may read."""
    names = ("status_register", "frequency_register", "current_register")
    return {fact(answers, name) for name in names if is_known(answers, name)}


def _written(answers: Answers) -> set[int]:
    names = ("command_register", "setpoint_register")
    return {fact(answers, name) for name in names if is_known(answers, name)}


def most_registers(answers: Answers) -> int:
    """Return the most registers that one read may have; where the manual gives no number, what the sync probe needs."""
    return int(fact(answers, "max_read") or LEAST_READ)


def _may_reject_a_read(answers: Answers) -> bool:
    """Return whether a read that the drive rejects could recognize a late reply: of RTU, and without loop-back."""
    return answers.get("encoding") == "rtu" and answers.get("loopback") != "yes"


def _lacks_neighbours(answers: Answers) -> bool:
    """Return whether nothing recognizes a late reply: no loop-back, rejected read, nor read of two known registers."""
    known = readable_registers(answers)
    has_probe = answers.get("loopback") == "yes" or is_known(answers, "rejected_read")
    return not has_probe and most_registers(answers) > 1 and not any(register + 1 in known for register in known)


def _status_is(kind: str) -> Callable[[Answers], bool]:
    return lambda answers: is_known(answers, "status_register") and answers.get("status_kind") == kind


QUESTIONS = (
    Question(name="model", kind="name"),
    Question(name="maker", kind="text"),
    Question(name="title", kind="text"),
    Question(name="source", kind="text"),
    Question(name="encoding", kind="choice", choices=("rtu", "ascii"), default="rtu"),
    Question(name="baud", kind="number", span=(300, 4_000_000), default="9600"),
    Question(name="format", kind="format", default="8N1"),
    Question(name="addresses", kind="addresses", default="1-247"),
    Question(name="serial_page", kind="text", default=UNKNOWN),
    Question(name="numbering", kind="choice", choices=NUMBERING),
    Question(name="write_function", kind="choice", choices=("6", "16"), default="6"),
    Question(name="max_read", kind="number", span=(1, MAX_READ), default=UNKNOWN),
    Question(
        name="reply_count_bytes", kind="choice", choices=("1", "2"), default="1", is_asked=_with("encoding", "rtu")
    ),
    Question(name="loopback", kind="choice", choices=("yes", "no"), default=UNKNOWN),
    Question(name="rejected_read", kind="rejected_read", default=UNKNOWN, is_asked=_may_reject_a_read),
    Question(name="command_register", kind="register"),
    Question(name="start_forward", kind="word"),
    Question(name="stop", kind="word"),
    Question(name="start_reverse", kind="word", default=UNKNOWN),
    Question(name="coast", kind="word", default=UNKNOWN),
    Question(name="reset", kind="word", default=UNKNOWN),
    Question(name="command_page", kind="text", default=UNKNOWN),
    Question(name="setpoint_register", kind="register"),
    Question(name="setpoint_kind", kind="choice", choices=("step", "share"), default="step"),
    Question(
        name="setpoint_step",
        kind="number",
        span=(0.001, 10),
        may_be_unknown=True,
        is_asked=_with("setpoint_kind", "step"),
    ),
    Question(
        name="full_scale", kind="number", span=(100, 0xFFFF), default="10000", is_asked=_with("setpoint_kind", "share")
    ),
    Question(name="factory_maximum", kind="number", span=(1, 4000), is_asked=_with("setpoint_kind", "share")),
    Question(name="highest_maximum", kind="number", span=(1, 4000), is_asked=_with("setpoint_kind", "share")),
    Question(name="setpoint_page", kind="text", default=UNKNOWN),
    Question(name="motor_maximum", kind="number", span=(1, 4000), default="50"),
    Question(name="status_register", kind="register", default=UNKNOWN),
    Question(name="status_kind", kind="choice", choices=("bits", "numbers"), is_asked=_with("status_register")),
    Question(name="running_bit", kind="bit", is_asked=_status_is("bits")),
    Question(name="reverse_bit", kind="bit", default=UNKNOWN, is_asked=_status_is("bits")),
    Question(name="fault_bit", kind="bit", default=UNKNOWN, is_asked=_status_is("bits")),
    Question(name="value_stopped", kind="word", is_asked=_status_is("numbers")),
    Question(name="value_forward", kind="word", is_asked=_status_is("numbers")),
    Question(name="value_reverse", kind="word", default=UNKNOWN, is_asked=_status_is("numbers")),
    Question(name="value_fault", kind="word", default=UNKNOWN, is_asked=_status_is("numbers")),
    Question(name="fault_register", kind="register", default=UNKNOWN, is_asked=_with("status_register")),
    Question(name="fault_coding", kind="choice", choices=("number", "bits"), is_asked=_with("fault_register")),
    Question(name="status_page", kind="text", default=UNKNOWN, is_asked=_with("status_register")),
    Question(name="frequency_register", kind="register", default=UNKNOWN),
    Question(
        name="frequency_step",
        kind="number",
        span=(0.001, 10),
        may_be_unknown=True,
        is_asked=_with("frequency_register"),
    ),
    Question(
        name="runs_to_standstill",
        kind="choice",
        choices=("yes", "no"),
        default=UNKNOWN,
        is_asked=_has_state_and_frequency,
    ),
    Question(name="current_register", kind="register", default=UNKNOWN),
    Question(
        name="current_step",
        kind="number",
        span=(0.0001, 10),
        may_be_unknown=True,
        is_asked=_with("current_register"),
    ),
    Question(name="neighbour_register", kind="neighbour", may_be_unknown=True, is_asked=_lacks_neighbours),
    Question(name="readings_page", kind="text", default=UNKNOWN),
    Question(name="keypad", kind="text", default=UNKNOWN),
)
"""In the order in which they are asked."""


def open_questions(answers: Answers) -> Iterator[Question]:
    """Yield the questions that are not answered yet; an answer that comes in between counts for the later ones."""
    for question in QUESTIONS:
        if question.name not in answers and question.is_asked(answers):
            yield question


def check_answer(question: Question, text: str, answers: Answers) -> None:
    """Raise ValueError for an answer that can't be read; ``UNKNOWN`` is one only where it is accepted."""
    if text != UNKNOWN or not question.accepts_unknown:
        parse_answer(question, text, answers)


def fact(answers: Answers, name: str) -> Any:
    """Return the parsed answer to a question, None where the manual does not give it."""
    question = next(each for each in QUESTIONS if each.name == name)
    return parse_answer(question, answers[name], answers) if is_known(answers, name) else None
