"""Every changed octet of a sealed line and every small change of a trail is found, with its place."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from drivebus.service.audit import AuditTrail, records
from fixtures.audit import problem_kinds, verify_report, written_trail

LINE, HASH = records.encode_record(7, "f" * 64, 2, {"time_ms": 5, "what": "drive.run", "target": "风机\n"})
KEY = b"k" * 64
MARK, MAC = records.encode_checkpoint(3, (7, HASH), records.GENESIS_HASH, 9, KEY)


def test_a_line_comes_back_as_it_was_written() -> None:
    found = records.decode_record(LINE[:-1])
    assert found is not None
    assert (found.n, found.prev, found.hash, found.checkpoints) == (7, "f" * 64, HASH, 2)
    assert found.body == {"time_ms": 5, "what": "drive.run", "target": "风机\n"}
    mark = records.decode_checkpoint(MARK[:-1], KEY)
    assert (
        mark
        == records.AuditCheckpoint(3, 7, HASH, records.GENESIS_HASH, MAC, 9)
        == records.decode_checkpoint(MARK[:-1], None)
    )


def test_no_octet_can_be_another_one_or_missing_or_doubled() -> None:
    for line, opened in ((LINE, records.decode_record), (MARK, lambda data: records.decode_checkpoint(data, KEY))):
        good = line[:-1]
        for at in range(len(good)):
            changed = [bytes([good[at] ^ bit]) for bit in (1, 2, 4, 8, 16, 32, 64, 128)]
            for other in [*changed, b"", good[at : at + 1] * 2]:
                assert opened(good[:at] + other + good[at + 1 :]) is None, (at, other)
        assert opened(good + b" ") is None and opened(b" " + good) is None and opened(b"") is None


def test_a_checkpoint_under_another_key_is_none() -> None:
    assert records.decode_checkpoint(MARK[:-1], b"x" * 64) is None
    assert records.decode_checkpoint(LINE[:-1], None) is None


def test_what_is_sealed_but_no_record_is_none() -> None:
    for body in (
        '{"n":1}',
        "[]",
        '{"n":"1","time_ms":1,"checkpoints":0,"prev":""}',
        '{"n":true,"prev":"","checkpoints":0}',
    ):
        data = body.encode()
        assert records.decode_record(data[:-1] + f',"hash":"{records._sha(data)}"}}'.encode()) is None


# --- verify ----------------------------------------------------------------------------------------------------------


def lay(made: AuditTrail, lines: list[bytes]) -> None:
    made.paths.current.write_bytes(b"".join(lines))


def lay_marks(made: AuditTrail, lines: list[bytes]) -> None:
    made.paths.checkpoints.write_bytes(b"".join(lines))


@pytest.fixture
def made(tmp_path: Path) -> AuditTrail:
    """Ten records in one file, checkpoints after the first, the fourth, the eighth, the tenth."""
    return written_trail(tmp_path)


@pytest.fixture
def lines(made: AuditTrail) -> list[bytes]:
    return made.paths.current.read_bytes().splitlines(keepends=True)


@pytest.fixture
def marks(made: AuditTrail) -> list[bytes]:
    found = made.paths.checkpoints.read_bytes().splitlines(keepends=True)
    assert [json.loads(line)["n"] for line in found] == [1, 4, 8, 10]
    return found


def where(made: AuditTrail) -> list[tuple[str, int]]:
    return [(problem.kind, problem.line) for problem in verify_report(made).problems]


def test_a_deletion_is_reported_at_the_line_that_moved_up(made: AuditTrail, lines: list[bytes]) -> None:
    lay(made, lines[:5] + lines[6:])
    assert where(made) == [("broken", 6)]


def test_a_swap_is_reported_at_every_line_that_does_not_follow(made: AuditTrail, lines: list[bytes]) -> None:
    lay(made, [*lines[:2], lines[3], lines[2], *lines[4:]])
    assert where(made) == [("broken", 3), ("broken", 4), ("broken", 5)]


def test_an_insertion_is_detected(made: AuditTrail, lines: list[bytes]) -> None:
    lay(made, [*lines[:3], lines[2], *lines[3:]])
    assert where(made) == [("broken", 4)]
    lay(made, [*lines[:3], b"\n", *lines[3:]])
    assert where(made) == [("changed", 4), ("broken", 5)]


def test_a_replaced_record_with_a_right_hash_is_detected_by_the_next(made: AuditTrail, lines: list[bytes]) -> None:
    old = json.loads(lines[5])
    line, _ = records.encode_record(6, old["prev"], old["checkpoints"], {"time_ms": 1, "what": "x", "target": ""})
    lay(made, [*lines[:5], line, *lines[6:]])
    assert where(made) == [("broken", 7)]


def test_a_rewritten_chain_is_detected_by_its_checkpoint(made: AuditTrail, lines: list[bytes]) -> None:
    hash, again = json.loads(lines[4])["hash"], []
    for n in range(6, 11):
        line, hash = records.encode_record(n, hash, 2, {"time_ms": n, "what": "x", "target": ""})
        again.append(line)
    lay(made, [*lines[:5], *again])
    assert where(made) == [("rewritten", 8), ("rewritten", 10)]


def test_a_cut_is_detected_back_to_the_last_checkpoint(
    made: AuditTrail, lines: list[bytes], marks: list[bytes]
) -> None:
    lay(made, lines[:9])
    assert where(made) == [("cut", 0)]
    lay(made, lines[:9] + [lines[9][:-1]])
    assert where(made) == [("unfinished", 10), ("cut", 0)]
    made.paths.current.unlink()
    assert where(made) == [("cut", 0)]
    lay(made, lines[:9])
    lay_marks(made, marks[:3])
    assert verify_report(made).ok and verify_report(made).covered == 8, (
        "what no checkpoint vouches for can be cut off unseen"
    )


def test_a_missing_moved_or_doubled_checkpoint_is_detected(made: AuditTrail, marks: list[bytes]) -> None:
    lay_marks(made, marks[1:])
    assert where(made) == [("checkpoint_broken", 1)]
    lay_marks(made, [marks[0], marks[0], *marks[1:]])
    assert where(made) == [("checkpoint_broken", 2)]
    lay_marks(made, marks[:2])
    assert where(made) == [("checkpoints_missing", 0)]
    made.paths.checkpoints.unlink()
    assert where(made) == [("checkpoints_missing", 0)]


def test_a_changed_or_unfinished_checkpoint_is_detected(made: AuditTrail, marks: list[bytes]) -> None:
    lay_marks(made, [*marks[:2], marks[2].replace(b'"n":8', b'"n":7'), marks[3]])
    assert where(made) == [("checkpoint_changed", 3), ("checkpoint_broken", 4)]
    lay_marks(made, [*marks[:3], marks[3][:-1]])
    assert where(made) == [("checkpoint_changed", 4)]


def test_checkpoints_made_without_the_key_are_detected(made: AuditTrail, lines: list[bytes]) -> None:
    line, _ = records.encode_checkpoint(1, (10, json.loads(lines[9])["hash"]), records.GENESIS_HASH, 1, b"x" * 64)
    lay_marks(made, [line])
    assert set(problem_kinds(made)) == {"checkpoint_changed", "checkpoints_missing"}


@pytest.mark.parametrize(("number", "n"), [(2, 4), (2, 3), (3, 8)])
def test_checkpoints_go_on_in_number_and_in_record(made: AuditTrail, lines: list[bytes], number: int, n: int) -> None:
    """Made under the right key, by a writer that was led astray."""
    key, hashes = made.paths.read_key(), [json.loads(line)["hash"] for line in lines]
    first, mac = records.encode_checkpoint(1, (4, hashes[3]), records.GENESIS_HASH, 1, key)
    second, _ = records.encode_checkpoint(number, (n, hashes[n - 1]), mac, 1, key)
    lay_marks(made, [first, second])
    assert where(made)[0] == ("checkpoint_broken", 2)


def test_a_lost_or_renamed_file_is_detected(tmp_path: Path) -> None:
    made = written_trail(tmp_path, 40, max_file_bytes=2_000)
    first, second = made.paths.files()[:2]
    second.rename(made.paths.folder / "audit-000000000099.jsonl")
    assert {"name", "broken"} <= set(problem_kinds(made))
    (made.paths.folder / "audit-000000000099.jsonl").rename(second)
    first.rename(made.paths.folder / "audit-000000000002.jsonl")
    assert problem_kinds(made) == ["name"]


def test_many_problems_are_all_counted_and_some_listed(made: AuditTrail, lines: list[bytes]) -> None:
    lay(made, [*lines, *[b"x\n"] * 1000])
    found = verify_report(made)
    assert (found.problem_count, len(found.problems)) == (1000, 200)
