"""Entry point of ``python -m drivebus.service.audit FOLDER CHECKPOINTS KEY HEAD``: print the report as JSON.

The service runs it as a child process, because reading a year of records would hold the interpreter of the buses.
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
