"""Story of the demo on its page: further steps of the script, and a caption in both languages for each step."""

from __future__ import annotations

from drivebus import i18n
from drivebus.cli.demo.script import ScriptStep
from drivebus.types import Json

PAGE_CONTINUATION = (
    ScriptStep(40.0, "unplug", "C"),
    ScriptStep(48.0, "plug", "C"),
    ScriptStep(58.0, "message", "yours"),
)
"""Steps of the demo on its page after the opening; the fault is left to the user."""


def caption(step: ScriptStep) -> Json:
    """Return the notice of the page for a step."""
    name = step.subject if step.action == "message" else step.action
    role, _, number = step.subject.partition("-")
    return {
        language: i18n.text(
            f"demo.story.{name}",
            language,
            name=i18n.text(f"demo.role.{role}", language, number=number) if number else "",
            bus=step.subject,
            hz=f"{step.frequency_hz:g}",
        )
        for language in i18n.LANGUAGES
    }
