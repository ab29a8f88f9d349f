"""``Queries``: handlers of the operations that change nothing."""

from __future__ import annotations

import asyncio

from drivebus import profiles
from drivebus.drives.operations.loopback import LoopbackReport
from drivebus.errors import CapabilityError, NotFound, ProfileError
from drivebus.profiles.listing import list_models
from drivebus.profiles.load import model_name
from drivebus.profiles.notation import find_entries
from drivebus.service.api.errors import error_to_json
from drivebus.service.api.frames import frame_json
from drivebus.service.api.handlers import handles
from drivebus.service.api.operations.audit import AUDIT_LIST, AUDIT_VERIFY
from drivebus.service.api.operations.buses import BUSES_FRAMES, BUSES_GET, BUSES_LIST, BusParams, FramesParams
from drivebus.service.api.operations.drives import (
    DRIVES_GET,
    DRIVES_LIST,
    DRIVES_PROFILE,
    DRIVES_STATISTICS,
    IDENTITY_READ,
    LOOPBACK_TEST,
    LOOPBACK_TIMEOUT_S,
    PARAMETERS_READ,
    DriveParams,
    LoopbackParams,
    ParameterReadParams,
)
from drivebus.service.api.operations.groups import GROUPS_LIST
from drivebus.service.api.operations.history import (
    HISTORY_EVENTS,
    HISTORY_EXPORT,
    HISTORY_TAGS,
    HISTORY_TREND,
    ExportParams,
    TimeRangeParams,
    TrendParams,
)
from drivebus.service.api.operations.models import MODELS_GET, MODELS_LIST, ModelParams
from drivebus.service.api.operations.operation import NoParams
from drivebus.service.api.operations.plant import PLANT_GET, PLANT_STATISTICS
from drivebus.service.api.profile_json import profile_json, readings_json
from drivebus.service.audit.description import described, titles_of
from drivebus.service.auth.actor import Actor
from drivebus.service.control.groups import GroupCommands
from drivebus.service.live.publisher import bus_view, drive_view, plant_topic
from drivebus.service.live.recent_views import RecentDriveViews
from drivebus.service.live.views import text_json
from drivebus.service.runtime.fairness import ITEMS_PER_TURN, iter_cooperatively, yield_to_loop
from drivebus.service.runtime.plant import Plant
from drivebus.types import Json
from drivebus.values import Text, bilingual_text

NAMES_PER_TURN = 2  # the similar names of an unknown one take 0.7 ms


