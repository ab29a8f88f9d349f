"""A clock that is not synchronized: known from the kernel, said by ``check``, and announced by the service."""

from __future__ import annotations

import ctypes
import json
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from drivebus.cli.main import cli
from drivebus.service.process import clock_sync
from drivebus.service.process.clock_sync import is_clock_synchronized
from drivebus.service.runtime import supervision
from fixtures.service import SHOP_FILE, running_service

REMEDY = "timedatectl set-ntp true"


class FakeLibc:
    """C library whose ``adjtimex`` reports a maximum error, or that it is not permitted."""

    def __init__(self, max_error_us: int | None) -> None:
        self.max_error_us = max_error_us

    def adjtimex(self, timex: Any) -> int:
        if self.max_error_us is None:
            return -1
        timex._obj.maxerror = self.max_error_us
        return 5  # TIME_ERROR: STA_UNSYNC is set, as by chrony without rtcsync


@pytest.mark.skipif(sys.platform != "linux", reason="adjtimex is Linux only")
@pytest.mark.parametrize(
    ("max_error_us", "expected"), [(40_000, True), (15_999_999, True), (16_000_000, False), (None, None)]
)
def test_a_clock_is_synchronized_while_its_maximum_error_is_below_the_limit_of_the_kernel(
    max_error_us: int | None, expected: bool | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ctypes, "CDLL", lambda name: FakeLibc(max_error_us))
    assert is_clock_synchronized() is expected


@pytest.mark.skipif(sys.platform != "linux", reason="adjtimex is Linux only")
def test_the_kernel_reports_a_maximum_error_between_zero_and_its_limit() -> None:
    """The field is where the kernel writes it: on this machine, whatever its clock is."""
    timex = clock_sync._Timex()
    assert ctypes.CDLL(None).adjtimex(ctypes.byref(timex)) >= 0
    assert 0 < timex.maxerror <= clock_sync.UNSYNCHRONIZED_ERROR_US


def test_on_another_system_the_state_of_the_clock_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    assert is_clock_synchronized() is None


@pytest.mark.parametrize("state", [True, False, None])
def test_check_names_a_clock_that_is_not_synchronized_with_its_remedy(
    state: bool | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clock_sync, "is_clock_synchronized", lambda: state)
    (tmp_path / "plant.toml").write_text(SHOP_FILE)

    def run(*options: str) -> Result:
        return CliRunner().invoke(cli, ["check", str(tmp_path / "plant.toml"), "--lang", "en", *options])

    found = run()
    assert found.exit_code == 0
    assert (REMEDY in found.output) is (state is False)
    assert json.loads(run("--json").stdout)["clock_synchronized"] is state


async def test_the_service_announces_once_that_the_clock_is_not_synchronized_and_raises_no_alarm(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Not in the first minutes: after a start of the computer the time of a server is still to come."""
    state: bool | None = False
    monkeypatch.setattr(supervision, "is_clock_synchronized", lambda: state)
    async with running_service() as kit:
        cycle = kit.service.supervision

        async def announced() -> int:
            await cycle._check_disk()
            return sum(REMEDY in text for text in kit.event_texts())

        assert await announced() == 0
        assert kit.service.plant.clock_synchronized is False, "the page shows it at once"
        cycle._clock_report_at = kit.service.plant.now()
        assert await announced() == 1
        assert await announced() == 1, "once, not at each check"
        state = True
        assert await announced() == 1
        assert kit.service.plant.clock_synchronized is True
        state = False
        assert await announced() == 2, "again after it was synchronized"
        assert kit.service.plant.alarms.active() == []
