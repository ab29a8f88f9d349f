"""``python -m drivebus.plant.audit FOLDER CHECKPOINTS KEY``: ``verify`` as JSON, in a process of its own.

The plant has it done so: reading a year of records must not take the interpreter from the buses.
"""

from __future__ import annotations

import json
import os
import sys
from contextlib import suppress
from pathlib import Path

from drivebus.plant.audit.files import Places
from drivebus.plant.audit.verify import verify

if __name__ == "__main__":
    with suppress(AttributeError, OSError):
        os.nice(10)
    json.dump(verify(Places(*map(Path, sys.argv[1:]))).as_json(), sys.stdout)
