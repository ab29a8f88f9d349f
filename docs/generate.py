"""Write the generated parts of the docs, as `make docs` does; `--check` only lists pages out of date (exit 1).

A page is written by hand except for the parts between `<!-- NAME:begin -->` and `<!-- NAME:end -->`, and for the links
from the ids of traps and invariants to their definitions. The pages in docs/reference/models are generated as a whole.
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT))  # the package `verification` is not installed

from generator import pages  # noqa: E402


def main(arguments: list[str]) -> int:
    stale = []
    for path, text in pages.generated_pages(ROOT):
        if path.is_file() and path.read_text(encoding="utf-8") == text:
            continue
        stale.append(path.relative_to(ROOT).as_posix())
        if "--check" not in arguments:
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
    verb = "out of date, run `make docs`" if "--check" in arguments else "written"
    for name in stale:
        print(f"{name}: {verb}")
    return 1 if stale and "--check" in arguments else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
