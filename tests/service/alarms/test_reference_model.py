"""The engine against a naive second reading of the rules: the whole past is looked at anew at every tick."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from drivebus.service.alarms import AlarmEngine
from drivebus.service.config.model import AlarmConfig, AlarmKind
from drivebus.values import Quality
from fixtures.alarms import FAN, FakeAlarmLog, current

TICK_S = 0.25
LIMIT = 10.0
Value = tuple[float, Quality]


def naive(past: list[Value], sign: float, hysteresis: float, delay_s: float) -> list[tuple[int, str]]:
    """What must happen at each tick, by looking back from it over everything since the alarm was last cleared."""
    message: list[tuple[int, str]] = []
    since, raised = 0, False
    for now, (value, quality) in enumerate(past):
        if quality is not Quality.GOOD:
            continue
        if raised and sign * (value - LIMIT) <= -hysteresis:
            message.append((now, "cleared"))
            raised, since = False, now + 1
        elif not raised and sign * (value - LIMIT) > 0:
            known = [(tick, v) for tick, (v, q) in enumerate(past[: now + 1]) if tick >= since and q is Quality.GOOD]
            within = [tick for tick, v in known if not sign * (v - LIMIT) > 0]
            begun = min(tick for tick, _ in known if tick > max(within, default=-1))
            if (now - begun) * TICK_S >= delay_s:
                message.append((now, "raised"))
                raised = True
    return message


VALUES = st.lists(
    st.tuples(
        st.sampled_from([0.0, 7.9, 8.0, 8.1, 9.9, 10.0, 10.1, 12.0, 12.1]),
        st.sampled_from([Quality.GOOD, Quality.GOOD, Quality.GOOD, Quality.UNCERTAIN, Quality.BAD]),
    ),
    max_size=60,
)


@settings(max_examples=300, deadline=None)
@given(
    VALUES,
    st.sampled_from([AlarmKind.ABOVE, AlarmKind.BELOW]),
    st.sampled_from([0.0, 2.0]),
    st.sampled_from([0.0, 0.25, 1.0, 2.5]),
)
def test_every_raise_and_clear_is_where_the_rules_say_to_the_tick(
    past: list[Value], kind: AlarmKind, hysteresis: float, delay_s: float
) -> None:
    setting = AlarmConfig("x", kind, (), "output_current", LIMIT, hysteresis, delay_s)
    book = AlarmEngine([setting], [FAN], FakeAlarmLog().put)
    message = [
        (tick, change.action)
        for tick, (value, quality) in enumerate(past)
        for change in book.observe(current(value, quality), tick * TICK_S, tick)
    ]
    sign = 1.0 if kind is AlarmKind.ABOVE else -1.0
    assert message == naive(past, sign, hysteresis, delay_s)
    assert [word for _, word in message] == ["raised", "cleared"] * (len(message) // 2) + ["raised"] * (
        len(message) % 2
    )
    for (up, _), (down, _) in zip(message[::2], message[1::2], strict=False):
        travel = sign * (past[up][0] - past[down][0])
        assert travel > hysteresis, "no chattering inside the hysteresis"


@settings(max_examples=100, deadline=None)
@given(st.floats(0.0, 100.0), st.floats(0.01, 5.0), st.integers(1, 400))
def test_a_delay_ends_at_the_first_look_that_is_not_before_it(start: float, step_s: float, looks: int) -> None:
    """Whatever floating sums do: neither a look too early nor one too late."""
    delay_s = looks * step_s
    book = AlarmEngine(
        [AlarmConfig("x", AlarmKind.ABOVE, (), "output_current", 1.0, 0.0, delay_s)], [FAN], FakeAlarmLog().put
    )
    raised = [n for n in range(looks + 3) if book.observe(current(2.0), start + n * step_s, 0)]
    assert raised == [looks]
