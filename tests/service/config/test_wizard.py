"""``drivebus init``: the file that it writes loads, in both languages and with its examples; it overwrites nothing."""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import tomllib
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from hypothesis import given, settings
from hypothesis import strategies as st

from drivebus.cli.commands import init as init_command
from drivebus.cli.main import cli
from drivebus.cli.scanning import ScanRequest
from drivebus.commissioning.scan import DetectedDrive, ScanProgress
from drivebus.errors import ConfigurationError, PortLost
from drivebus.serial_settings import SerialSettings
from drivebus.service import config
from drivebus.service.config.wizard import BusAnswer, DriveAnswer, PlantAnswers, plant_toml, read_answers

ANSWERS = """
title = "Boiler house 锅炉房"
[[bus]]
port = "/dev/ttyUSB0"
model = "c320"
addresses = "1-2,7"
names = ["Supply fan", "Supply fan"]
baud = 19200
[[bus]]
port = "tcp://127.0.0.1:4001"
model = "vc660"
addresses = "1"
"""


def init(*words: Any, input: str | None = None) -> Result:
    return CliRunner().invoke(cli, ["init", *(str(word) for word in words)], input=input)


@pytest.fixture
def answers(tmp_path: Path) -> Path:
    path = tmp_path / "answers.toml"
    path.write_text(ANSWERS, encoding="utf-8")
    return path


@pytest.mark.parametrize("language", ["en", "zh"])
def test_answers_become_a_plant_that_passes_check(answers: Path, tmp_path: Path, language: str) -> None:
    path = tmp_path / "plant.toml"
    result = init("--answers", answers, "-o", path, "--lang", language)
    assert result.exit_code == 0 and str(path) in result.output
    plant = config.load(path)
    assert (plant.id, plant.title.zh) == ("boiler-house", "Boiler house 锅炉房")
    assert [(drive.id, drive.bus, drive.address) for drive in plant.drives] == [
        ("supply-fan", "a", 1),
        ("supply-fan-2", "a", 2),
        ("c320-7", "a", 7),
        ("vc660-1", "b", 1),
    ]
    assert plant.buses[0].baud == 19200
    comments = [line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("#")]
    assert any("一" <= character <= "鿿" for character in "".join(comments)) is (language == "zh")
    assert CliRunner().invoke(cli, ["check", str(path)]).exit_code == 0


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize("addresses", [(1,), (1, 2)])
@pytest.mark.parametrize("model", ["c320", "dzb100", "vc660", "df800", "e300"])
def test_every_example_in_the_comments_is_valid(model: str, addresses: tuple[int, ...], language: str) -> None:
    """Beside the paths, which do not exist here."""
    drives = tuple(DriveAnswer(address, model) for address in addresses)
    text = plant_toml(PlantAnswers("P", (BusAnswer("tcp://127.0.0.1:1", drives),)), language)
    paths = r"# (directory|certificate|key) = "
    lines = [line for line in text.splitlines() if not re.match(paths, line)]
    plain = "\n".join(re.sub(r"^# (?=\[[a-z]|[a-z_]+ = )", "", line) for line in lines)
    plant = config.loads(plain)
    assert plant.drives[0].limits.maximum_hz == 45.0
    assert plant.groups and plant.alarms and plant.history.retention.raw_days == 2.0
    assert len(plant.interlocks) == (model != "df800")


