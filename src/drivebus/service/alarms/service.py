"""Operations on alarms: list, history, acknowledge, shelve and unshelve."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from drivebus.errors import NotFound
from drivebus.service.alarms.log import AlarmLog
from drivebus.service.alarms.model import AlarmChange
from drivebus.service.api.errors import error_to_json
from drivebus.service.api.handlers import handles
from drivebus.service.api.operations.alarms import (
    ALARM_ACKNOWLEDGE,
    ALARM_SHELVE,
    ALARM_UNSHELVE,
    ALARMS_ACKNOWLEDGE,
    ALARMS_HISTORY,
    ALARMS_LIST,
    ALARMS_SHELVE,
    ALARMS_UNSHELVE,
    AlarmParams,
    AlarmSelectionParams,
    ShelveParams,
    ShelveSelectionParams,
)
from drivebus.service.api.operations.history import TimeRangeParams
from drivebus.service.api.operations.operation import NoParams
from drivebus.service.auth.actor import Actor
from drivebus.service.runtime.fairness import iter_cooperatively
from drivebus.service.runtime.plant import Plant
from drivebus.types import Json


class AlarmService:
    """Handlers of ``alarms.*`` and ``alarm.*``."""

    def __init__(self, plant: Plant, log: AlarmLog) -> None:
        self._plant, self._log = plant, log

    @handles(ALARMS_LIST)
    async def list_alarms(self, params: NoParams, actor: Actor) -> Json:
        return self._plant.alarms.as_json()

    @handles(ALARMS_HISTORY)
    async def list_history(self, params: TimeRangeParams, actor: Actor) -> Json:
        return self._log.history(**params.model_dump())

    @handles(ALARM_ACKNOWLEDGE)
    async def acknowledge(self, params: AlarmParams, actor: Actor) -> Json:
        plant = self._plant
        plant.publish_alarms(plant.alarms.acknowledge(params.alarm, actor.name, plant.wall_ms()))
        return {"alarm": params.alarm}

    @handles(ALARM_SHELVE)
    async def shelve(self, params: ShelveParams, actor: Actor) -> Json:
        plant = self._plant
        changes = plant.alarms.shelve(
            params.alarm, params.minutes, plant.now(), plant.wall_ms(), by=actor.name, reason=params.reason
        )
        plant.publish_alarms(changes)
        return {"alarm": params.alarm, "shelved_until_ms": changes[0].alarm.shelved_until_ms}

    @handles(ALARM_UNSHELVE)
    async def unshelve(self, params: AlarmParams, actor: Actor) -> Json:
        self._plant.publish_alarms(self._plant.alarms.unshelve(params.alarm))
        return {"alarm": params.alarm}

    # --- several alarms ---------------------------------------------------------------------------------------------

    @handles(ALARMS_ACKNOWLEDGE)
    async def acknowledge_selected(self, params: AlarmSelectionParams, actor: Actor) -> Json:
        plant = self._plant
        return await self._change_each(
            params.alarms, lambda id: plant.alarms.acknowledge(id, actor.name, plant.wall_ms())
        )

    @handles(ALARMS_SHELVE)
    async def shelve_selected(self, params: ShelveSelectionParams, actor: Actor) -> Json:
        """Shelve for the same time from now on, however long the changes take."""
        alarms, now, now_ms = self._plant.alarms, self._plant.now(), self._plant.wall_ms()
        return await self._change_each(
            params.alarms,
            lambda id: alarms.shelve(id, params.minutes, now, now_ms, by=actor.name, reason=params.reason),
        )

    @handles(ALARMS_UNSHELVE)
    async def unshelve_selected(self, params: AlarmSelectionParams, actor: Actor) -> Json:
        return await self._change_each(params.alarms, self._plant.alarms.unshelve)

    async def _change_each(self, ids: Sequence[str], change: Callable[[str], list[AlarmChange]]) -> Json:
        """Change each alarm once, in turns with the buses; return the result of each."""
        outcomes: Json = {}
        async for id in iter_cooperatively([*dict.fromkeys(ids)]):
            try:
                changes = change(id)
            except NotFound as error:
                outcomes[id] = error_to_json(error)
                continue
            outcomes[id] = {"status": "done" if changes else "unchanged"}
            self._plant.publish_alarms(changes)
        return {"outcomes": outcomes}
