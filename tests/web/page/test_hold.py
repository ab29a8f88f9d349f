"""Pause and ramp hold beside a drive that has them, on a real plant."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from drivebus import i18n
from fixtures.browser import Stage

SUMMARY = "details:has([data-do=pause]) > summary"


def start(page: Any) -> None:
    """Start the drive with 20 Hz in the two steps of the page."""
    page.fill(".control input[inputmode=decimal] >> nth=0", "20")
    page.click("[data-step=first]:enabled")
    page.click("[data-step=second]")


def test_a_running_drive_is_held_and_paused_and_a_start_lets_it_run_again(stage: Stage, visit: Any) -> None:
    stage.call("waiver.grant", drive="pump-1", reason="watched bench")
    page = visit("#/drive/pump-1")
    page.click("[data-do=take]")
    page.locator(".lease.own").wait_for()
    page.click(SUMMARY)
    page.locator("[data-do=pause]:disabled").wait_for()
    start(page)
    page.click("[data-do=hold_ramp]:enabled")
    page.locator(".control .notice", has_text="ramp hold").wait_for()
    page.click("[data-do=pause]:enabled")
    page.locator(".control .notice", has_text=i18n.text("drives.paused", "en")).wait_for()
    stage.wait(lambda: stage.view("pump-1")["state"] == "paused", "it is not paused")
    start(page)
    stage.wait(lambda: stage.view("pump-1")["state"] == "running", "it does not run again")


def test_a_model_without_pause_and_ramp_hold_shows_neither(visit: Any) -> None:
    page = visit("#/drive/fan-1")
    page.locator(".control [data-do=stop]").wait_for()
    assert page.locator("[data-do=pause], [data-do=hold_ramp]").count() == 0


def test_a_leader_of_a_running_drive_offers_neither(stage: Stage, visit: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The service refuses both, because the follower would run on; the page showed that after a click."""
    plant = stage.service.plant
    groups = tuple(replace(group, leader="pump-1") if group.id == "water" else group for group in plant.config.groups)
    monkeypatch.setattr(plant, "config", replace(plant.config, groups=groups))
    for drive in ("pump-1", "pump-2"):
        stage.call("waiver.grant", drive=drive, reason="watched bench")
    page = visit("#/drive/pump-2")
    page.click("[data-do=take]")
    start(page)
    stage.wait(lambda: stage.view("pump-2")["state"] == "running", "the follower does not run")
    page.goto(f"{stage.at}/#/drive/pump-1")
    page.click("[data-do=take]")
    page.locator(".lease.own").wait_for()
    page.click(SUMMARY)
    start(page)
    page.locator(".drivestate .state", has_text=i18n.text("drives.state_running", "en")).wait_for()
    refused = i18n.text("plant.leader_holds", "en", drive="Circulation pump", follower="Feed pump")
    page.locator(".control details .notice", has_text=refused).wait_for()
    assert page.locator("[data-do=pause]:disabled, [data-do=hold_ramp]:disabled").count() == 2
    stage.call("drive.stop", drive="pump-2")
    page.locator("[data-do=pause]:enabled").wait_for()
