"""``python -m drivebus.plant.audit FOLDER CHECKPOINTS KEY``: ``verify`` as JSON, in a process of its own.

The plant has it done so: reading a year of records must not take the interpreter from the buses.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from drivebus.plant.audit.files import Places
from drivebus.plant.audit.verify import verify
from drivebus.plant.precedence import CAN_WAIT, give_way

if __name__ == "__main__":
    give_way(CAN_WAIT)
    json.dump(verify(Places(*map(Path, sys.argv[1:]))).as_json(), sys.stdout)
