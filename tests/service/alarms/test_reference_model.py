"""Alarm engine compared with a naive model that evaluates the whole past at every tick."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from drivebus.service.alarms import AlarmEngine
from drivebus.service.config.model import AlarmConfig, AlarmKind
from drivebus.values import Quality
from fixtures.alarms import FAN, RecordingAlarmLog, current

TICK_S = 0.25
LIMIT = 10.0
Value = tuple[float, Quality]


def reference_changes(past: list[Value], sign: float, hysteresis: float, delay_s: float) -> list[tuple[int, str]]:
    """Return the expected changes by tick, from all values since the alarm was last cleared."""
    changes: list[tuple[int, str]] = []
    since, raised = 0, False
    for now, (value, quality) in enumerate(past):
        if quality is not Quality.GOOD:
            continue
        if raised and sign * (value - LIMIT) <= -hysteresis:
            changes.append((now, "cleared"))
            raised, since = False, now + 1
        elif not raised and sign * (value - LIMIT) > 0:
            known = [(tick, v) for tick, (v, q) in enumerate(past[: now + 1]) if tick >= since and q is Quality.GOOD]
            within = [tick for tick, v in known if not sign * (v - LIMIT) > 0]
            started = min(tick for tick, _ in known if tick > max(within, default=-1))
            if (now - started) * TICK_S >= delay_s:
                changes.append((now, "raised"))
                raised = True
    return changes


VALUES = st.lists(
    st.tuples(
        st.sampled_from([0.0, 7.9, 8.0, 8.1, 9.9, 10.0, 10.1, 12.0, 12.1]),
        st.sampled_from([Quality.GOOD, Quality.GOOD, Quality.GOOD, Quality.UNCERTAIN, Quality.BAD]),
    ),
    max_size=60,
)


@settings(max_examples=300)
@given(
    VALUES,
    st.sampled_from([AlarmKind.ABOVE, AlarmKind.BELOW]),
    st.sampled_from([0.0, 2.0]),
    st.sampled_from([0.0, 0.25, 1.0, 2.5]),
)
def test_every_raise_and_clear_is_at_the_tick_of_the_reference_model(
    past: list[Value], kind: AlarmKind, hysteresis: float, delay_s: float
) -> None:
    setting = AlarmConfig(
        id="x", kind=kind, drives=(), signal="output_current", threshold=LIMIT, hysteresis=hysteresis, delay_s=delay_s
    )
    engine = AlarmEngine([setting], [FAN], RecordingAlarmLog().put)
    changes = [
        (tick, change.action)
        for tick, (value, quality) in enumerate(past)
        for change in engine.observe(current(value, quality), tick * TICK_S, tick)
    ]
    sign = 1.0 if kind is AlarmKind.ABOVE else -1.0
    assert changes == reference_changes(past, sign, hysteresis, delay_s)
    assert [word for _, word in changes] == ["raised", "cleared"] * (len(changes) // 2) + ["raised"] * (
        len(changes) % 2
    )
    for (up, _), (down, _) in zip(changes[::2], changes[1::2], strict=False):
        travel = sign * (past[up][0] - past[down][0])
        assert travel > hysteresis, "no chattering inside the hysteresis"


@settings(max_examples=100)
@given(st.floats(0.0, 100.0), st.floats(0.01, 5.0), st.integers(1, 400))
def test_a_delay_ends_at_the_first_observation_not_before_it(start: float, step_s: float, observations: int) -> None:
    """Rounding of floating-point sums moves it by no observation."""
    delay_s = observations * step_s
    engine = AlarmEngine(
        [
            AlarmConfig(
                id="x",
                kind=AlarmKind.ABOVE,
                drives=(),
                signal="output_current",
                threshold=1.0,
                hysteresis=0.0,
                delay_s=delay_s,
            )
        ],
        [FAN],
        RecordingAlarmLog().put,
    )
    raised = [n for n in range(observations + 3) if engine.observe(current(2.0), start + n * step_s, 0)]
    assert raised == [observations]
