"""``story``: every model plays one story at four line qualities; drivebus reports what the station's motor does.

A model that was written from its source meets that station, one with a simulated drive of its own meets this, any other
a station that is made from its profile and proves only that the profile is whole.
"""

from __future__ import annotations

from collections.abc import Iterator

from drivebus import profiles
from drivebus.profiles.model import DriveProfile
from drivebus.simulator.models.catalog import make_station, simulated_models
from drivebus.simulator.station import SimulatedStation
from drivebus.testing.virtual_time import run as run_virtual
from verification.campaign import Campaign, CampaignRun
from verification.drive_story import LINES, StoryError, play
from verification.source_stations.drives import SOURCE_DRIVES
from verification.source_stations.state_charts import CHART_DRIVES, ChartStation
from verification.source_stations.station import SourceStation

ADDRESS = 3
MODELS = tuple(profiles.models())
SEEDS = 5
"""Seeds with which every model is played at most."""


def map_of(profile: DriveProfile) -> tuple[object, ...]:
    """Return what models with the same register map have in common."""
    if profile.commands is None:
        return profile.family, profile.encodings
    status = profile.status
    words = tuple(sorted(profile.commands.values.items()))
    return profile.commands.register, words, status.register if status else None


MAPS = tuple({map_of(profiles.load(model)): model for model in reversed(MODELS)}.values())
"""One model of each register map or protocol family."""


def story_station(model: str) -> tuple[str, SimulatedStation]:
    """Return the most independent station of a model, and what it was written from: source, manual or profile."""
    if model in CHART_DRIVES:
        return "source", ChartStation(ADDRESS, CHART_DRIVES[model], shows_ramp=False)
    if model in SOURCE_DRIVES:
        return "source", SourceStation(ADDRESS, SOURCE_DRIVES[model])
    return "manual" if model in simulated_models() else "profile", make_station(model, ADDRESS)


def trials() -> Iterator[tuple[int, str, str]]:
    """Yield seed, line and model: each map on every line, then the other models, then all with further seeds."""
    others = tuple(model for model in MODELS if model not in MAPS)
    for seed in range(SEEDS):
        for models in (MAPS, others):
            for line in LINES:
                for model in models:
                    yield seed, line, model


def run(campaign_run: CampaignRun) -> None:
    steps_played = 0
    for seed, line, model in trials():
        if not campaign_run.remaining:
            break
        written_from, station = story_station(model)
        try:
            steps = run_virtual(play(profiles.load(model), station, line, seed=campaign_run.seed + seed))
        except StoryError as error:
            campaign_run.violation(f"{model} on {line}, seed {campaign_run.seed + seed}: {error}")
            steps = []
        steps_played += len(steps)
        campaign_run.trace(f"{model} {line} {seed}: {', '.join(steps)}")
        campaign_run.count(f"stations written from a {written_from}")
        campaign_run.count(f"line {line}")
        campaign_run.add_trials()
    campaign_run.count("steps", steps_played)


CAMPAIGN = Campaign(
    name="story",
    summary={
        "en": "Every model runs, stops, trips and loses its line.",
        "zh": "每个型号的运行、停止、故障停机与断线。",
    },
    unit="stories",
    evidence_for=(),
    full_budget=4 * len(LINES) * len(MODELS),
    ci_budget=len(MAPS) * len(LINES),
    run=run,
)
