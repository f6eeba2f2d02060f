"""A companion process for tests: it does what its job file says."""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path

from pipeline.companion import end_with_stage, say


def main() -> None:
    end_with_stage()
    job = json.loads(Path(sys.argv[1]).read_text())
    print("about to begin", file=sys.stderr)
    say(process=os.getpid(), name=job["name"])
    time.sleep(job.get("seconds", 0))
    if "raises" in job:
        raise ValueError(job["raises"]) if job["raises"] else MemoryError
    if "status" in job:
        print("no more paper", file=sys.stderr)
        sys.exit(job["status"])
    say(name=job["name"], done=True)


if __name__ == "__main__":
    main()
