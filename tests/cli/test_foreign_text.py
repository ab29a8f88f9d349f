"""Texts that come from a capture, a device or another program command no terminal and forge no line."""

from __future__ import annotations

import contextvars
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

from drivebus.cli import output
from drivebus.cli.commands.ports import ports_table
from drivebus.cli.main import cli
from drivebus.ports import discovery
from drivebus.ports.discovery import DeviceUser, PortInfo, describe, process_name

CLEAR, TITLE = "\x1b[2J", "\x1b]0;title\x07"
C1_CLEAR = "\x9b2J"
HEADER = {"dbcap": 1, "baud": 9600, "format": "8E1", "port": f"p{TITLE}{C1_CLEAR}\nfake"}


def invoke(*arguments: str) -> str:
    """Return all output of a command, as a pipe gets it."""
    return CliRunner().invoke(cli, arguments, color=True).output


@pytest.mark.parametrize("second", ['{"t": 0.1, "event": "opened"}', f"{CLEAR}{TITLE}{C1_CLEAR}"])
def test_a_capture_of_another_person_sends_no_escape_sequence_to_the_terminal(second: str, tmp_path: Path) -> None:
    capture = tmp_path / "trip.dbcap"
    capture.write_text(json.dumps(HEADER, ensure_ascii=False) + f"\n{second}\n", encoding="utf-8")
    shown = invoke("monitor", str(capture), "--model", "vc660", "--plain")
    assert ("p�]0;title��2J�fake" in shown) != ("�[2J�]0;title��2J" in shown), shown
    assert not {"\x1b", "\x07", "\x9b"} & set(shown)


def test_the_name_of_a_program_or_an_adapter_forges_no_row_of_the_ports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "7").mkdir()
    (tmp_path / "7" / "comm").write_text("a\n/dev/x\x1b[2J\n")
    monkeypatch.setattr(discovery, "PROC", tmp_path)
    assert process_name(7) == "a�/dev/x�[2J"
    product = f"Adapter{CLEAR}\n/dev/ttyUSB9"
    device: Any = SimpleNamespace(
        resolved_device="/dev/ttyUSB0",
        vid=None,
        pid=None,
        serial_number=None,
        manufacturer=None,
        product=product,
        interface_description=None,
    )
    (port,) = describe([device], {}, {})
    assert port.description == "Adapter�[2J�/dev/ttyUSB9"


def test_a_printed_text_keeps_its_line_breaks_and_no_other_control_code(capsys: pytest.CaptureFixture[str]) -> None:
    port = PortInfo(device="/dev/x", description=CLEAR, identity="", url="/dev/x", users=(DeviceUser(1, TITLE),))
    output.print_text(ports_table([port]) + "\n\tend")
    output.echo(C1_CLEAR, err=True)
    printed = capsys.readouterr()
    assert "�[2J" in printed.out and "�]0;title� (1)\n\tend\n" in printed.out and "\x1b" not in printed.out
    assert printed.err == "�2J\n"


def test_a_json_document_has_every_control_code_as_an_escape(capsys: pytest.CaptureFixture[str]) -> None:
    value = {"text": f"{CLEAR}{C1_CLEAR}\x7f\n变"}
    contextvars.copy_context().run(lambda: (output.parse_global_options(["--json"]), output.print_json(value)))
    printed = capsys.readouterr().out
    assert json.loads(printed) == value and "变" in printed
    assert all(char.isprintable() or char == "\n" for char in printed)


def test_a_bidirectional_mark_of_a_device_does_not_reorder_a_printed_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Only the responses of a service were free of these marks."""
    output.print_text("adapter \u202e1 yportlairesu\u2066 \u200b变")
    assert capsys.readouterr().out == "adapter �1 yportlairesu� �变\n"
