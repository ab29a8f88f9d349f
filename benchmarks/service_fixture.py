"""A real ``drivebus serve plant.toml`` to measure: its configuration, token, two processes, and their use."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from http.client import HTTPConnection
from pathlib import Path

BENCHMARK_TOKEN = "dbt_benchmark"
"""Token of a user who may view, stop and operate."""
SERVICE_COMMAND = [sys.executable, "-m", "drivebus"]
SYSTEMD_UNIT = Path(__file__).parents[1] / "src" / "drivebus" / "service" / "systemd" / "drivebus.service"
START_TIMEOUT_S = 180.0


def plant_text(directory: Path, port: int, links: Sequence[str], drives: int, baud: int) -> str:
    """Return ``plant.toml``: VC660s at 1 to ``drives`` of each bus, polled at the interval that the plant chooses."""
    parts = [
        f'format = 1\n[plant]\nid = "bench"\ntitle = "Benchmark"\ndirectory = {json.dumps(str(directory))}',
        f"[gateway.web]\nport = {port}",
    ]
    for line, link in enumerate(links):
        parts.append(f'[bus.line-{line}]\nport = {json.dumps(link)}\nbaud = {baud}\nformat = "8N1"')
        parts += [
            f'[drive.{drive_id(line, address)}]\nbus = "line-{line}"\naddress = {address}\nmodel = "vc660"'
            for address in range(1, drives + 1)
        ]
    return "\n".join(parts) + "\n"


def drive_id(line: int, address: int) -> str:
    return f"d{line}-{address}"


@dataclass(frozen=True, kw_only=True)
class BenchmarkService:
    """Directory, port and process ids of a running service, and the monotonic seconds of its start."""

    directory: Path
    port: int
    plant: int
    """Process id of the plant."""
    web: int
    """Process id of the web process."""
    begun: float
    """Second of the start command."""
    socket_at: float
    """Second at which the plant's socket existed."""
    web_at: float
    """Second at which the web process answered."""

    @property
    def sockets(self) -> tuple[Path, Path]:
        """Paths of the service's socket and of the one that only takes "stop all"."""
        return self.directory / "plant.sock", self.directory / "stop.sock"

    @property
    def processes(self) -> dict[str, int]:
        """Process ids by role."""
        return {"plant": self.plant, "web": self.web}


@contextmanager
def running_service(
    folder: Path,
    links: Sequence[str],
    drives: int,
    baud: int,
    on_socket: Callable[[Path], None] = lambda directory: None,
) -> Iterator[BenchmarkService]:
    """Run the whole service on loopback for the time of a ``with``.

    ``on_socket`` is called with the state directory as soon as the plant's socket exists, before the web answers.
    """
    directory, port, file = folder / "state", free_port(), folder / "plant.toml"
    directory.mkdir(mode=0o700)
    file.write_text(plant_text(directory, port, links, drives, baud))
    add_benchmark_user(directory)
    environment = os.environ | {"XDG_STATE_HOME": str(folder)}
    begun = time.monotonic()
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            [*SERVICE_COMMAND, "serve", str(file)], stdout=subprocess.DEVNULL, stderr=log, env=environment
        )
        _apply_unit_priority(process.pid)
        try:
            socket_at = _wait_until(lambda: (directory / "plant.sock").exists(), process, folder)
            on_socket(directory)
            web_at = _wait_until(lambda: _web_answers(port), process, folder)
            yield BenchmarkService(
                directory=directory,
                port=port,
                plant=process.pid,
                web=_child_of(process.pid),
                begun=begun,
                socket_at=socket_at,
                web_at=web_at,
            )
        finally:
            process.terminate()
            try:
                process.wait(START_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _apply_unit_priority(pid: int) -> None:
    """Set the priority of the systemd unit, where this user may."""
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, pid, int(re.findall(r"(?m)^Nice=(.+)", SYSTEMD_UNIT.read_text())[0]))


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def add_benchmark_user(directory: Path) -> None:
    """Write the users' file of a state directory: one user with ``BENCHMARK_TOKEN``."""
    from drivebus.service.auth.rights import Right, Role
    from drivebus.service.auth.sessions import secret_digest
    from drivebus.service.auth.users import Token, User, UserDatabase, UserFile

    user = User("bench", Role.ADMINISTRATOR, "never used", 0)
    rights = (Right.VIEW, Right.STOP, Right.OPERATE)
    token = Token(
        id="1",
        name="bench",
        user="bench",
        rights=rights,
        digest=secret_digest(BENCHMARK_TOKEN),
        created_ms=0,
        expires_ms=4_000_000_000_000,
    )
    UserFile(directory / "users.json").change(lambda _: UserDatabase().with_user(user).with_token(token))


def _wait_until(ready: Callable[[], bool], process: subprocess.Popen[bytes], folder: Path) -> float:
    """Return the second at which ``ready`` was true. Raises RuntimeError where the service ended or time ran out."""
    last = time.monotonic() + START_TIMEOUT_S
    while not ready():
        if process.poll() is not None or time.monotonic() > last:
            raise RuntimeError((folder / "log").read_text()[-2000:])
        time.sleep(0.01)
    return time.monotonic()


def _web_answers(port: int) -> bool:
    connection = HTTPConnection("127.0.0.1", port, timeout=5.0)
    try:
        connection.request("GET", "/api/v1/health")
        return connection.getresponse().status == 200
    except OSError:
        return False
    finally:
        connection.close()


def _child_of(pid: int) -> int:
    """Return the id of the web process, the plant's only child."""
    found = [int(file.parent.name) for file in Path("/proc").glob("[0-9]*/stat") if _parent_pid(file) == pid]
    return found[0]


def _parent_pid(file: Path) -> int | None:
    try:
        return int(file.read_text().rpartition(")")[2].split()[1])
    except OSError:
        return None


# --- use of a process -------------------------------------------------------------------------------------------------


def memory_mb(pid: int) -> dict[str, float]:
    """Return the proportional set size (pss), the resident size (rss) and its maximum so far (most)."""
    rollup, status = Path(f"/proc/{pid}/smaps_rollup").read_text(), Path(f"/proc/{pid}/status").read_text()
    return {"pss": _mb(rollup, "Pss:"), "rss": _mb(status, "VmRSS:"), "most": _mb(status, "VmHWM:")}


def _mb(text: str, name: str) -> float:
    line = next(line for line in text.splitlines() if line.startswith(name))
    return round(int(line.split()[1]) / 1024, 1)


def cpu_s(pid: int) -> float:
    """Return the seconds of processor time so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
