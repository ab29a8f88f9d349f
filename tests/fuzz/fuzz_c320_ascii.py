"""``python tests/fuzz/fuzz_c320_ascii.py -runs=100000`` (see harness.py)."""

from harness import main

if __name__ == "__main__":
    main("c320-ascii")
