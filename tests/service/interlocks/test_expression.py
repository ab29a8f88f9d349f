"""Interlock expressions: strict parsing and fail-safe evaluation."""

from __future__ import annotations

import operator
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from drivebus.drives.state import DriveState
from drivebus.errors import ConfigurationError
from drivebus.service.interlocks.evaluation import UNIT_MEASURES, ValueLookup, evaluate, requires_running
from drivebus.service.interlocks.expression import (
    MAX_NESTING,
    STATE_WORDS,
    And,
    Comparison,
    Not,
    Or,
    Quantity,
    SignalReference,
    comparisons,
    parse,
    references,
)

VALUES: dict[tuple[str, str], tuple[float | str, str]] = {
    ("pump-1", "state"): ("running", ""),
    ("pump-1", "output_frequency"): (25.0, "Hz"),
    ("pump-1", "output_current"): (1.5, "A"),
    ("fan-1", "state"): ("stopped", ""),
    ("ramp-1", "state"): ("accelerating", ""),
    ("ramp-2", "state"): ("decelerating", ""),
    ("fan-1", "output_current"): (500.0, "mA"),
    ("fan-1", "temperature"): (float("nan"), "°C"),
    ("fan-1", "word"): (3.0, ""),
    ("fan-1", "label"): ("running", ""),
}


def look(drive: str, name: str) -> tuple[float | str, str] | None:
    return VALUES.get((drive, name))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("pump-1.state == running", True),
        ("running == pump-1.state", True),
        ("pump-1.state != running", False),
        ("fan-1.state == running", False),
        ("pump-1.output_frequency >= 25 Hz", True),
        ("pump-1.output_frequency > 25 Hz", False),
        ("25.0 Hz <= pump-1.output_frequency", True),
        ("pump-1.output_frequency != 25Hz", False),
        ("pump-1.output_current < 1600 mA", True),
        ("fan-1.output_current == 0.5 A", True),
        ("fan-1.output_current < pump-1.output_current", True),
        ("fan-1.word == 3", True),
        ("not fan-1.state == running", True),
        ("not (pump-1.state == running and fan-1.state == stopped)", False),
        ("pump-1.state == running or fan-1.state == running and fan-1.word == 4", True),
        ("(pump-1.state == running or fan-1.state == running) and fan-1.word == 4", False),
        ("not not pump-1.state == running", True),
        ("pump-1.output_frequency > -5 Hz", True),
        # What is not good, or can't be compared, is unknown; so is its opposite.
        ("pump-2.state == running", None),
        ("not pump-2.state == running", None),
        ("fan-1.temperature < 80 °C", None),
        ("not fan-1.temperature < 80 °C", None),
        ("pump-1.output_frequency < 80 °C", None),
        ("pump-1.output_frequency < 80 parsec", None),
        ("pump-1.state > running", None),
        ("fan-1.word == running", None),
        ("fan-1.label == running", None),
        ("pump-2.state == running or pump-1.state == running", True),
        ("pump-2.state == running and pump-1.state == running", None),
        ("pump-2.state == running and fan-1.state == running", False),
        ("pump-2.state == running or fan-1.state == running", None),
        ("running == running", True),
        ("ramp-1.state == running", True),
        ("ramp-1.state != running", False),
        ("running == ramp-2.state", True),
        ("ramp-1.state == accelerating", True),
        ("pump-1.state == accelerating", False),
        ("ramp-1.state == ramp-2.state", False),
        ("ramp-1.state != pump-1.state", True),
        ("ramp-1.state == stopped", False),
        ("1 A < 5 A", True),
    ],
)
def test_an_expression_holds_only_where_that_is_certain(text: str, expected: bool | None) -> None:
    assert evaluate(parse(text), look) is expected


KINDS = [
    [""],
    ["Hz"],
    ["A", "mA"],
    ["V"],
    ["W", "kW"],
    ["kWh"],
    ["°C", "℃"],
    ["rpm"],
    ["ms", "s", "min", "h"],
    ["%"],
    ["N·m", "Nm"],
]