class Queries:
    """Answers from the service's state, history and audit trail.

    Only parameters, identities and loop-back tests use the bus.
    """

    def __init__(self, plant: Plant, groups: GroupCommands) -> None:
        self.plant, self.groups = plant, groups
        self._recent_views = RecentDriveViews(plant)

    @handles(PLANT_GET)
    async def get_plant(self, params: NoParams, actor: Actor) -> Json:
        return plant_topic(self.plant)

    @handles(PLANT_STATISTICS)
    async def get_statistics(self, params: NoParams, actor: Actor) -> Json:
        """Return counters, which only grow while the service runs."""
        plant = self.plant
        return {
            "stops": plant.stop_statistics.as_json(),
            "history": plant.historian.status(),
            "drives": {drive: plant.run_statistics.statistics_json(drive) for drive in plant.drives},
        }

    @handles(DRIVES_LIST)
    async def list_drives(self, params: NoParams, actor: Actor) -> Json:
        """Return recent views that show every finished command; see ``RecentDriveViews``."""
        views: list[Json] = []
        new_views = 0
        for drive in tuple(self.plant.drives.values()):
            view = self._recent_views.find(drive.id)
            if view is None:
                new_views += 1
                if new_views % ITEMS_PER_TURN == 0:
                    await yield_to_loop()
            if self.plant.drives.get(drive.id) is drive:
                views.append(view or self._recent_views.make(drive))
        return {"drives": views}

    @handles(DRIVES_GET)
    async def get_drive(self, params: DriveParams, actor: Actor) -> Json:
        return drive_view(self.plant, self.plant.drive_runtime(params.drive)).as_json()

    @handles(DRIVES_STATISTICS)
    async def get_drive_statistics(self, params: DriveParams, actor: Actor) -> Json:
        return self.plant.run_statistics.statistics_json(self.plant.drive_runtime(params.drive).id)

    @handles(DRIVES_PROFILE)
    async def get_profile(self, params: DriveParams, actor: Actor) -> Json:
        return profile_json(self.plant.drive_runtime(params.drive).profile)

    @handles(MODELS_LIST)
    async def list_models(self, params: NoParams, actor: Actor) -> Json:
        """Return every model; a rejected file of the user is left out."""
        models: list[Json] = []
        found = list_models()
        while (model := await asyncio.to_thread(next, found, None)) is not None:
            if not isinstance(model, ProfileError):
                models.append(model | {name: text_json(model[name]) for name in ("title", "maker")})
        return {"models": models}

    @handles(MODELS_GET)
    async def get_model(self, params: ModelParams, actor: Actor) -> Json:
        """Return the profile of a model by its name; a path is no name. Raises NotFound."""
        return await asyncio.to_thread(_model_json, params.model)

    @handles(GROUPS_LIST)
    async def list_groups(self, params: NoParams, actor: Actor) -> Json:
        return {"groups": [self.groups.group_view(group) for group in self.plant.config.groups]}

    @handles(BUSES_LIST)
    async def list_buses(self, params: NoParams, actor: Actor) -> Json:
        buses: list[Json] = []
        async for bus in iter_cooperatively(tuple(self.plant.buses.values()), 1):
            if self.plant.buses.get(bus.config.id) is bus:
                buses.append(bus_view(bus))
        return {"buses": buses}

    @handles(BUSES_GET)
    async def get_bus(self, params: BusParams, actor: Actor) -> Json:
        return bus_view(self.plant.bus_runtime(params.bus))

    @handles(BUSES_FRAMES)
    async def list_frames(self, params: FramesParams, actor: Actor) -> Json:
        bus = self.plant.bus_runtime(params.bus)
        frames = [
            frame
            for frame in bus.frames
            if frame.number > params.after and params.station in (None, frame.event.station)
        ]
        last = bus.frame_count
        return {
            "frames": [frame_json(bus, frame) async for frame in iter_cooperatively(frames[-params.limit :])],
            "last": last,
        }

    @handles(IDENTITY_READ)
    async def read_identity(self, params: DriveParams, actor: Actor) -> Json:
        runtime = self.plant.drive_runtime(params.drive)
        if "identify" not in runtime.profile.capabilities:
            raise CapabilityError("drives.cannot", model=runtime.profile.model, what="identify")
        identity = await self.plant.bus_of(runtime).reads.run(runtime.drive.identify, user=actor.user)
        return identity.as_json()

    @handles(PARAMETERS_READ)
    async def read_parameters(self, params: ParameterReadParams, actor: Actor) -> Json:
        drive = self.plant.drive_runtime(params.drive)
        known: list[str] = []
        refused: Json = {}
        async for name in iter_cooperatively(params.names, NAMES_PER_TURN):
            entries, unknown = find_entries(drive.profile, [name])
            known += entries
            refused |= {name: error_to_json(error) for name, error in unknown.items()}
        reads = self.plant.bus_of(drive).reads
        readings = await reads.run(lambda: drive.drive.read(known), user=actor.user) if known else {}
        return {"parameters": readings_json(drive.profile, readings), "refused": refused}

    @handles(LOOPBACK_TEST)
    async def test_loopback(self, params: LoopbackParams, actor: Actor) -> Json:
        drive = self.plant.drive_runtime(params.drive)
        bus = self.plant.bus_of(drive)

        async def test() -> LoopbackReport:
            ends_at = bus.bus.now() + LOOPBACK_TIMEOUT_S
            return await drive.drive.loopback_test(params.count, lambda: bus.bus.now() >= ends_at)

        report = await bus.reads.run(test, user=actor.user)
        is_complete = report.requests == params.count
        texts = [report.text]
        if not is_complete:
            texts.append(bilingual_text("loopback.time_limit", seconds=LOOPBACK_TIMEOUT_S))
        return {
            "requests": report.requests,
            "round_trips_ms": report.round_trips_ms,
            "repetitions": report.repetitions,
            "error": None if report.error is None else error_to_json(report.error),
            "complete": is_complete,
            "text": text_json(Text.join(texts, "sentences")),
        }

    # --- history and audit trail ----------------------------------------------------------------------------------

    @handles(HISTORY_TAGS)
    async def list_tags(self, params: NoParams, actor: Actor) -> Json:
        return self.plant.historian.queries.tags()

    @handles(HISTORY_TREND)
    async def get_trend(self, params: TrendParams, actor: Actor) -> Json:
        return await self.plant.historian.queries.trend(params)

    @handles(HISTORY_EXPORT)
    async def export_history(self, params: ExportParams, actor: Actor) -> Json:
        return await self.plant.historian.queries.export(params)

    @handles(HISTORY_EVENTS)
    async def list_events(self, params: TimeRangeParams, actor: Actor) -> Json:
        return await self.plant.historian.queries.events(params)

    @handles(AUDIT_LIST)
    async def list_audit_records(self, params: TimeRangeParams, actor: Actor) -> Json:
        records, titles = await self.plant.audit.query(**params.model_dump()), titles_of(self.plant.config)
        items = [described(item, titles) async for item in iter_cooperatively(records["items"])]
        return records | {"items": items}

    @handles(AUDIT_VERIFY)
    async def verify_audit_trail(self, params: NoParams, actor: Actor) -> Json:
        return await self.plant.audit.verify()


def _model_json(name: str) -> Json:
    """Return the profile of a model: up to 20 ms where it has not been loaded yet. Raises NotFound."""
    model = model_name(name)
    if model not in profiles.models():
        raise NotFound("models.unknown", model=name)
    return profile_json(profiles.load(model))
