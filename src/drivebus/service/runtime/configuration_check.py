"""Check of a configuration text in a process of its own, so that a large one delays no bus.

``python -m drivebus.service.runtime.configuration_check`` reads the pickled text and running configuration from its
parent on its standard input and prints the result as JSON.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import pickle
import re
import sys
from asyncio.subprocess import PIPE
from collections.abc import Collection, Iterable
from pathlib import Path

from drivebus.errors import ConfigurationError, ServiceError, ServiceUnavailable
from drivebus.profiles.diagnostics import Diagnostic
from drivebus.service.api.errors import localized, to_plain
from drivebus.service.config.diff import CONFIG_PARTS, ConfigDiff, config_diff
from drivebus.service.config.load import loads
from drivebus.service.config.model import PlantConfig
from drivebus.service.process.module_command import module_command
from drivebus.service.process.tuning import NICE_BATCH, limit_memory, set_nice
from drivebus.types import Json

CHECK_TIMEOUT_S = 20.0  # a plant of 300 drives takes 1.5 s
MAX_CHECKED_DRIVES = 1000
MAX_CHECK_BYTES = 1 << 30  # address space of the process of a check
_DRIVE_TABLE = re.compile(r"^[ \t]*\[[ \t]*drive[ \t]*\.", re.MULTILINE)


class ConfigurationCheck:
    """Checks of configuration texts, one at a time."""

    def __init__(self) -> None:
        self._process: asyncio.subprocess.Process | None = None
        self._busy = False

    async def check(self, text: str, running: PlantConfig, unstarted: Collection[str] = ()) -> Json:
        """Return every fault of a text, or what it would change; the service does not start ``unstarted`` gateways.

        Raises ConfigurationError for too many drives, ServiceUnavailable while another check is under way or when the
        service ends, ServiceError for a check that takes too long or fails. Cancelled, it ends the process.
        """
        drives = len(_DRIVE_TABLE.findall(text))
        if drives > MAX_CHECKED_DRIVES:
            raise ConfigurationError("plant.check_too_many", found=drives, most=MAX_CHECKED_DRIVES)
        if self._busy:
            raise ServiceUnavailable("plant.check_busy")
        self._busy = True
        try:
            return await self._run(pickle.dumps((text, running, unstarted)))
        finally:
            self._busy = False

    async def _run(self, content: bytes) -> Json:
        command = module_command(__name__)
        process = self._process = await asyncio.create_subprocess_exec(
            *command, stdin=PIPE, stdout=PIPE, stderr=PIPE, process_group=0
        )
        try:
            async with asyncio.timeout(CHECK_TIMEOUT_S):
                output, errors = await process.communicate(content)
        except TimeoutError:
            raise ServiceError("plant.check_too_long", limit_s=CHECK_TIMEOUT_S) from None
        finally:
            self._process = None
            _kill(process)
            await process.wait()
        if process.returncode != 0:
            reason = errors.decode("utf-8", "replace").strip().rpartition("\n")[2]
            raise ServiceUnavailable("plant.check_ended", reason=reason or process.returncode)
        result: Json = json.loads(output)
        return result

    def close(self) -> None:
        """End the check that is under way. Idempotent."""
        if self._process is not None:
            _kill(self._process)


def _kill(process: asyncio.subprocess.Process) -> None:
    if process.returncode is None:
        with contextlib.suppress(ProcessLookupError):
            process.kill()


def check_text(text: str, running: PlantConfig, unstarted: Collection[str] = ()) -> Json:
    """Return ``{"diagnostics", "difference", "notes"}`` of a text.

    Profile files are read below the folder of the plant file, with the suffix of a profile and outside the state
    directory, and where the running configuration has them: else a client could try which files exist on this machine,
    and read the first words of them, such as a password. The password of the database in use is never put into the
    text, whose parts the faults repeat.
    """
    folder, known = Path(running.source).resolve().parent, {drive.model for drive in running.drives}
    state = running.directory.resolve()

    def may_read(path: Path) -> bool:
        is_profile = path.suffix == ".toml" and path.is_relative_to(folder) and not path.is_relative_to(state)
        return is_profile or str(path) in known

    try:
        new = loads(text, running.source, folder, may_read_model=may_read, history_url=running.history.url)
    except ConfigurationError as error:
        return {"diagnostics": _diagnostics_json(error), "difference": {}, "notes": []}
    return {
        "diagnostics": [],
        "difference": difference_json(config_diff(running, new)),
        "notes": address_notes(running, new, unstarted),
    }


def difference_json(change: ConfigDiff) -> Json:
    """Return the names of what was added, changed and removed."""
    parts = [getattr(change, name) for name in CONFIG_PARTS]
    changed = [id for part in parts for id in part.changed]
    return {
        "added": _unique(id for part in parts for id in part.added),
        "changed": _unique((*changed, *change.others)),
        "removed": _unique(id for part in parts for id in part.removed),
    }


def address_notes(running: PlantConfig, new: PlantConfig, unstarted: Collection[str]) -> list[Json]:
    """Return a sentence for each gateway that a reload moves or ends: its users lose it at its present address."""
    enabled = {gateway.id: gateway for gateway in new.gateways if gateway.enabled}
    notes = []
    for before in running.gateways:
        after = enabled.get(before.id)
        address = after.address if after else None
        if not before.enabled or before.id in unstarted or (after is not None and before.address == address):
            continue
        key = "plant.gateway_moves" if address else "plant.gateway_moves_anywhere" if after else "plant.gateway_ends"
        notes.append(localized(key, {"gateway": before.id, "address": address}))
    return notes


def _unique(texts: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(texts))


def _diagnostics_json(error: ConfigurationError) -> list[Json]:
    diagnostics: Iterable[Diagnostic] = error.params.get("diagnostics", ())
    return [
        {"line": diagnostic.line, "key": diagnostic.key, "found": diagnostic.found.en, "text": to_plain(diagnostic)}
        for diagnostic in diagnostics
    ] or [{"line": None, "key": "", "found": "", "text": localized(error.key, error.params)}]


if __name__ == "__main__":
    set_nice(NICE_BATCH)
    limit_memory(MAX_CHECK_BYTES)
    json.dump(check_text(*pickle.load(sys.stdin.buffer)), sys.stdout)