def test_units_of_one_kind_are_converted_and_others_are_never_compared() -> None:
    assert {unit for kind in KINDS for unit in kind} == set(UNIT_MEASURES)
    for kind in KINDS:
        for unit in kind:
            comparable = {
                other for other in UNIT_MEASURES if evaluate(parse(f"1 {unit} == 1 {other}"), look) is not None
            }
            assert comparable == set(kind)
    for same in ("1 A == 1000 mA", "1 kW == 1000 W", "1 h == 60 min", "1 min == 60 s", "1 s == 1000 ms", "1 °C == 1 ℃"):
        assert evaluate(parse(same), look) is True
    assert evaluate(parse("1 N·m == 1 Nm"), look) is True


def test_every_state_but_unknown_can_be_required() -> None:
    assert set(STATE_WORDS) == {str(state) for state in DriveState} - {"unknown"}


@pytest.mark.parametrize(
    ("text", "key", "column"),
    [
        ("", "expression.syntax", 1),
        ("pump-1.state", "expression.syntax", 13),
        ("pump-1.state = running", "expression.character", 14),
        ("pump-1.state == ", "expression.syntax", 17),
        ("pump-1.state == running and", "expression.syntax", 28),
        ("pump-1.state == running fan-1.state == running", "expression.syntax", 25),
        ("(pump-1.state == running", "expression.syntax", 25),
        ("pump-1.state == running)", "expression.syntax", 24),
        ("not", "expression.syntax", 4),
        ("5 Hz < pump-1.output_frequency < 10 Hz", "expression.syntax", 32),
        ("pump-1.state == running && fan-1.state == running", "expression.character", 25),
        ("pump-1.x > 1.2.3 Hz", "expression.character", 12),
        ("pump-1.x > ５ Hz", "expression.character", 12),
        ("(" * (MAX_NESTING + 1) + "a.b > 1" + ")" * (MAX_NESTING + 1), "expression.deep", MAX_NESTING + 1),
        ("not " * (MAX_NESTING + 1) + "a.b > 1", "expression.deep", 4 * MAX_NESTING + 1),
    ],
)
def test_an_invalid_expression_is_rejected_with_its_column(text: str, key: str, column: int) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse(text)
    assert (caught.value.key, caught.value.params["column"]) == (key, column)
    assert all(str(column) in caught.value.text(language) for language in ("en", "zh"))


def test_nested_parentheses_are_parsed_up_to_their_limit() -> None:
    assert evaluate(parse("(" * MAX_NESTING + "fan-1.word == 3" + ")" * MAX_NESTING), look) is True
    assert evaluate(parse(" and ".join(["(fan-1.word == 3)"] * 100)), look) is True, (
        "beside each other there is no limit"
    )


@example("1<5")
@example("1<5 or a.b<5")
@given(st.text(alphabet="pump-1.state=<>!() andornot5HzA°C%\t\n\"'", max_size=60))
def test_any_text_is_parsed_or_rejected(text: str) -> None:
    try:
        found = parse(text)
    except ConfigurationError as error:
        assert error.text("zh")
    else:
        looked_at = any(True for _ in references(found))
        certain = evaluate(found, lambda drive, name: None)
        assert certain is None or not looked_at or isinstance(found, And | Or | Not)


def test_the_references_of_an_expression_are_listed() -> None:
    found = [
        (reference.drive, reference.name, reference.column)
        for reference in references(parse("a.x > b.y and not (c.state != fault)"))
    ]
    assert found == [("a", "x", 1), ("b", "y", 7), ("c", "state", 20)]


# --- against a second opinion -----------------------------------------------------------------------------------

DRIVES, SIGNALS = ("a", "b-2"), ("current", "word")
SIGNS: dict[str, Any] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
drives, words = st.sampled_from(DRIVES), st.sampled_from(["running", "fault"])
leaves = st.one_of(
    st.tuples(
        st.just("number"), drives, st.sampled_from(list(SIGNS)), st.integers(-2, 2), st.sampled_from(["A", "mA"])
    ),
    st.tuples(st.just("state"), drives, st.sampled_from(["==", "!="]), words),
)


