"""``python tests/fuzz/fuzz_dzb100.py -runs=100000`` (see harness.py)."""

from harness import main

if __name__ == "__main__":
    main("dzb100")
