"""Records and checkpoints: a line with any changed byte is rejected; verification locates every change of a trail."""

from __future__ import annotations

import json
from collections.abc import ItemsView
from pathlib import Path

import pytest

from drivebus.service.audit import AuditTrail, records
from fixtures.audit import problem_kinds, verify_report, written_trail

LINE, HASH = records.encode_record(7, "f" * 64, 2, {"time_ms": 5, "what": "drive.run", "target": "风机\n"})
KEY = b"k" * 64
CHECKPOINT, MAC = records.encode_checkpoint(3, (7, HASH), records.GENESIS_HASH, 9, KEY)


def test_a_line_is_decoded_as_encoded() -> None:
    found = records.decode_record(LINE[:-1])
    assert found is not None
    assert (found.n, found.prev, found.hash, found.checkpoints) == (7, "f" * 64, HASH, 2)
    assert found.body == {"time_ms": 5, "what": "drive.run", "target": "风机\n"}
    checkpoint = records.decode_checkpoint(CHECKPOINT[:-1], KEY)
    assert (
        checkpoint
        == records.AuditCheckpoint(number=3, n=7, hash=HASH, prev=records.GENESIS_HASH, mac=MAC, time_ms=9)
        == records.decode_checkpoint(CHECKPOINT[:-1], None)
    )


@pytest.mark.parametrize("frames", [0, 3, 10, 11, 200, 1_800])
def test_the_size_of_a_record_is_that_of_its_line_and_encodes_few_of_its_frames(frames: int) -> None:
    """Encoding the 1,800 frames of a stop of 300 drives delayed the buses by 8 ms."""
    read: list[int] = []

    class Frame(dict[str, object]):
        def items(self) -> ItemsView[str, object]:
            read.append(1)
            return super().items()

    sent = [Frame(at=123.4567, sent="01 03 20 00 00 01 8F CA", received="01 03 02 00 01 79 84") for _ in range(frames)]
    entry = records.AuditEntry(what="plant.stop", who="ann", frames=sent, outcome="confirmed")
    octets = records.record_octets(entry)
    assert len(read) <= 20
    line, _ = records.encode_record(7, "f" * 64, 2, records.entry_json(entry, 1_700_000_000_000))
    assert octets == pytest.approx(min(len(line), records.MAX_RECORD_LINE_BYTES), rel=0.1, abs=100)


def test_a_changed_missing_or_doubled_byte_is_rejected() -> None:
    for line, opened in (
        (LINE, records.decode_record),
        (CHECKPOINT, lambda data: records.decode_checkpoint(data, KEY)),
    ):
        good = line[:-1]
        for at in range(len(good)):
            changed = [bytes([good[at] ^ bit]) for bit in (1, 2, 4, 8, 16, 32, 64, 128)]
            for other in [*changed, b"", good[at : at + 1] * 2]:
                assert opened(good[:at] + other + good[at + 1 :]) is None, (at, other)
        assert opened(good + b" ") is None and opened(b" " + good) is None and opened(b"") is None


def test_a_checkpoint_under_another_key_is_rejected() -> None:
    assert records.decode_checkpoint(CHECKPOINT[:-1], b"x" * 64) is None
    assert records.decode_checkpoint(LINE[:-1], None) is None


def test_a_line_with_a_valid_hash_but_no_record_is_rejected() -> None:
    for body in (
        '{"n":1}',
        "[]",
        '{"n":"1","time_ms":1,"checkpoints":0,"prev":""}',
        '{"n":true,"prev":"","checkpoints":0}',
    ):
        data = body.encode()
        assert records.decode_record(data[:-1] + f',"hash":"{records._sha(data)}"}}'.encode()) is None


# --- verify ----------------------------------------------------------------------------------------------------------


def write_records(trail: AuditTrail, lines: list[bytes]) -> None:
    trail.paths.current.write_bytes(b"".join(lines))


def write_checkpoints(trail: AuditTrail, lines: list[bytes]) -> None:
    trail.paths.checkpoints.write_bytes(b"".join(lines))


@pytest.fixture
def trail(tmp_path: Path) -> AuditTrail:
    """Trail of ten records in one file, with checkpoints after the first, fourth, eighth and tenth."""
    return written_trail(tmp_path)


@pytest.fixture
def lines(trail: AuditTrail) -> list[bytes]:
    return trail.paths.current.read_bytes().splitlines(keepends=True)


@pytest.fixture
def checkpoints(trail: AuditTrail) -> list[bytes]:
    found = trail.paths.checkpoints.read_bytes().splitlines(keepends=True)
    assert [json.loads(line)["n"] for line in found] == [1, 4, 8, 10]
    return found


def problem_lines(trail: AuditTrail) -> list[tuple[str, int]]:
    return [(problem.kind, problem.line) for problem in verify_report(trail).problems]


def test_a_deletion_is_reported_at_the_line_that_moved_up(trail: AuditTrail, lines: list[bytes]) -> None:
    write_records(trail, lines[:5] + lines[6:])
    assert problem_lines(trail) == [("broken", 6)]


def test_a_swap_is_reported_at_every_line_that_does_not_follow(trail: AuditTrail, lines: list[bytes]) -> None:
    write_records(trail, [*lines[:2], lines[3], lines[2], *lines[4:]])
    assert problem_lines(trail) == [("broken", 3), ("broken", 4), ("broken", 5)]


