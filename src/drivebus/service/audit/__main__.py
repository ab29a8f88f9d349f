"""``python -m drivebus.service.audit FOLDER CHECKPOINTS KEY``: ``verify`` as JSON, in a process of its own.

The plant has it done so: reading a year of records must not take the interpreter from the buses.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from drivebus.service.audit.chain import AuditPaths
from drivebus.service.audit.verify import verify
from drivebus.service.process.tuning import NICE_BATCH, set_nice

if __name__ == "__main__":
    set_nice(NICE_BATCH)
    json.dump(verify(AuditPaths(*map(Path, sys.argv[1:]))).as_json(), sys.stdout)
