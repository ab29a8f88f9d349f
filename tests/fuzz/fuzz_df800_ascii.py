"""``python tests/fuzz/fuzz_df800_ascii.py -runs=100000`` (see harness.py)."""

from harness import main

if __name__ == "__main__":
    main("df800-ascii")