def test_an_insertion_is_detected(trail: AuditTrail, lines: list[bytes]) -> None:
    write_records(trail, [*lines[:3], lines[2], *lines[3:]])
    assert problem_lines(trail) == [("broken", 4)]
    write_records(trail, [*lines[:3], b"\n", *lines[3:]])
    assert problem_lines(trail) == [("changed", 4), ("broken", 5)]


def test_a_replaced_record_with_a_right_hash_is_detected_by_the_next(trail: AuditTrail, lines: list[bytes]) -> None:
    old = json.loads(lines[5])
    line, _ = records.encode_record(6, old["prev"], old["checkpoints"], {"time_ms": 1, "what": "x", "target": ""})
    write_records(trail, [*lines[:5], line, *lines[6:]])
    assert problem_lines(trail) == [("broken", 7)]


def test_a_rewritten_chain_is_detected_by_its_checkpoint(trail: AuditTrail, lines: list[bytes]) -> None:
    hash, again = json.loads(lines[4])["hash"], []
    for n in range(6, 11):
        line, hash = records.encode_record(n, hash, 2, {"time_ms": n, "what": "x", "target": ""})
        again.append(line)
    write_records(trail, [*lines[:5], *again])
    assert problem_lines(trail) == [("rewritten", 8), ("rewritten", 10)]


def test_a_cut_is_detected_back_to_the_last_checkpoint(
    trail: AuditTrail, lines: list[bytes], checkpoints: list[bytes]
) -> None:
    write_records(trail, lines[:9])
    assert problem_lines(trail) == [("cut", 0)]
    write_records(trail, lines[:9] + [lines[9][:-1]])
    assert problem_lines(trail) == [("unfinished", 10), ("cut", 0)]
    trail.paths.current.unlink()
    assert problem_lines(trail) == [("absent", 0), ("cut", 0)]
    write_records(trail, lines[:9])
    write_checkpoints(trail, checkpoints[:3])
    trail.paths.head.write_bytes(checkpoints[2])
    assert verify_report(trail).ok and verify_report(trail).covered == 8, (
        "records after the last checkpoint can be cut off undetected"
    )


def test_a_missing_moved_or_doubled_checkpoint_is_detected(trail: AuditTrail, checkpoints: list[bytes]) -> None:
    write_checkpoints(trail, checkpoints[1:])
    assert problem_lines(trail) == [("checkpoint_broken", 1), ("checkpoints_missing", 0)]
    write_checkpoints(trail, [checkpoints[0], checkpoints[0], *checkpoints[1:]])
    assert problem_lines(trail) == [("checkpoint_broken", 2)]
    write_checkpoints(trail, checkpoints[:2])
    assert problem_lines(trail) == [("checkpoints_missing", 0)]
    trail.paths.checkpoints.unlink()
    assert problem_lines(trail) == [("checkpoints_missing", 0)]


def test_a_changed_or_unfinished_checkpoint_is_detected(trail: AuditTrail, checkpoints: list[bytes]) -> None:
    write_checkpoints(trail, [*checkpoints[:2], checkpoints[2].replace(b'"n":8', b'"n":7'), checkpoints[3]])
    assert problem_lines(trail) == [("checkpoint_changed", 3), ("checkpoint_broken", 4), ("checkpoints_missing", 0)]
    write_checkpoints(trail, [*checkpoints[:3], checkpoints[3][:-1]])
    assert problem_lines(trail) == [("checkpoint_changed", 4), ("checkpoints_missing", 0)]


def test_checkpoints_made_without_the_key_are_detected(trail: AuditTrail, lines: list[bytes]) -> None:
    line, _ = records.encode_checkpoint(1, (10, json.loads(lines[9])["hash"]), records.GENESIS_HASH, 1, b"x" * 64)
    write_checkpoints(trail, [line])
    assert set(problem_kinds(trail)) == {"checkpoint_changed", "checkpoints_missing"}


@pytest.mark.parametrize(("number", "n"), [(2, 4), (2, 3), (3, 8)])
def test_checkpoints_must_increase_in_number_and_record(
    trail: AuditTrail, lines: list[bytes], number: int, n: int
) -> None:
    """Made under the right key by a defective writer."""
    key, hashes = trail.paths.read_key(), [json.loads(line)["hash"] for line in lines]
    first, mac = records.encode_checkpoint(1, (4, hashes[3]), records.GENESIS_HASH, 1, key)
    second, _ = records.encode_checkpoint(number, (n, hashes[n - 1]), mac, 1, key)
    write_checkpoints(trail, [first, second])
    assert problem_lines(trail)[0] == ("checkpoint_broken", 2)


def test_a_lost_or_renamed_file_is_detected(tmp_path: Path) -> None:
    trail = written_trail(tmp_path, 40, max_file_bytes=2_000)
    first, second = trail.paths.files()[:2]
    second.rename(trail.paths.folder / "audit-000000000099.jsonl")
    assert {"name", "broken"} <= set(problem_kinds(trail))
    (trail.paths.folder / "audit-000000000099.jsonl").rename(second)
    first.rename(trail.paths.folder / "audit-000000000002.jsonl")
    assert problem_kinds(trail) == ["name"]


def test_all_problems_are_counted_and_some_are_listed(trail: AuditTrail, lines: list[bytes]) -> None:
    write_records(trail, [*lines, *[b"x\n"] * 1000])
    found = verify_report(trail)
    assert (found.problem_count, len(found.problems)) == (1000, 200)
