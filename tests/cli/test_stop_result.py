"""Result of a stop of many drives: the same document, sentence and exit code by every way to ask for it."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from drivebus import i18n
from drivebus.bus import Bus
from drivebus.bus.messages import BusRequest, BusResult
from drivebus.cli import dry_run
from drivebus.cli.commands import coast, stop
from drivebus.cli.errors import report_error
from drivebus.cli.main import cli
from drivebus.cli.remote import client
from drivebus.drives.outcome import Outcome, OutcomeStatus, raise_for_status
from drivebus.errors import OutcomeUnknown
from drivebus.service.ipc.protocol import SERVICE_SOCKET, socket_path
from drivebus.simulator.port import simulated_bus_of
from drivebus.testing import virtual_time
from drivebus.types import Json

WAYS = (("--directory", "state"), ("--service", "http://127.0.0.1:8080"))
CONFIRMED, ACKNOWLEDGED = {"status": "confirmed"}, {"status": "acknowledged"}
LOST = {"code": "bus.no_reply", "kind": "NoReply"}


def stop_all(monkeypatch: pytest.MonkeyPatch, outcomes: Json, *words: str) -> tuple[int, str]:
    """Stop everything by each way, with this answer of the service; return the one exit code and the one output.

    The address of the service, which the command for the release names, is replaced by SERVICE.
    """
    answer: Json = {"buses": {"a": {"took_s": 0.5}} if outcomes else {}, "outcomes": outcomes}

    async def request_stop(folder: Any) -> Json:
        return answer

    monkeypatch.setattr(stop, "_request_stop", request_stop)
    monkeypatch.setattr(client, "call_once", lambda *given: answer)
    results = [CliRunner().invoke(cli, ["stop", "--all", *way, *words]) for way in WAYS]
    services = [str(socket_path(Path("state"), SERVICE_SOCKET)), WAYS[1][1]]
    texts = [result.stdout.replace(service, "SERVICE") for result, service in zip(results, services, strict=True)]
    (found,) = {(result.exit_code, text) for result, text in zip(results, texts, strict=True)}
    return found


@pytest.mark.parametrize(
    ("outcomes", "code"),
    [
        ({"a": CONFIRMED}, 0),
        ({"a": CONFIRMED, "b": ACKNOWLEDGED}, 0),
        ({"a": CONFIRMED, "b": ACKNOWLEDGED, "c": LOST}, 4),
        ({}, 4),
    ],
)
def test_a_drive_that_cannot_report_is_acknowledged_and_a_plant_without_drives_is_not_stopped(
    monkeypatch: pytest.MonkeyPatch, outcomes: Json, code: int
) -> None:
    found = stop_all(monkeypatch, outcomes, "--json")
    document = json.loads(found[1])
    assert found[0] == code
    assert (document["confirmed"], document["acknowledged"], document["unconfirmed"]) == (
        [drive for drive in outcomes if drive == "a"],
        [drive for drive in outcomes if drive == "b"],
        [drive for drive in outcomes if drive == "c"],
    )


INHIBITED = "bus_stop.inhibited", ""


@pytest.mark.parametrize("language", i18n.LANGUAGES)
@pytest.mark.parametrize(
    ("outcomes", "sentences"),
    [
        ({"a": CONFIRMED, "b": CONFIRMED}, [("bus_stop.confirmed", "ab"), INHIBITED]),
        ({"a": ACKNOWLEDGED, "b": CONFIRMED}, [("bus_stop.confirmed", "b"), ("bus_stop.acknowledged", "a"), INHIBITED]),
        ({"a": LOST, "b": {"status": "refused"}}, [("bus_stop.unknown", "ab"), INHIBITED]),
        (
            {"a": LOST, "b": ACKNOWLEDGED, "c": CONFIRMED},
            [("bus_stop.confirmed", "c"), ("bus_stop.acknowledged", "b"), ("bus_stop.unknown", "a"), INHIBITED],
        ),
        ({}, [("bus_stop.no_drives", "")]),
    ],
)
def test_each_drive_is_in_the_sentence_of_its_own_outcome_and_in_no_other(
    monkeypatch: pytest.MonkeyPatch, outcomes: Json, sentences: list[tuple[str, str]], language: str
) -> None:
    """An acknowledged stop is not called unconfirmed, nor one that a drive rejected acknowledged."""
    text = " ".join(stop_all(monkeypatch, outcomes, "--lang", language)[1].split())
    expected = [
        i18n.text(key, language, addresses=i18n.join(names, "items", language), service="SERVICE")
        for key, names in sentences
    ]
    assert text == i18n.join(expected, "sentences", language)


STOPS = ["stop", "stop --quick", "coast"]


@pytest.mark.parametrize("words", [("--address", "3"), ("--all",), ("--all", "--address", "3")])
def test_a_stop_whose_port_can_not_be_opened_is_called_not_sent_and_ends_with_code_4(words: tuple[str, ...]) -> None:
    result = CliRunner().invoke(cli, ["stop", "/dev/ttyNone9", "--model", "c320", *words, "--lang", "en"])
    assert result.exit_code == 4
    assert result.stderr.startswith("drivebus: STOP NOT SENT: /dev/ttyNone9 does not exist")
    assert "Use the hard-wired stop" in result.stderr
    document = json.loads(
        CliRunner().invoke(cli, ["stop", "/dev/ttyNone9", "--model", "c320", *words, "--json"]).stdout
    )
    assert (document["error"]["key"], document["exit"]) == ("bus_stop.not_sent", 4)


@pytest.mark.parametrize("command", STOPS)
def test_each_command_that_stops_calls_a_stop_without_a_port_not_sent(command: str) -> None:
    words = [*command.split(), "/dev/ttyNone9", "--model", "vc660", "--address", "3", "--json"]
    result = CliRunner().invoke(cli, words)
    document = json.loads(result.stdout)
    assert (document["error"]["key"], document["exit"], result.exit_code) == ("bus_stop.not_sent", 4, 4)


def test_an_interrupted_coast_stop_is_not_silent_either(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*given: Any, **named: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(coast, "run_command", interrupt)
    result = CliRunner().invoke(cli, ["coast", "sim://c320@1", "--model", "c320", "--address", "1", "--json"])
    assert (result.exit_code, json.loads(result.stdout)["error"]["key"]) == (4, "bus_stop.interrupted")


@pytest.mark.parametrize(
    "words",
    [
        ("sim://c320@1", "--model", "c320", "--address", "1"),
        ("--all", "sim://c320@1", "--model", "c320"),
        ("--all", "--directory", "state"),
        ("--all", "--service", "http://127.0.0.1:8080"),
    ],
)
def test_an_interrupted_stop_is_not_silent_and_ends_as_an_unconfirmed_one(
    monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    def interrupt(*given: Any, **named: Any) -> Any:
        raise KeyboardInterrupt

    for owner, name in (
        (stop, "run_command"),
        (stop, "_stop_addresses"),
        (stop, "_request_stop"),
        (client, "call_once"),
    ):
        monkeypatch.setattr(owner, name, interrupt)
    result = CliRunner().invoke(cli, ["stop", *words, "--json"])
    error = json.loads(result.stdout)["error"]
    assert (result.exit_code, error["key"]) == (4, "bus_stop.interrupted")


@pytest.mark.parametrize("command", ["stop", "stop --all", "coast"])
def test_an_interrupted_dry_run_is_no_unconfirmed_stop(monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    """It sends nothing, so that no drive has to be checked."""

    def interrupt(*given: Any, **named: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(dry_run, "print_plan", interrupt)
    words = [*command.split(), "sim://vc660@1", "--model", "vc660", "--address", "1", "--dry-run", "--json"]
    result = CliRunner().invoke(cli, words)
    assert (result.exit_code, "NOT CONFIRMED" in result.output) == (130, False)


@pytest.mark.parametrize("command", STOPS)
def test_a_stop_through_a_service_that_does_not_answer_is_unknown_and_names_the_drive(
    tmp_path: Path, command: str
) -> None:
    words = [*command.split(), "--service", str(tmp_path / "plant.sock"), "--drive", "fan-1", "--lang", "en"]
    result = CliRunner().invoke(cli, words)
    assert result.exit_code == 4
    assert "fan-1 could not be stopped through the service, check the drive locally" in result.stderr


def test_a_stop_that_is_not_confirmed_is_printed_with_its_reason_once_for_all_drives(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lost = {"status": "unknown", "text": {"en": "STOP NOT SENT: the port is not open", "zh": "停机命令未发送"}}
    code, text = stop_all(monkeypatch, {"fan": lost, "pump": CONFIRMED, "saw": lost}, "--lang", "en")
    assert (code, text.count("STOP NOT SENT")) == (4, 1)
    assert "\n  fan, saw: STOP NOT SENT: the port is not open\n" in text


def lose_the_port_in_the_sweep(monkeypatch: pytest.MonkeyPatch, returns_after_s: float | None) -> list[int]:
    """Unplug the adapter at the eighth request of a command; return the addresses that are asked from now on."""
    transact, asked = Bus.transact, list[int]()

    async def lose_the_port(bus: Bus, request: BusRequest) -> BusResult:
        asked.append(request.station)
        if len(asked) == 8:
            simulated_bus_of(bus.port).unplug()
            if returns_after_s is not None:
                asyncio.get_running_loop().call_later(returns_after_s, simulated_bus_of(bus.port).replug)
        return await transact(bus, request)

    monkeypatch.setattr(Bus, "transact", lose_the_port)
    return asked


@pytest.mark.parametrize("addresses", [(1, 20), (20, 21)])
def test_a_port_that_returns_lets_the_other_addresses_be_stopped(
    monkeypatch: pytest.MonkeyPatch, addresses: tuple[int, ...]
) -> None:
    """Before and after the loss, and where no drive had replied before it: a drive there was sent no stop."""
    lose_the_port_in_the_sweep(monkeypatch, returns_after_s=1.0)
    url = f"sim://c320@{','.join(map(str, addresses))}"
    result = CliRunner().invoke(cli, ["stop", "--all", url, "--model", "c320", "--baud", "19200", "--json"])
    document = json.loads(result.stdout)
    assert (result.exit_code, document["lost"], len(document["absent"])) == (0, [], 29)
    assert document["confirmed"] == list(addresses)


def test_addresses_that_a_lost_port_left_unasked_are_not_called_without_reply(monkeypatch: pytest.MonkeyPatch) -> None:
    """A drive may be there: a stop of the others alone is no success."""
    asked = lose_the_port_in_the_sweep(monkeypatch, returns_after_s=None)
    words = ["stop", "--all", "sim://c320@1-2", "--model", "c320", "--baud", "19200"]
    document = json.loads(CliRunner().invoke(cli, [*words, "--json"]).stdout)
    assert document["lost"] and len(document["absent"]) + len(document["lost"]) == 29
    asked.clear()
    result = CliRunner().invoke(cli, [*words, "--lang", "en"], env={"COLUMNS": "200"})
    assert result.exit_code == 4
    assert f"The port was lost before {len(document['lost'])} other addresses had replied" in result.stdout


@pytest.mark.parametrize("address", [20, 30])
@pytest.mark.parametrize("always", [False, True])
def test_a_drive_that_replies_late_in_the_sweep_is_stopped_and_not_called_absent(
    monkeypatch: pytest.MonkeyPatch, address: int, always: bool
) -> None:
    """The late reply comes while the next address is asked, or after the last one."""
    monkeypatch.setattr(asyncio, "run", virtual_time.run)  # the late reply meets no request on the wire
    transact = Bus.transact

    async def reply_late(bus: Bus, request: BusRequest) -> BusResult:
        if request.station == 1:
            faults = simulated_bus_of(bus.port).station(address).faults
            faults.next_added_delays_s = [0.05] * (100 if always else 1)
        return await transact(bus, request)

    monkeypatch.setattr(Bus, "transact", reply_late)
    result = CliRunner().invoke(
        cli, ["stop", "--all", f"sim://c320@{address}", "--model", "c320", "--baud", "19200", "--json"]
    )
    document = json.loads(result.stdout)
    assert (result.exit_code, len(document["absent"])) == (4 if always else 0, 30)
    assert document["unconfirmed" if always else "confirmed"] == [address]
    assert address not in document["absent"]


def test_a_failed_write_is_printed_with_the_writes_that_were_not_sent(capsys: pytest.CaptureFixture[str]) -> None:
    unsent = ("drives.write_unsent", {"notation": "F9.4", "value": 5, "unit": ""})
    params = {"notation": "F1.10", "value": 1, "unit": "", "why": "no reply"}
    outcome = Outcome(status=OutcomeStatus.UNKNOWN, key="drives.write_unknown", params=params, notes=(unsent,))
    with pytest.raises(OutcomeUnknown) as caught:
        raise_for_status(outcome)
    report_error(caught.value)
    printed = capsys.readouterr().err
    assert "F1.10 = 1 was sent and could not be read back (no reply)\n" in printed
    assert "\n  not sent, because an earlier write did not succeed: F9.4 = 5\n" in printed


def test_a_stop_of_everything_names_the_whole_command_that_releases_the_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    """The state directory of the plant file does not say by itself where the service listens."""
    code, text = stop_all(monkeypatch, {"fan": CONFIRMED}, "--lang", "en")
    assert code == 0
    assert "`drivebus release --service SERVICE --all`" in text.replace("\n", " ")