def test_nothing_is_overwritten_without_force(answers: Path, tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    path.write_text("mine")
    result = init("--answers", answers, "-o", path)
    assert (result.exit_code, path.read_text()) == (2, "mine")
    assert "--force" in result.output
    assert init("--answers", answers, "-o", path, "--force").exit_code == 0
    assert config.load(path).id == "boiler-house"


def test_a_plant_file_stays_where_the_new_one_can_t_be_written_and_that_one_is_printed(
    answers: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a full disk the old plant was gone, and so were the answers or the scan."""
    path = tmp_path / "plant.toml"
    path.write_text("mine")

    def fail(fd: int, data: bytes) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("drivebus.atomic_write.write_all", fail)
    result = init("--answers", answers, "-o", path, "--force", "--lang", "en")
    assert (result.exit_code, path.read_text()) == (2, "mine")
    assert tomllib.loads(result.stdout)["plant"]["id"] == "boiler-house"
    assert "No space left on device" in result.stderr and "free space" in result.stderr
    assert sorted(file.name for file in tmp_path.iterdir()) == ["answers.toml", "plant.toml"]
    result = init("--answers", answers, "-o", path, "--force", "--json")
    assert json.loads(result.stdout)["error"]["key"] == "cli.file_unwritten", "one document; the plant is beside it"
    assert "boiler-house" in result.stderr


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("missing/plant.toml", "No such file or directory"),
        ("answers.toml/plant.toml", "Not a directory"),
        (".", "Is a directory"),
    ],
)
@pytest.mark.parametrize("words", [(), ("--force",)])
def test_a_file_that_can_t_be_written_is_named_before_the_scan(
    answers: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, found: str, words: tuple[str, ...]
) -> None:
    """It was named after up to 49 minutes, and what the scan had found was gone."""

    def fail(*_: Any) -> None:
        raise AssertionError("scanned")

    monkeypatch.setattr(init_command, "_scan_ports", fail)
    result = init("sim://c320@1", "--scan", "-o", tmp_path / name, *words, "--lang", "en")
    assert (result.exit_code, found in result.stderr) == (2, True), result.output


def test_it_can_go_to_standard_output(answers: Path) -> None:
    result = init("--answers", answers, "-o", "-")
    assert result.exit_code == 0 and tomllib.loads(result.stdout)["plant"]["id"] == "boiler-house"


@pytest.mark.parametrize(
    ("before", "after", "text"),
    [
        ('"1-2,7"', '"1-2;7"', "addresses"),
        ('"1-2,7"', '"7-2"', "7-2"),
        ('"c320"', '"c999"', "c999"),
        ('addresses = "1"', 'addresses = "300"', "<= 255"),
        ('port = "/dev/ttyUSB0"', "", "port"),
        ("[[bus]]", "[[buses]]", "buses"),
        ('"1-2,7"', '"1-2,7', "TOML"),
    ],
)
def test_invalid_answers_are_rejected_and_nothing_is_written(
    answers: Path, tmp_path: Path, before: str, after: str, text: str
) -> None:
    answers.write_text(ANSWERS.replace(before, after), encoding="utf-8")
    result = init("--answers", answers, "-o", tmp_path / "plant.toml")
    assert result.exit_code == 2 and text in result.output
    assert not (tmp_path / "plant.toml").exists()


def test_the_models_of_answers_are_taken_in_any_case(answers: Path, tmp_path: Path) -> None:
    answers.write_text(ANSWERS.replace('"vc660"', '"VC660"').replace('"c320"', '"C320"'), encoding="utf-8")
    assert init("--answers", answers, "-o", tmp_path / "plant.toml").exit_code == 0
    assert {drive.model for drive in config.load(tmp_path / "plant.toml").drives} == {"c320", "vc660"}


def test_without_a_terminal_there_are_no_questions(tmp_path: Path) -> None:
    result = init("/dev/ttyUSB0", "-o", tmp_path / "plant.toml")
    assert result.exit_code == 2 and "--answers" in result.output


def test_a_few_questions_make_a_plant(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(init_command, "_on_terminal", lambda: True)
    path = tmp_path / "plant.toml"
    message = "Pump station\nttyUSB0\ntpc://10.0.0.7:4001\n/dev/ttyUSB0\nvc66\nvc660\n1-x\n0-2\n1-2\nMain pump\n\nn\n"
    result = init("-o", path, "--lang", "en", input=message)
    assert result.exit_code == 0, result.output
    plant = config.load(path)
    assert (plant.id, plant.buses[0].port) == ("pump-station", "/dev/ttyUSB0")
    for wrong in (
        "ttyUSB0 is no port URL",
        "scheme tpc",
        "there is no model vc66",
        "found 1-x",
        "address 0 is the broadcast address",
    ):
        assert wrong in result.output, "asked again, with the reason"
    assert [(drive.id, drive.address, drive.title.en) for drive in plant.drives] == [
        ("main-pump", 1, "Main pump"),
        ("vc660-2", 2, "vc660 2"),
    ]


def test_a_scan_writes_the_stations_that_replied(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    words = ["--scan", "--models", "vc660,df800", "--addresses", "1-3", "--listen-seconds", "0", "-o", path]
    result = init("sim://vc660@1,3", *words, "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["drives"] == ["vc660-1", "vc660-3"]
    bus = config.load(path).buses[0]
    assert (bus.baud, bus.format) == (9600, "8N1")


def test_a_scan_writes_the_model_of_a_less_common_make(tmp_path: Path) -> None:
    """Regression: a Goodrive 10 was written as a VC660."""
    path = tmp_path / "plant.toml"
    words = ["--scan", "--addresses", "2", "--listen-seconds", "0", "-o", path]
    assert init("sim://gd10@2?drives=19200-8E1", *words).exit_code == 0
    assert [drive.model for drive in config.load(path).drives] == ["gd10"]


LOOK_ALIKES = ("--scan", "--addresses", "2", "--bauds", "9600", "--formats", "8N2", "--listen-seconds", "0")


def test_none_of_several_look_alikes_is_written_as_the_model(tmp_path: Path) -> None:
    """Regression: the first was written, a shihlin_se2 for an svd_p; it was right for 40 of 120 drives."""
    path = tmp_path / "plant.toml"
    result = init("sim://svd_p@2?drives=9600-8N2", *LOOK_ALIKES, "-o", path, "--json")
    assert result.exit_code == 0, result.output
    printed = json.loads(result.stdout)
    assert printed["drives"] == [] and config.load(path).drives == ()
    (undecided,) = printed["undecided"]
    assert undecided["address"] == 2 and {"svd_p", "shihlin_se2"} <= {*undecided["models"]}
    assert "can't tell which model" in result.stderr and "--models" in result.stderr
    text = path.read_text(encoding="utf-8")
    assert all(model in text for model in undecided["models"])
    uncommented = re.sub(r"(?m)^# (\[drive\.a-2\]|bus = |address = |model = |encoding = )", r"\1", text)
    with pytest.raises(ConfigurationError):
        config.loads(uncommented)
    (drive,) = config.loads(uncommented.replace('model = "?"', 'model = "svd_p"')).drives
    assert (drive.id, drive.model, drive.address, drive.bus) == ("a-2", "svd_p", 2, "a")


def test_the_model_that_the_user_names_is_written_though_others_answer_alike(tmp_path: Path) -> None:
    path = tmp_path / "plant.toml"
    words = ("--scan", "--models", "c320", "--addresses", "1", "--listen-seconds", "0", "-o", path)
    assert init("sim://c320@1", *words).exit_code == 0
    assert [drive.model for drive in config.load(path).drives] == ["c320"]
    assert "or c300" in path.read_text(encoding="utf-8"), "what else it may be stands beside it"
    words = ("--scan", "--models", "c320,e300", *words[3:])
    assert init("sim://c320@1", *words, "--force").exit_code == 0
    assert config.load(path).drives == (), "two were named"


def test_full_width_answers_are_read_as_half_width_ones_and_names_stay(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A Chinese input method types them: the dialog refused ``ｙ`` in English, and ``１，３`` without the reason."""
    monkeypatch.setattr(init_command, "_on_terminal", lambda: True)
    path = tmp_path / "plant.toml"
    message = (
        "泵站（１）\n／ｄｅｖ／ttyUSB0\nＶＣ660\n１，３\n主泵１\n\nｙ\nsim：//c320@1\nＣ320\n１—２\n\n\n也许\n否\n"
    )
    result = init("-o", path, "--lang", "zh", input=message)
    assert result.exit_code == 0, result.output
    plant = config.load(path)
    assert (plant.title.zh, [bus.port for bus in plant.buses]) == ("泵站（１）", ["/dev/ttyUSB0", "sim://c320@1"])
    assert [(drive.model, drive.address) for drive in plant.drives] == [
        ("vc660", 1),
        ("vc660", 3),
        ("c320", 1),
        ("c320", 2),
    ]
    assert plant.drives[0].title.zh == "主泵１"
    assert "收到也许，应为：y 或 n" in result.output


@pytest.mark.parametrize(
    ("typed", "models"),
    [("SVD_P\n", ["svd_p"]), ("svd_p\n", ["svd_p"]), ("gd10\nshihlin_se2\n", ["shihlin_se2"]), ("\n", [])],
)
def test_at_a_terminal_the_user_is_asked_for_the_name_plate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, typed: str, models: list[str]
) -> None:
    monkeypatch.setattr(init_command, "_on_terminal", lambda: True)
    path = tmp_path / "plant.toml"
    result = init("sim://svd_p@2?drives=9600-8N2", *LOOK_ALIKES, "-o", path, "--lang", "en", input=typed)
    assert result.exit_code == 0, result.output
    assert "which model is on the name plate" in result.output
    assert [drive.model for drive in config.load(path).drives] == models


def test_ctrl_c_at_a_name_plate_prints_what_was_found_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Regression: a scan of many minutes was lost."""

    async def find_two(request: ScanRequest, listen_s: float, progress: ScanProgress) -> list[DetectedDrive]:
        progress.found += [found(address, "vc660", "rtu", "modbus") for address in (2, 3)]
        return progress.found

    monkeypatch.setattr(init_command, "search", find_two)
    monkeypatch.setattr(init_command, "_on_terminal", lambda: True)
    path = tmp_path / "plant.toml"
    path.write_text("# mine\n", encoding="utf-8")
    words = ("sim://vc660@2-3", "--scan", "-o", path, "--force")
    result = init(*words, "--lang", "en", input="vc660\n")  # the end of the input acts as Ctrl-C
    assert result.exit_code == 130, result.output
    assert result.stderr.count("which model is on the name plate") == 2
    assert f"Interrupted: {path} is not written." in " ".join(result.stderr.split())
    assert [(drive.address, drive.model) for drive in config.loads(result.stdout).drives] == [(2, "vc660")]
    assert "which model address 3 is" in result.stdout
    assert path.read_text(encoding="utf-8") == "# mine\n"
    printed = json.loads(init(*words, "--json", input="").stdout)
    assert (printed["file"], printed["drives"], len(printed["undecided"])) == (None, [], 2)
    assert config.loads(printed["toml"]).drives == ()


@pytest.mark.parametrize("ends", ["ctrl-c", "port lost"])
def test_a_scan_that_ends_early_keeps_what_was_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ends: str
) -> None:
    """Regression: Ctrl-C, or an adapter that was pulled out, discarded the drives found before it."""

    async def end_early(request: ScanRequest, listen_s: float, progress: ScanProgress) -> list[DetectedDrive]:
        progress.found.append(found(2, "vc660", "rtu", "modbus"))
        if ends == "port lost":
            raise PortLost("bus.closed")
        os.kill(os.getpid(), signal.SIGINT)
        return await asyncio.sleep(60.0, [])

    monkeypatch.setattr(init_command, "search", end_early)
    path = tmp_path / "plant.toml"
    result = init("sim://vc660@2", "--scan", "-o", path, "--lang", "en")
    text = result.stdout if ends == "ctrl-c" else path.read_text(encoding="utf-8")
    assert "which model address 2 is" in text, result.output
    assert (result.exit_code, path.exists()) == ((130, False) if ends == "ctrl-c" else (1, True)), result.output


def test_a_single_candidate_that_answers_only_partly_is_no_question(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The terminal asked which of one model is on the name plate, and that the bus can't tell it apart."""
    partly = DetectedDrive(
        models=("vc660",), setpoint_steps_hz={}, family="modbus", encoding="rtu", address=2, fits_partly=True,
        settings=SerialSettings.parse(9600, "8N1"), exchange=(b"", b""),
    )  # fmt: skip

    async def found(request: ScanRequest, listen_s: float, progress: ScanProgress) -> list[DetectedDrive]:
        progress.found.append(partly)
        return progress.found

    monkeypatch.setattr(init_command, "search", found)
    monkeypatch.setattr(init_command, "_on_terminal", lambda: True)
    path = tmp_path / "plant.toml"
    result = init("sim://vc660@2", "--scan", "-o", path, "--lang", "en", input="vc660\n")
    assert result.exit_code == 0 and "which model" not in result.output
    assert "address 2 does not answer as a vc660 should" in " ".join(result.output.split())
    text = path.read_text(encoding="utf-8")
    assert '# model = "?"' in text and "Address 2 does not answer as a vc660 should" in text
    assert config.load(path).drives == (), "the model that it does not answer as is no guess"


@pytest.mark.parametrize("language", ["en", "zh"])
def test_rules_and_examples_name_only_drives_whose_model_is_known(language: str) -> None:
    drives = (DriveAnswer(1, "", candidates=("gd10", "vc660")), DriveAnswer(2, "vc660"))
    text = plant_toml(PlantAnswers("x", (BusAnswer("tcp://127.0.0.1:1", drives),)), language)
    assert [drive.address for drive in config.loads(text).drives] == [2]
    assert {"en": "gd10, vc660", "zh": "gd10、vc660"}[language] in text and '# drives = ["vc660-2"]' in text


def test_a_model_that_fits_only_partly_is_written_with_its_doubt() -> None:
    drives = (DriveAnswer(1, "vc660", is_doubtful=True), DriveAnswer(2, "vc660"))
    text = plant_toml(PlantAnswers("x", (BusAnswer("tcp://127.0.0.1:1", drives),)), "en")
    assert text.count("check the nameplate") == 1 and "in doubt" in text


def test_a_port_without_drives_or_that_can_t_be_opened_does_not_discard_those_of_another(tmp_path: Path) -> None:
    """Up to 49 minutes of scan were lost, and nothing was written."""
    path = tmp_path / "plant.toml"
    missing = str(tmp_path / "ttyUSB9")
    words = ("--scan", "--models", "vc660", "--addresses", "2", "--bauds", "9600", "--listen-seconds", "0")
    result = init("sim://vc660@2", missing, "sim://vc660@3?name=empty", *words, "-o", path, "--lang", "en")
    assert result.exit_code == 1, result.output
    assert [bus.port for bus in config.load(path).buses] == ["sim://vc660@2"]
    assert f"{missing}: no drive was found" not in result.stderr and "does not exist" in result.stderr
    assert "sim://vc660@3?name=empty: no drive was found, and no bus is written for it" in result.stderr
    wrong = init("sim://vc660@2", "/dev/ttyUSB0?baud=fast", *words, "-o", path, "--force", "--lang", "en")
    assert wrong.exit_code == 2 and "sim" not in wrong.stderr, "a wrong port URL is reported before the first scan"


def test_a_scan_without_a_reply_writes_nothing(tmp_path: Path) -> None:
    words = ["--scan", "--models", "vc660", "--addresses", "9", "--listen-seconds", "0", "-o", tmp_path / "plant.toml"]
    result = init("sim://vc660@1?drives=1200-8N1&baud=38400&format=8N1", *words)
    assert result.exit_code == 1 and "no bus is written" in result.output
    assert not (tmp_path / "plant.toml").exists()
    assert init("--scan", "-o", tmp_path / "plant.toml").exit_code == 2


def found(address: int, model: str, encoding: str = "ascii", family: str = "c320", baud: int = 9600) -> DetectedDrive:
    return DetectedDrive(
        models=(model, "sister"),
        setpoint_steps_hz={model: 0.01, "sister": 0.01},
        family=family,
        encoding=encoding,
        address=address,
        settings=SerialSettings(baud),
        exchange=(b"", b""),
    )


def test_a_drive_with_another_protocol_is_named_and_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    everybody = [found(2, "c320"), found(1, "c320"), found(2, "c320", "hex"), found(5, "vc660", "rtu", "modbus")]
    line = init_command._bus_answer("/dev/x", everybody, ("c320",), init_command.ModelQuestions(is_interrupted=True))
    assert [(drive.address, drive.encoding, drive.others) for drive in line.drives] == [
        (1, "ascii", ("sister",)),
        (2, "ascii", ("sister",)),
    ]
    text = capsys.readouterr().err
    assert text.count("address") == 1 and "address 5 (vc660/sister)" in text


titles = st.text(max_size=30)


@settings(max_examples=25)
@given(titles, st.lists(titles, min_size=1, max_size=4), st.sampled_from(["en", "zh"]))
def test_any_names_are_written_and_loaded_unchanged(title: str, names: list[str], language: str) -> None:
    """Quotes, backslashes, control characters and other scripts are escaped."""
    drives = tuple(DriveAnswer(address, "vc660", name) for address, name in enumerate(names, 1))
    raw = tomllib.loads(plant_toml(PlantAnswers(title, (BusAnswer("tcp://127.0.0.1:1", drives),)), language))
    assert raw["plant"]["title"] == title
    assert [drive.get("title", "") for drive in raw["drive"].values()] == names
    assert all(re.fullmatch(r"[a-z0-9][a-z0-9_-]{0,63}", id) for id in raw["drive"])


def test_a_missing_answers_file_is_reported(tmp_path: Path) -> None:
    assert init("--answers", tmp_path / "none.toml", "-o", tmp_path / "p.toml").exit_code == 2
    (tmp_path / "gbk.toml").write_bytes('title = "锅炉"'.encode("gbk"))
    assert init("--answers", tmp_path / "gbk.toml", "-o", tmp_path / "p.toml").exit_code == 2


def test_answers_are_read_in_order(answers: Path) -> None:
    first = read_answers(str(answers)).buses[0]
    assert [(drive.address, drive.title) for drive in first.drives] == [(1, "Supply fan"), (2, "Supply fan"), (7, "")]


def test_a_found_drive_gets_its_step_as_a_comment_because_a_scan_cannot_know_it() -> None:
    drive = DriveAnswer(1, "e300", others=("c320",))
    text = plant_toml(PlantAnswers("plant", (BusAnswer("/dev/ttyUSB0", (drive,)),)), "en")
    assert '# options = { setpoint_step = "0.1" }   # by the name plate or `drivebus calibrate`' in text
    assert "until it is stated or calibrated, 5 Hz is the most" in text
    stated = config.loads(text.replace("# options", "options", 1))
    assert stated.drives[0].options == {"setpoint_step": "0.1"}
