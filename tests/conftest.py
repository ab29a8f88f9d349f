"""Settings and fixtures of every test. No property test is timed, because a busy machine may stop in the middle."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
if settings.get_current_profile_name() == "default":  # a mutation run has its own
    settings.load_profile("untimed")


def pytest_collectstart() -> None:
    """Search for no garbage: among 16,000 tests, which leave none, the search took a third of the collection."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Search for garbage again, but not among what was collected, which lives until the end."""
    gc.collect()
    gc.freeze()
    gc.enable()


@pytest.fixture
def clean_simulated_buses() -> Iterator[None]:
    """Delete the simulated buses after a test: the next one with the same port URL gets drives at rest."""
    from drivebus.simulator.port import clear_simulated_buses

    yield
    clear_simulated_buses()


@pytest.fixture
def english_output() -> None:
    """Print English in this test, whatever language an earlier one has set."""
    from drivebus.cli import output

    output.parse_global_options(["--lang", "en"])


@pytest.fixture
def own_profiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the empty directory of the user's own profiles."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    directory = tmp_path / "drivebus" / "profiles"
    directory.mkdir(parents=True)
    return directory