def _grown(inner: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    several = st.lists(inner, min_size=2, max_size=3)
    return st.one_of(st.tuples(st.just("not"), inner), st.tuples(st.sampled_from(["and", "or"]), several))


trees = st.recursive(leaves, _grown, max_leaves=8)


def written(tree: Any) -> str:
    if tree[0] == "number":
        return f"{tree[1]}.current {tree[2]} {tree[3]} {tree[4]}"
    if tree[0] == "state":
        return f"{tree[1]}.state {tree[2]} {tree[3]}"
    if tree[0] == "not":
        return f"not ({written(tree[1])})"
    return f" {tree[0]} ".join(f"({written(part)})" for part in tree[1])


def naive(tree: Any, values: dict[tuple[str, str], Any]) -> set[bool]:
    """Return every result that a tree can have when unknown comparisons are either true or false."""
    if tree[0] == "number":
        amperes = values[tree[1], "current"]
        number = tree[3] if tree[4] == "A" else tree[3] / 1000
        return {True, False} if amperes is None else {SIGNS[tree[2]](float(amperes), float(number))}
    if tree[0] == "state":
        state = values[tree[1], "state"]
        return {True, False} if state is None else {(state == tree[3]) == (tree[2] == "==")}
    if tree[0] == "not":
        return {not result for result in naive(tree[1], values)}
    sides = [naive(part, values) for part in tree[1]]
    if tree[0] == "and":
        return {True} if all(side == {True} for side in sides) else {False} if {False} in sides else {True, False}
    return {False} if all(side == {False} for side in sides) else {True} if {True} in sides else {True, False}


contents = st.fixed_dictionaries(
    {(drive, "current"): st.one_of(st.none(), st.integers(-2, 2)) for drive in DRIVES}
    | {(drive, "state"): st.sampled_from([None, "running", "fault", "stopped"]) for drive in DRIVES}
)


@given(trees, contents)
def test_the_evaluation_agrees_with_a_naive_one(tree: Any, values: dict[tuple[str, str], Any]) -> None:
    def found(drive: str, name: str) -> tuple[float | str, str] | None:
        value = values[drive, name]
        return None if value is None else (value, "" if name == "state" else "A")

    expected = naive(tree, values)
    assert evaluate(parse(written(tree)), found) is (expected.pop() if len(expected) == 1 else None)


@given(trees, contents, st.sampled_from([(drive, name) for drive in DRIVES for name in ("current", "state")]))
def test_losing_a_value_never_makes_an_expression_hold(
    tree: Any, values: dict[tuple[str, str], Any], lost: tuple[str, str]
) -> None:
    """No ``not`` and no ``or`` permits a start without values."""

    def among(known: dict[tuple[str, str], Any]) -> ValueLookup:
        def found(drive: str, name: str) -> tuple[float | str, str] | None:
            value = known[drive, name]
            return None if value is None else (value, "" if name == "state" else "A")

        return found

    expression = parse(written(tree))
    if evaluate(expression, among(values | {lost: None})) is True:
        assert evaluate(expression, among(values)) is True


@given(trees)
def test_a_written_tree_is_parsed_into_the_same_tree(tree: Any) -> None:
    """The structure is compared, not only the result."""

    def same(found: Any, tree: Any) -> bool:
        if isinstance(found, Not):
            return tree[0] == "not" and same(found.inner, tree[1])
        if isinstance(found, And | Or):
            word = "and" if isinstance(found, And) else "or"
            return tree[0] == word and all(same(*pair) for pair in zip(found.parts, tree[1], strict=True))
        assert isinstance(found, Comparison) and isinstance(found.left, SignalReference)
        return (found.left.drive, found.operator) == (tree[1], tree[2])

    assert same(parse(written(tree)), tree)


# --- what must run first ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "needed"),
    [
        ("p.state == running", True),
        ("p.state != stopped", False),  # in fault it is off as well
        ("p.output_frequency > 5 Hz", True),
        ("p.output_frequency >= 0 Hz", False),
        ("p.output_current < 10 A", False),
        ("p.temperature < 80 °C", False),
        ("p.state == running or q.state == running", False),
        ("p.state == running and q.temperature < 80 °C", True),
        ("not (p.state == stopped)", False),
        ("not (p.state != running)", True),
        ("q.state == running", False),
        ("p.state == running or p.output_frequency > 5 Hz", True),
        ("p.state == fault", False),
    ],
)
def test_which_drive_must_run_before_an_expression_can_hold(text: str, needed: bool) -> None:
    assert requires_running(parse(text), "p") is needed


def test_every_unit_of_a_signal_is_known() -> None:
    from typing import get_args

    from drivebus.profiles.schema import Unit

    assert set(get_args(Unit)) <= set(UNIT_MEASURES)
    assert [str(comparison) for comparison in comparisons(parse("a.b >= 10.0 Hz"))] == ["a.b >= 10 Hz"]
    assert str(Quantity(3.0, "", 1)) == "3"
