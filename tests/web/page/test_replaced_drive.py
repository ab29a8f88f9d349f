"""A reload of the configuration puts another motor behind the open page of a drive."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from drivebus import i18n
from fixtures.browser import Stage
from fixtures.browser_actions import expecting
from fixtures.service import allow_late_replies

ADDRESS, BUS_AND_MODEL = "fan-2", "pump-1"
"""Drives with which the supply fan changes places: on the same bus, and on another one with another model."""


@contextmanager
def exchanged(stage: Stage, other: str) -> Iterator[None]:
    """Give the supply fan the place of another drive, and that one its place; the old places again at the end."""
    file = Path(stage.service.plant.config.source)
    before = file.read_text(encoding="utf-8")
    places = {id: re.search(rf"\[drive\.{id}\]\n((?:.*\n){{3}})", before)[1] for id in ("fan-1", other)}  # type: ignore[index]
    after = before.replace(f"[drive.fan-1]\n{places['fan-1']}", f"[drive.fan-1]\n{places[other]}")
    after = after.replace(f"[drive.{other}]\n{places[other]}", f"[drive.{other}]\n{places['fan-1']}")

    def reload(text: str) -> None:
        file.write_text(text, encoding="utf-8")
        stage.call("configuration.reload")
        allow_late_replies(stage.service)
        drives = ("fan-1", other)
        stage.wait(lambda: all(stage.view(id)["presence"] == "online" for id in drives), "a drive does not answer")

    try:
        reload(after)
        yield
    finally:
        reload(before)


def prepare(visit: Any, language: str = "en") -> Any:
    """Open the fan's parameters, read them, change one, and enter a frequency."""
    page = visit("#/drive/fan-1?tab=parameters", language=language)
    page.click("[data-do=take]")
    page.locator(".lease.own").wait_for()
    page.locator(".drivecontrol .frequency input[inputmode]").first.fill("12")
    page.click("[data-do=read]")
    page.locator("td.pinned input").first.wait_for()
    expecting()(page.locator("[data-do=read]")).to_be_enabled()
    page.locator("td.pinned input").first.fill("7")
    return page


@pytest.mark.parametrize(("other", "language"), [(ADDRESS, "en"), (BUS_AND_MODEL, "zh")])
def test_what_was_entered_for_or_read_from_a_drive_is_not_left_for_the_one_that_replaces_it(
    stage: Stage, visit: Any, other: str, language: str
) -> None:
    """Regression: values of the old motor stood as those of the new one, and a change for the old one could be written.

    Where the model was another one, the table of the parameters was an error.
    """
    expect = expecting()
    page = prepare(visit, language)
    page.click("[data-do=review]")
    page.locator("dialog").wait_for()
    before = stage.view("fan-1")
    with exchanged(stage, other):
        place = {"bus": {"en": "Fan line", "zh": "风机线路"}[language]}
        place |= {"address": before["address"], "model": before["model"]}
        note = page.locator("[data-text=replaced]")
        expect(note.locator("span")).to_have_text(i18n.text("page.drive_replaced", language, **place))
        expect(page.locator("dialog")).to_have_count(0)
        expect(page.locator("[role=tabpanel] tbody tr").first).to_be_visible()
        assert page.locator("[data-text=broken], tr.changed, [role=tabpanel] tbody td > b").count() == 0
        expect(page.locator(".drivecontrol .frequency input[inputmode]").first).to_have_value("")
        note.get_by_role("button").click()
        expect(note).to_have_count(0)


def test_a_signal_that_the_new_model_does_not_have_is_not_shown_with_its_last_value(stage: Stage, visit: Any) -> None:
    """Regression: signals of the old model stood among those of the new one until the page was loaded again."""
    page = visit("#/drive/fan-1")
    page.locator(".values").wait_for()
    names = "import('/static/js/store.js').then((m) => Object.keys(m.drive('fan-1').value.signals).sort())"
    was = page.evaluate(names)
    with exchanged(stage, BUS_AND_MODEL):
        now = sorted(stage.view("fan-1")["signals"])
        assert set(was) - set(now), "the models have the same signals"
        page.locator("[data-text=replaced]").wait_for()
        page.wait_for_function(f"(now) => {names}.then((shown) => shown.join() === now.join())", arg=now)
