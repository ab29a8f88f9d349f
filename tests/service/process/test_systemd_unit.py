"""The systemd unit fits the service process."""

from __future__ import annotations

import configparser
import shutil
import subprocess
import sys
from pathlib import Path

import drivebus.service
from drivebus.cli.errors import ExitCode
from drivebus.service.control.stops import SERVICE_STOP_TIMEOUT_S
from drivebus.service.process.systemd import MAX_BUS_LATENESS_S
from drivebus.service.process.tuning import NICE_GATEWAY

UNIT = Path(drivebus.service.__file__).parent / "systemd" / "drivebus.service"


def service() -> configparser.SectionProxy:
    found = configparser.ConfigParser(strict=False, interpolation=None)
    found.optionxform = str  # type: ignore[assignment,method-assign]
    found.read(UNIT)
    return found["Service"]


def test_systemd_waits_for_ready_watches_the_buses_and_leaves_time_to_stop_the_drives() -> None:
    unit = service()
    assert (unit["Type"], unit["NotifyAccess"]) == ("notify", "main")
    assert float(unit["WatchdogSec"]) >= 2 * MAX_BUS_LATENESS_S
    assert unit["KillMode"] == "mixed"  # SIGTERM to the service only: it ends its gateways itself
    assert float(unit["TimeoutStopSec"]) > 2 * SERVICE_STOP_TIMEOUT_S
    assert unit["ExecReload"].endswith("-HUP $MAINPID")
    assert unit["StateDirectoryMode"] == "0700"
    assert unit["SuccessExitStatus"] == str(int(ExitCode.INTERRUPTED)), "ended during its start"


def test_the_service_comes_before_other_work_of_the_machine_and_its_gateways() -> None:
    """A stop does not wait for a compiler, nor does the page, which stops drives.

    The nice level counts only among processes of one control group, the weight between those of services.
    """
    default_weight = 100
    assert int(service()["CPUWeight"]) >= 10 * default_weight
    precedence = int(service()["Nice"])
    assert precedence < precedence + NICE_GATEWAY < 0


def test_the_service_can_read_whether_the_clock_is_synchronized() -> None:
    """``ProtectClock`` and a filter without ``@clock`` block adjtimex(2) altogether, reading included."""
    assert service()["CapabilityBoundingSet"] == "", "the clock cannot be set"
    assert not {"ProtectClock", "SystemCallFilter"} & service().keys()


def test_the_service_has_no_rights_beyond_its_state_and_serial_adapters() -> None:
    unit = service()
    assert (unit["User"], unit["CapabilityBoundingSet"], unit["UMask"]) == ("drivebus", "", "0077")
    assert (unit["ProtectSystem"], unit["DevicePolicy"], unit["StateDirectory"]) == ("strict", "closed", "drivebus")
    assert not {"ReadWritePaths", "AmbientCapabilities", "BindPaths"} & unit.keys()
    for name in (
        "NoNewPrivileges",
        "ProtectHome",
        "PrivateTmp",
        "ProtectKernelTunables",
        "ProtectKernelModules",
        "ProtectControlGroups",
        "RestrictNamespaces",
        "RestrictSUIDSGID",
    ):
        assert unit[name] == "yes", name
    allowed = [line for line in UNIT.read_text().splitlines() if line.startswith("DeviceAllow=")]
    assert allowed and all(line.startswith("DeviceAllow=char-tty") for line in allowed), "terminals only"


def test_systemd_accepts_the_unit(tmp_path: Path) -> None:
    """Runs only where systemd is installed."""
    if (analyze := shutil.which("systemd-analyze")) is None:
        return
    copy = tmp_path / UNIT.name
    copy.write_text(UNIT.read_text().replace("/usr/local/bin/drivebus", sys.executable))
    done = subprocess.run([analyze, "verify", str(copy)], capture_output=True, text=True, check=False)
    messages = [line for line in done.stderr.splitlines() if UNIT.name in line]
    assert not messages, messages
