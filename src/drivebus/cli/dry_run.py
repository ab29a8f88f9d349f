"""``--dry-run``: the frames of a command, the expected reply lengths and the time on the bus. Opens no port."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drivebus.cli import output
from drivebus.cli.connect import Target, note_foreign_settings
from drivebus.cli.errors import ExitCode

if TYPE_CHECKING:
    from drivebus.drives.dialects.base import Dialect
    from drivebus.profiles.model import SetpointShare
    from drivebus.protocols.codec import Codec
    from drivebus.serial_settings import SerialSettings, StationTiming

_CALIBRATION_KEYS = ("drives.coding_cap", "drives.direction_uncalibrated")
"""Errors that the command does not raise where a calibration is stored for the adapter and the address."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedFrame:
    """A frame that the command would send."""

    purpose: str
    """Catalogue key ``dry.<purpose>``."""
    data: bytes
    reply_bytes: int
    """Length of the normal reply; 0 after a broadcast."""
    request_s: float
    gap_s: float
    reply_s: float
    turnaround_s: float
    timeout_s: float

    @property
    def bus_s(self) -> float:
        """Time on the bus: gap, request, and reply or turnaround; without the station's own delay."""
        return self.gap_s + self.request_s + (self.reply_s if self.reply_bytes else self.turnaround_s)

    def to_json(self) -> dict[str, Any]:
        return {
            "purpose": output.text(f"dry.{self.purpose}"),
            "hex": self.data,
            "reply_bytes": self.reply_bytes,
            "gap_s": round(self.gap_s, 6),
            "request_s": round(self.request_s, 6),
            "reply_s": round(self.reply_s, 6),
            "bus_s": round(self.bus_s, 6),
            "timeout_s": round(self.timeout_s, 6),
        }


def plan_frames(
    purpose: str, requests: Iterable[Any], codec: Codec, timing: StationTiming, settings: SerialSettings
) -> list[PlannedFrame]:
    """Return the frames of requests. Raises ValueError for a field out of range."""
    return [_plan_frame(purpose, request, codec, timing, settings) for request in requests]


def _plan_frame(
    purpose: str, request: Any, codec: Codec, timing: StationTiming, settings: SerialSettings
) -> PlannedFrame:
    data = codec.encode_request(request)
    reply = codec.reply_size(request)
    return PlannedFrame(
        purpose=purpose,
        data=data,
        reply_bytes=reply,
        request_s=settings.seconds(len(data)),
        gap_s=timing.gap_s(settings),
        reply_s=settings.seconds(reply),
        turnaround_s=timing.turnaround_s,
        timeout_s=timing.timeout_s(settings, codec.largest_reply(request)) if reply else 0.0,
    )


