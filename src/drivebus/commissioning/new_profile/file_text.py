"""Commented profile file made of the answers of a dialogue, in one language and grade draft."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from drivebus import i18n
from drivebus.commissioning.new_profile.questions import (
    LEAST_READ,
    QUESTIONS,
    UNKNOWN,
    Answers,
    fact,
    is_known,
    most_registers,
    readable_registers,
)
from drivebus.commissioning.new_profile.register_table import TableRow
from drivebus.profiles.model import SETPOINT_STEP, USUAL_STEPS_HZ
from drivebus.profiles.toml_file import toml_string

STATES = {
    "value_stopped": "stopped",
    "value_forward": "running_forward",
    "value_reverse": "running_reverse",
    "value_fault": "fault",
}
STATUS_BITS = {"running_bit": "running", "reverse_bit": "output_reverse", "fault_bit": "fault"}
COMMANDS = ("start_forward", "start_reverse", "stop", "coast", "reset")
ASSUMED_STEP_HZ = max(USUAL_STEPS_HZ)
"""Step of the setpoint where the manual gives none: the one that gives the lower word."""
ASSUMED = {"max_read": LEAST_READ}
"""Question to what the profile assumes without an answer."""
NOT_OPEN = (SETPOINT_STEP, "rejected_read")
"""Questions that never become open questions: an assumed step is an option, a rejected read one of several ways."""


def profile_toml(answers: Answers, rows: Sequence[TableRow], language: str) -> str:
    """Return the text of the file. ``answers`` are complete, ``rows`` those of a register table."""
    parts = [_head, _serial, _limits, _commands, _status, lambda a, e: _values(a, rows, e), _open_questions]
    return "\n\n".join("\n".join(lines) for part in parts if (lines := list(part(answers, language)))) + "\n"


def _comment(name: str, language: str, **params: str) -> Iterator[str]:
    yield from (f"# {line}" for line in i18n.text(f"profile_new.file_{name}", language, **params).splitlines())


def _evidence(answers: Answers, page: str = "") -> str:
    at = f", page {answers[page]}" if page and is_known(answers, page) else ""
    return "evidence = " + toml_string(f"manual {answers['source']}{at}")


def _array(values: Sequence[str]) -> str:
    return "[" + ", ".join(toml_string(value) for value in values) + "]"


def _head(answers: Answers, language: str) -> Iterator[str]:
    able = [
        *("run", "stop", "set_frequency", "read"),
        *(["status"] if is_known(answers, "status_register") else []),
        *(["reverse"] if is_known(answers, "start_reverse") else []),
        *(["coast"] if is_known(answers, "coast") else []),
        *(["reset_fault"] if is_known(answers, "reset") else []),
    ]
    low, high = fact(answers, "addresses")
    yield from _comment("head", language, title=answers["title"], source=answers["source"])
    yield "format = 1"
    yield f"model = {toml_string(answers['model'])}"
    yield 'family = "modbus"'
    yield from _comment("grade", language)
    yield 'grade = "draft"'
    yield f"maker = {toml_string(answers['maker'])}"
    yield f"title = {toml_string(answers['title'])}"
    yield f"encodings = {_array([answers['encoding']])}"
    yield f"addresses = [{low}, {high}]"
    yield f"capabilities = {_array(able)}"
    if is_known(answers, "keypad"):
        yield f"keypad = {_array([answers['keypad']])}"
    yield 'notation = { style = "register" }'


def _serial(answers: Answers, language: str) -> Iterator[str]:
    baud = int(fact(answers, "baud"))
    form = toml_string(answers["format"])
    yield from _comment("serial", language)
    yield from ("[serial]", f"baud = {baud}", f"format = {form}", f"bauds = [{baud}]", f"formats = [{form}]")
    yield from (_evidence(answers, "serial_page"), "")
    yield from _comment("timing", language)
    yield from ("[timing]", 'evidence = "assumed"', "", "[modbus]")
    functions = [3, int(answers["write_function"]), *([8] if answers["loopback"] == "yes" else [])]
    yield f"functions = {sorted(functions)}"
    yield f"max_read = {most_registers(answers)}"
    if answers["loopback"] == "yes":
        yield "loopback = true"
    if answers.get("reply_count_bytes") == "2":
        yield "reply_count_bytes = 2"
    if is_known(answers, "rejected_read"):
        yield f"rejected_read = {fact(answers, 'rejected_read')}"
    yield from (_evidence(answers, "serial_page"), "", "[write]", "ram = false", 'evidence = "assumed"')


def _limits(answers: Answers, language: str) -> Iterator[str]:
    yield from _comment("limits", language)
    yield from (
        "[limits]",
        "minimum_hz = 0.0",
        f"maximum_hz = {fact(answers, 'motor_maximum')}",
        'evidence = "user"',
        "",
    )
    if answers["setpoint_kind"] == "share":
        yield from _comment("share", language)
        yield from ("[setpoint]", f"full_scale = {int(fact(answers, 'full_scale'))}")
        yield f"maximum_hz = {fact(answers, 'factory_maximum')}"
        yield f"highest_hz = {fact(answers, 'highest_maximum')}"
    elif is_known(answers, "setpoint_step"):
        yield from ("[setpoint]", f"factor = {fact(answers, 'setpoint_step')}", "decimals = 2")
    else:
        yield from _comment("assumed_step", language)
        yield from ("[setpoint]", f"factor = {ASSUMED_STEP_HZ}", "decimals = 2", 'evidence = "assumed"')
        return
    yield _evidence(answers, "setpoint_page")


def _commands(answers: Answers, language: str) -> Iterator[str]:
    yield "[commands]"
    yield f"register = 0x{fact(answers, 'command_register'):04X}"
    yield f"setpoint_register = 0x{fact(answers, 'setpoint_register'):04X}"
    yield from (_evidence(answers, "command_page"), "")
    yield from _comment("commands", language)
    yield "[commands.values]"
    yield from (f"{name} = 0x{fact(answers, name):04X}" for name in COMMANDS if is_known(answers, name))


def _status(answers: Answers, language: str) -> Iterator[str]:
    if not is_known(answers, "status_register"):
        return
    yield from _comment("status", language)
    yield from ("[status]", f"register = 0x{fact(answers, 'status_register'):04X}")
    if answers["status_kind"] == "bits":
        bits = {state: fact(answers, name) for name, state in STATUS_BITS.items() if is_known(answers, name)}
        yield "bits = { " + ", ".join(f"{state} = 0x{mask:04X}" for state, mask in bits.items()) + " }"
    if is_known(answers, "fault_register"):
        yield f"fault_registers = [0x{fact(answers, 'fault_register'):04X}]"
        yield f"fault_coding = {toml_string(answers['fault_coding'])}"
    if is_known(answers, "frequency_register") and answers["runs_to_standstill"] != "yes":
        yield 'standstill = "output_frequency"'
    yield _evidence(answers, "status_page")
    if answers["status_kind"] == "numbers":
        yield from ("", "[status.values]")
        yield from (f'{fact(answers, name)} = "{state}"' for name, state in STATES.items() if is_known(answers, name))
    yield ""
    yield from _comment("fault", language)


def _values(answers: Answers, rows: Sequence[TableRow], language: str) -> Iterator[str]:
    readings = (("output_frequency", "frequency", "Hz", 2), ("output_current", "current", "A", 1))
    for name, question, unit, decimals in readings:
        if is_known(answers, f"{question}_register"):
            yield f"[signals.{name}]"
            yield f'notation = "{fact(answers, f"{question}_register"):04X}H"'
            yield f"text = {toml_string(i18n.text(f'profile_new.{name}', language))}"
            if is_known(answers, f"{question}_step"):
                yield from (
                    f'unit = "{unit}"',
                    f"factor = {fact(answers, f'{question}_step')}",
                    f"decimals = {decimals}",
                )
            else:
                yield "scale_published = false"
            yield from (_evidence(answers, "readings_page"), "")
    for register in _neighbours(answers) - {row.register for row in rows}:
        yield from (f"[signals.register_{register:04x}]", f'notation = "{register:04X}H"')
        yield f"text = {toml_string(i18n.text('profile_new.neighbour', language))}"
        yield from (_evidence(answers, "readings_page"), "")
    for row in rows:
        yield from row.toml_lines()
        yield from (_evidence(answers, "readings_page"), "")


def _neighbours(answers: Answers) -> set[int]:
    """Return the registers that are read to recognize a late reply: two, where no other reading is known."""
    register = fact(answers, "neighbour_register")
    if register is None:
        return set()
    return {register} if readable_registers(answers) else {register, register + 1}


def _open_questions(answers: Answers, language: str) -> Iterator[str]:
    for question in QUESTIONS:
        if answers.get(question.name) == UNKNOWN and question.kind != "text" and question.name not in NOT_OPEN:
            question_text = i18n.text(f"profile_new.ask_{question.name}", language)
            yield f"[open_questions.{question.name}]"
            yield f'assumed = "{ASSUMED.get(question.name, "-")}"'
            yield 'where = "-"'
            yield f"text = {toml_string(i18n.text('profile_new.open_text', language, question=question_text))}"
            yield f"reason = {toml_string(i18n.text('profile_new.open_reason', language))}"
            yield from (f"procedure = {toml_string(i18n.text('profile_new.open_procedure', language))}", "")
