"""``python -m verification``: a run loads the campaigns that it names, the help all of them."""

from __future__ import annotations

import pytest

from verification import __main__ as command_line
from verification.campaign import CAMPAIGN_NAMES, Campaign, load_campaign


@pytest.fixture
def loaded(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the campaigns that are loaded during the test."""
    names: list[str] = []

    def load(name: str) -> Campaign:
        names.append(name)
        return load_campaign(name)

    monkeypatch.setattr(command_line, "load_campaign", load)
    return names


def test_a_run_does_not_load_the_other_campaigns_whose_packages_may_be_absent(loaded: list[str]) -> None:
    command_line.main(["matrix", "--budget", "1"])
    assert loaded == ["matrix"]


def test_the_help_describes_every_campaign(loaded: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        command_line.main(["--help"])
    shown = capsys.readouterr().out
    assert loaded == list(CAMPAIGN_NAMES)
    assert all(f"  {name:12} {load_campaign(name).summary['en']}" in shown for name in CAMPAIGN_NAMES)
