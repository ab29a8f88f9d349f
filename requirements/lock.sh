#!/bin/sh
# Pins what pyproject.toml asks for: exact versions and hashes for every platform, no addresses. Needs uv.
set -eu
cd "$(dirname "$0")/.."
pin() { uv pip compile -q --upgrade --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-annotate --no-header "$@"; }
# The dashboard is part of what a newcomer runs first (make demo).
pin pyproject.toml --extra server -o requirements/base.txt
pin pyproject.toml --extra server --group test -o requirements/test.txt
printf 'hatchling\neditables\n' | pin - -o requirements/build.txt