class DryRun:
    """Frames that a command would send to one drive."""

    def __init__(self, target: Target) -> None:
        from drivebus.drives.context import DriveContext
        from drivebus.drives.dialects.create import create_dialect
        from drivebus.drives.drive import VOLATILE_SCHEMES, known_options
        from drivebus.drives.eeprom_budget import EepromBudget
        from drivebus.drives.store import MemoryStore
        from drivebus.profiles.model import SETPOINT_STEP

        port = target.open_port()
        known = known_options(port, target.profile, target.address)
        self.serial_settings = port.settings
        stated = target.drive_options()
        self._has_store = port.url.partition(":")[0] not in VOLATILE_SCHEMES
        self._may_step_be_stored = self._has_store and SETPOINT_STEP not in stated
        note_foreign_settings(port.settings, target.profile)
        self.dialect: Dialect = create_dialect(
            target.profile, target.address, encoding=target.encoding, options=known | stated
        )
        self.drive = DriveContext(dialect=self.dialect, eeprom_budget=EepromBudget(MemoryStore(), ""))
        """For the checks that a command makes before it asks the drive."""
        self.frames: list[PlannedFrame] = []
        self._notes: list[tuple[str, dict[str, Any]]] = []

    def check(self, check: Callable[[], object]) -> None:
        """Check as the command does. Raises the errors of ``check``; a note names those that a calibration removes."""
        from drivebus.errors import DrivebusError

        try:
            check()
        except DrivebusError as error:
            if self._has_store and error.key in _CALIBRATION_KEYS:
                output.print_note("dry.note.calibration")
            raise

    def check_then_assume_scale(self, check: Callable[[], object]) -> None:
        """Check as the command does, and show frequencies in the named model's step or share where the drive's is open.

        A note says which check needs the drive. Raises the errors of ``check``.
        """
        from drivebus.drives.dialects.setpoint_step import highest_safe_word, possible_steps_hz
        from drivebus.profiles.model import SETPOINT_STEP

        profile = self.dialect.profile
        if profile.setpoint_share is not None:
            self.check(check)
            self._assume_maximum(profile.setpoint_share)
            return
        steps_hz = possible_steps_hz(profile, self.dialect.options)
        if len(steps_hz) == 1:
            self.check(check)
            return
        scale = profile.setpoint_scale
        cap = scale.value(highest_safe_word(steps_hz))
        if not self._may_step_be_stored:
            self.check(check)
        # Else the step may be stored for the adapter, which only an open port names: the cap is a note, no error.
        self.dialect.set_option(SETPOINT_STEP, f"{scale.factor:g}")
        self.check(check)
        self._notes.append(("dry.note.step", {"model": profile.model, "step_hz": scale.factor, "cap_hz": cap}))

    def _assume_maximum(self, share: SetpointShare) -> None:
        """Show the share of a maximum frequency that a plan can't read."""
        from drivebus.profiles.model import MAXIMUM_FREQUENCY

        if self.dialect.options.get(MAXIMUM_FREQUENCY) or share.maximum is None:
            return
        factory = self.dialect.profile.parameters[share.maximum].factory
        assumed_hz = max(share.maximum_hz or factory or 0, self.dialect.profile.limits.maximum_hz)
        self.dialect.options[MAXIMUM_FREQUENCY] = assumed_hz
        self._notes.append(("dry.note.maximum", {"notation": share.maximum, "hz": assumed_hz}))

    def add(self, purpose: str, requests: Iterable[Any]) -> None:
        """Add requests in the order of sending."""
        station = self.dialect.station_config
        self.frames += plan_frames(purpose, requests, station.codec, station.timing, self.serial_settings)

    def add_model_check(self) -> bool:
        """Add the read that the first stop to a station of this model waits for. Return whether there is one."""
        check = self.dialect.model_check()
        if check is not None:
            self.add("model_check", (check,))
        return check is not None

    def add_readiness(self) -> None:
        """Add the reads of the pre-flight check (model, preconditions, maximum frequency, ramp times) and the state."""
        profile, share = self.dialect.profile, self.dialect.profile.setpoint_share
        names = [precondition.notation for precondition in profile.preconditions]
        names += [share.maximum] if share is not None and share.maximum is not None else []
        if profile.identity_codes is not None:
            self.add("identity", self.dialect.identity_reads())
        self.add("preflight", self._parameter_reads(names))
        self.add("ramp_times", self._parameter_reads(profile.ramp_notations or ()))
        self.add("state", self.dialect.state_reads())

    def _parameter_reads(self, notations: Iterable[str]) -> list[Any]:
        parameters = [self.dialect.profile.parameters.get(notation) for notation in notations]
        return [
            self.dialect.read_parameter(parameter)
            for parameter in parameters
            if parameter is not None and parameter.readable
        ]

    def add_start_preparation(self) -> None:
        """Add the unlock and the words that the model may need before a start, each once, with a note."""
        commands = self.dialect.profile.commands
        steps = commands.preparation if commands is not None else ()
        self.add_unlock()
        fixed = [step.word for step in steps if step.when is None]
        self.add("prepare_always", [self.dialect.preparation_frame(word).request for word in fixed])
        words = dict.fromkeys(step.word for step in steps if step.when is not None)
        if words:
            self.add("prepare", [self.dialect.preparation_frame(word).request for word in words])
            self._notes.append(("dry.note.prepare", {}))

    def add_unlock(self) -> None:
        """Add the write without which the drive rejects every command, where the model needs one."""
        unlock = self.dialect.unlock()
        if unlock is not None:
            self.add("unlock", [unlock])

    def print(self, *notes: str, **more: Any) -> ExitCode:
        """Print the frames; ``notes`` are catalogue keys, ``more`` are further members of the JSON document."""
        all_notes = [*self._notes, *((note, {}) for note in notes)]
        return print_plan(self.frames, self.serial_settings, all_notes, **more)


def print_plan(
    planned: Sequence[PlannedFrame],
    settings: SerialSettings,
    notes: Sequence[tuple[str, dict[str, Any]]] = (),
    **more: Any,
) -> ExitCode:
    """Print frames and the total time on the bus.

    ``notes`` are catalogue keys with their parameters, ``more`` are further members of the JSON document.
    """
    total = sum(frame.bus_s for frame in planned)
    output.print_json(
        {
            "dry_run": True,
            "serial": str(settings),
            "frames": [frame.to_json() for frame in planned],
            "bus_s": round(total, 6),
            "notes": [output.text(note, **params) for note, params in notes],
            **more,
        }
    )
    output.print_text(_plan_text(planned, settings, total))
    for note, params in notes:
        output.print_message(note, **params)
    return ExitCode.DONE


def _plan_text(planned: Sequence[PlannedFrame], settings: SerialSettings, total: float) -> str:
    title = output.text("dry.title", serial=settings, count=len(planned), bus_ms=f"{total * 1000:.1f}")
    lines = [output.wrap_for(title, sys.stdout)]
    for frame in planned:
        reply = output.text("dry.reply", count=frame.reply_bytes) if frame.reply_bytes else output.text("dry.no_reply")
        note = f"{output.text(f'dry.{frame.purpose}')} · {reply} · {frame.bus_s * 1000:.1f} ms"
        lines.append(output.wrap_for(output.to_json_value(frame.data), sys.stdout, indent=2))
        lines.append(output.wrap_for(note, sys.stdout, indent=4))
    return "\n".join(lines)
