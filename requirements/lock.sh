#!/bin/sh
# Pins what pyproject.toml asks for: exact versions and hashes for every platform, no addresses. Needs uv.
set -eu
cd "$(dirname "$0")/.."
pin() { uv pip compile -q --upgrade --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-annotate --no-header "$@"; }
# The page and the full-screen view are part of `make demo`.
pin pyproject.toml --extra server --extra tui -o requirements/base.txt
pin pyproject.toml --extra server --extra tui --group test -o requirements/test.txt
printf 'hatchling\neditables\n' | pin - -o requirements/build.txt
