"""Settings and fixtures of every test. No property test is timed, because a busy machine may stop in the middle."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from _pytest.assertion import rewrite
from hypothesis import HealthCheck, settings

settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
if settings.get_current_profile_name() == "default":  # a mutation run has its own
    settings.load_profile("untimed")

gc.disable()  # no test is collected twice: while 16,000 are, a third of the time went into the search for garbage


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    """Let each worker of pytest-xdist compile its share of the test files: otherwise each compiles all of them."""
    number, count = (
        os.environ.get("PYTEST_XDIST_WORKER", "").removeprefix("gw"),
        os.environ.get("PYTEST_XDIST_WORKER_COUNT"),
    )
    if not number or not count or sys.dont_write_bytecode:
        return
    config = session.config
    ignored = [Path(path).resolve() for path in config.getoption("ignore") or ()]
    places = [Path(argument.partition("::")[0]).resolve() for argument in config.args]
    files = sorted({file for place in places for file in (place.rglob("test_*.py") if place.is_dir() else [place])})
    files = [file for file in files if not any(file.is_relative_to(place) for place in ignored)]
    for file in files[int(number) :: int(count)]:
        compiled = rewrite.get_cache_dir(file) / (file.stem + rewrite.PYC_TAIL)
        if not compiled.exists() and rewrite.try_makedirs(compiled.parent):
            source_hash, code = rewrite._rewrite_test(file, config)
            rewrite._write_pyc(config.stash[rewrite.assertstate_key], code, source_hash, compiled)


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
