"""``python tests/fuzz/fuzz_modbus_ascii_junk.py -runs=100000`` (see harness.py)."""

from harness import main

if __name__ == "__main__":
    main("modbus-ascii-junk")
