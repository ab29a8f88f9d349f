"""Captures: what is written is read again; what is wrong is rejected with file and line."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from drivebus.capture.dbcap import (
    BytesRecord,
    CaptureError,
    CaptureHeader,
    CaptureWriter,
    EventRecord,
    read_capture,
)
from drivebus.serial_settings import SerialSettings

HEAD = '{"dbcap": 1, "baud": 9600, "format": "8E1"}\n'


def written(path: Path) -> CaptureWriter:
    return CaptureWriter(
        path, CaptureHeader(SerialSettings(19200, 8, "E", 1), "usb:1", "2026-11-21T10:00:00Z", "test"), now=100.0
    )


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    writer = written(tmp_path / "a.dbcap")
    writer.write_event(100.0, "opened", baud=19200, format="8E1")
    writer.write_bytes(100.5, "tx", b"\x01\x03")
    writer.write_bytes(100.75, "rx", b"\xff\x00", 1)
    writer.write_event(101.0, "lost", reason="拔出")
    writer.close()
    writer.close()
    capture = read_capture(tmp_path / "a.dbcap")
    assert capture.header == CaptureHeader(SerialSettings(19200, 8, "E", 1), "usb:1", "2026-11-21T10:00:00Z", "test")
    assert capture.records == (
        EventRecord(0.0, "opened", {"baud": 19200, "format": "8E1"}, 2),
        BytesRecord(0.5, "tx", b"\x01\x03", 0, 3),
        BytesRecord(0.75, "rx", b"\xff\x00", 1, 4),
        EventRecord(1.0, "lost", {"reason": "拔出"}, 5),
    )
    assert not capture.truncated


def test_a_writer_that_is_killed_spoils_at_most_its_last_line(tmp_path: Path) -> None:
    path = tmp_path / "killed.dbcap"
    program = (
        "import sys; from drivebus.capture.dbcap import *; from drivebus.serial_settings import SerialSettings\n"
        "w = CaptureWriter(sys.argv[1], CaptureHeader(SerialSettings()), now=0.0)\n"
        "[w.write_bytes(i, 'rx', bytes([i])) for i in range(100)]\n"
        "print('ready', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"ready\n"
        os.kill(child.pid, signal.SIGKILL)
    capture = read_capture(path)
    assert [record.data for record in capture.records if isinstance(record, BytesRecord)] == [
        bytes([i]) for i in range(100)
    ]


@pytest.mark.parametrize("kept", range(1, 30))
def test_a_cut_last_line_is_left_out_and_reported(tmp_path: Path, kept: int) -> None:
    whole = '{"t":0.000000,"rx":"01"}\n'
    last = '{"t":0.100000,"rx":"0203","line_errors":1}\n'
    path = tmp_path / "cut.dbcap"
    path.write_text(HEAD + whole + last[:kept])
    capture = read_capture(path)
    assert (len(capture.records), capture.truncated) == (1, True)


def test_unknown_keys_and_events_of_a_later_writer_are_kept_and_not_rejected(tmp_path: Path) -> None:
    path = tmp_path / "later.dbcap"
    path.write_text(
        HEAD[:-2] + ', "site": "pump house"}\n{"t":1,"rx":"01","rssi":3}\n{"t":2,"event":"sunrise","lux":9}\n'
    )
    records = read_capture(path).records
    assert records == (BytesRecord(1, "rx", b"\x01", 0, 2), EventRecord(2, "sunrise", {"lux": 9}, 3))


@pytest.mark.parametrize(
    ("text", "key", "line"),
    [
        ("", "capture.empty", None),
        ("PK\x03\x04\n", "capture.line", 1),
        ("[]\n", "capture.line", 1),
        ("[" * 100_000 + "\n", "capture.line", 1),
        ('{"baud": 9600}\n', "capture.header", 1),
        ('{"dbcap": true, "baud": 9600, "format": "8E1"}\n', "capture.header", 1),
        ('{"dbcap": 2, "baud": 9600, "format": "8E1"}\n', "capture.version", 1),
        ('{"dbcap": 1, "baud": "9600", "format": "8E1"}\n', "capture.value", 1),
        ('{"dbcap": 1, "baud": 9600, "format": "9E1"}\n', "capture.value", 1),
        (HEAD + "noise\n", "capture.line", 2),
        (HEAD + '{"t":0,"rx":"0"}\n', "capture.value", 2),
        (HEAD + '{"t":0,"rx":"01 02"}\n', "capture.value", 2),
        (HEAD + '{"t":0,"rx":"AB"}\n', "capture.value", 2),
        (HEAD + '{"t":0,"rx":1}\n', "capture.value", 2),
        (HEAD + '{"t":0}\n', "capture.value", 2),
        (HEAD + '{"t":0,"rx":"01","tx":"02"}\n', "capture.value", 2),
        (HEAD + '{"rx":"01"}\n', "capture.value", 2),
        (HEAD + '{"t":NaN,"rx":"01"}\n', "capture.value", 2),
        (HEAD + '{"t":-1,"rx":"01"}\n', "capture.value", 2),
        (HEAD + '{"t":true,"rx":"01"}\n', "capture.value", 2),
        (HEAD + '{"t":0,"rx":"01","line_errors":-1}\n', "capture.value", 2),
        (HEAD + '{"t":1,"rx":"01"}\n{"t":0.5,"rx":"01"}\n', "capture.value", 3),
    ],
)
def test_a_wrong_capture_is_rejected_with_file_and_line(tmp_path: Path, text: str, key: str, line: int | None) -> None:
    path = tmp_path / "wrong.dbcap"
    path.write_text(text)
    with pytest.raises(CaptureError) as caught:
        read_capture(path)
    assert (caught.value.key, caught.value.params.get("line")) == (key, line)
    assert caught.value.params["file"] == str(path)
    for language in ("en", "zh"):
        assert str(path) in caught.value.text(language)
        assert not {"{file}", "{line}", "{found}"} & set(caught.value.text(language).split())


@pytest.mark.parametrize(
    ("text", "english", "chinese"),
    [
        ('{"dbcap": 1, "baud": "1", "format": 2}\n', "baud, format is 1, 2;", "baud、format 为 1、2；"),
        (HEAD + '{"t":0,"rx":"01","tx":"02"}\n', "rx, tx, event is rx, tx;", "rx、tx、event 为 rx、tx；"),
    ],
)
def test_keys_and_values_are_listed_with_the_mark_of_the_language(
    tmp_path: Path, text: str, english: str, chinese: str
) -> None:
    path = tmp_path / "wrong.dbcap"
    path.write_text(text)
    with pytest.raises(CaptureError) as caught:
        read_capture(path)
    assert english in caught.value.text("en") and chinese in caught.value.text("zh")


def test_a_capture_never_overwrites_another(tmp_path: Path) -> None:
    written(tmp_path / "a.dbcap").close()
    with pytest.raises(CaptureError) as caught:
        written(tmp_path / "a.dbcap")
    assert caught.value.key == "capture.exists"


def test_a_missing_capture_is_named(tmp_path: Path) -> None:
    with pytest.raises(CaptureError) as caught:
        read_capture(tmp_path / "none.dbcap")
    assert caught.value.key == "capture.open"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_ends_the_capture_and_does_not_disturb_the_bus(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = written(tmp_path / "a.dbcap")
    full = os.open("/dev/full", os.O_WRONLY)
    os.dup2(full, writer._fd)
    os.close(full)
    writer.write_bytes(101.0, "rx", b"x")
    writer.write_bytes(102.0, "rx", b"y")
    assert isinstance(writer.error, OSError)
    writer.close()


def test_a_rejected_value_is_named_with_its_line_and_what_is_expected(tmp_path: Path) -> None:
    path = tmp_path / "x.dbcap"
    path.write_text(HEAD + json.dumps({"t": 0, "rx": "zz"}) + "\n")
    with pytest.raises(CaptureError) as caught:
        read_capture(path)
    assert str(caught.value) == f"{path}, line 2: rx is zz; expected 00…ff"


@pytest.mark.parametrize("page", ["capture-format.md", "capture-format.zh.md"])
def test_the_example_of_the_page_is_a_capture(tmp_path: Path, page: str) -> None:
    text = (Path(__file__).parents[2] / "docs" / "reference" / page).read_text(encoding="utf-8")
    path = tmp_path / "example.dbcap"
    path.write_text(text.split("```")[1].lstrip("\n"), encoding="utf-8")
    capture = read_capture(path)
    assert (len(capture.records), capture.truncated, capture.header.writer) == (5, False, "drivebus 0.1.0")


def test_a_disk_that_fails_at_the_end_is_reported_and_raises_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A network disk may say only at close that nothing was kept."""
    writer = written(tmp_path / "a.dbcap")
    plain = os.close

    def full(fd: int) -> None:
        plain(fd)
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as context:
        context.setattr(os, "close", full)
        writer.close()
        writer.close()
    assert writer.error is not None and writer.error.errno == 28
