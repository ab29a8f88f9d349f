"""Lines of the keys of a TOML file."""

from __future__ import annotations

import pytest

from drivebus.profiles.toml_file import has_key, iter_keys, line_of

TEXT = '''format = 1  # [not.a.table]
text = """
[inside.a.string]
key = 1
"""
"quoted key" = { inner = 1, "other" = "x, fake = 2" }
dotted.name = 3
list = [
  "a = 1",  # b = 2
  { en = "x" },
]
after = 4

[table."F0.1"]
one = 1
[table.sub]
two = "[no.table]"
[[array]]
name = 1
[[array]]
name = 2
'''


@pytest.mark.parametrize(
    ("path", "line"),
    [
        (("format",), 1),
        (("text",), 2),
        (("quoted key", "inner"), 6),
        (("quoted key", "other"), 6),
        (("dotted", "name"), 7),
        (("list",), 8),
        (("after",), 12),
        (("table", "F0.1"), 14),
        (("table", "F0.1", "one"), 15),
        (("table", "sub", "two"), 17),
        (("array", 0, "name"), 19),
        (("array", 1, "name"), 21),
        (("table", "F0.1", "missing"), 14),
        (("list", 0), 8),
    ],
)
def test_a_key_is_found_on_its_line_or_its_parents(path: tuple[str | int, ...], line: int) -> None:
    assert line_of(TEXT, path) == line


def test_what_stands_in_strings_and_comments_is_no_key() -> None:
    found = {path for path, _ in iter_keys(TEXT)}
    assert not any("fake" in path or "inside" in path or "a" in path or "no" in path for path in found)


def test_a_key_that_is_nowhere_has_no_line() -> None:
    assert line_of(TEXT, ("nowhere", "at", "all")) is None
    assert not has_key(TEXT, ("table", "F0.1", "missing"))
    assert has_key(TEXT, ("table", "F0.1", "one"))
