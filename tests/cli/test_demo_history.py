"""The generated history of the demo: reproducible, in order of time, with the signals of the profile only."""

from __future__ import annotations

from collections import Counter

from drivebus import profiles
from drivebus.cli.demo.history import HOURS, STEP_S, HistoryGenerator
from drivebus.cli.demo.layout import BUSES
from drivebus.values import Quality

START_MS = 1_700_000_000_000
STEPS = int(HOURS * 3600.0 / STEP_S)


def generator(bus: int = 2, drive: int = 0, seed: int = 1) -> HistoryGenerator:
    return HistoryGenerator(BUSES[bus], BUSES[bus].drives[drive], profiles.load(BUSES[bus].model), START_MS, seed)


def test_the_same_seed_gives_the_same_history_and_another_seed_a_different_one() -> None:
    first, again, other = (list(generator(seed=seed).samples()) for seed in (1, 1, 2))
    assert first == again != other


def test_every_signal_has_a_value_every_ten_seconds_for_eight_hours() -> None:
    found = list(generator().samples())
    assert set(Counter(sample.tag for sample in found).values()) == {STEPS}
    assert {sample.tag.partition(".")[0] for sample in found} == {BUSES[2].drives[0].key}
    times = [sample.time_ms for sample in found]
    assert times == sorted(times) and times[-1] - times[0] == (STEPS - 1) * int(STEP_S * 1000)


def test_a_history_has_only_signals_that_the_profile_lists() -> None:
    for index, bus in enumerate(BUSES):
        listed = profiles.load(bus.model).signals
        found = {sample.tag.partition(".")[2]: sample.quality for sample in generator(index).samples()}
        assert found and set(found) <= set(listed)
        assert {name for name, quality in found.items() if quality is not Quality.GOOD} == {
            name for name in found if listed[name].uncertain
        }


def test_a_motor_draws_current_only_while_it_runs() -> None:
    history = generator(1)
    values: dict[str, list[float]] = {}
    for sample in history.samples():
        assert sample.value is not None
        values.setdefault(sample.tag.partition(".")[2], []).append(sample.value)
    pairs = list(zip(values["output_frequency"], values["output_current"], strict=True))
    running = [hz for hz, _ in pairs if hz > 0.0]
    assert 0.2 < len(running) / STEPS < 0.98 and max(running) <= 50.0
    assert all((hz > 0.0) == (amperes > 0.0) for hz, amperes in pairs)
    assert {event.kind for event in history.events} >= {"run", "stop"}
