"""Newest views of the drives for lists: the objects that the supervision cycle has made, each encoded once.

To build and encode 300 drives takes some 75 ms, to join those that are encoded already takes 3 ms.
"""

from __future__ import annotations

from drivebus.service.live.publisher import drive_view
from drivebus.service.live.views import DriveView
from drivebus.service.runtime.drive import DriveRuntime
from drivebus.service.runtime.fairness import EncodedOnce
from drivebus.service.runtime.plant import Plant, PlantListener
from drivebus.types import Json

MAX_VIEW_AGE_S = 2.0
"""Eight supervision cycles. On a busy machine a cycle takes longer than its period; lists that built each drive again
would then make it longer still. ``time_ms`` of each drive says when its view was made.
"""


class RecentDriveViews(PlantListener):
    """Newest views of the supervision cycle, of at most ``MAX_VIEW_AGE_S``, all of them made after the last command."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._views: dict[str, tuple[float, DriveView | EncodedOnce]] = {}
        """Drive → monotonic time and view; its JSON from the first list on."""
        plant.subscribe(self)

    def on_view(self, view: DriveView) -> None:
        self._views[view.id] = self._plant.now(), view

    def on_drive_removed(self, drive: str) -> None:
        self._views.pop(drive, None)

    def find(self, drive: str) -> Json | None:
        """Return the recent view of a drive, which must not be changed; None where it has to be built."""
        made_at, view = self._views.get(drive, (float("-inf"), None))
        now = self._plant.now()
        if view is None or made_at <= self._plant.last_command_at or now - made_at > MAX_VIEW_AGE_S:
            return None
        if isinstance(view, DriveView):
            view = EncodedOnce(view.as_json())
            self._views[drive] = made_at, view
        return view

    def is_shared(self, drive: str) -> bool:
        """Return whether an earlier list has made the JSON of the drive's view."""
        return isinstance(self._views.get(drive, (0.0, None))[1], EncodedOnce)

    def build(self, drive: DriveRuntime) -> Json:
        """Return the present view of a drive."""
        return drive_view(self._plant, drive).as_json()
