"""How long replant takes to start, as ratios to `python -c "import numpy"`: import, first use, help.

Each command runs in a fresh interpreter, all in turn; times are processor times of that process, so that other programs
on the machine hardly count.  Exit code 1 says that a ratio exceeds its limit.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from typing import Any

import numpy as np

YARDSTICK = ["-c", "import numpy"]
#: What is started, and the largest ratio to NumPy's import that is well.
CASES: dict[str, tuple[list[str], float]] = {
    "`import replant`": (["-c", "import replant"], 0.5),
    "`from replant import Identifier`": (["-c", "from replant import Identifier"], 3.0),
    "`replant --help`": (["-m", "replant", "--help"], 1.0),
    "`replant run --help`": (["-m", "replant", "run", "--help"], 3.0),
}
REPETITIONS = 15


def measure(repetitions: int = REPETITIONS) -> dict[str, Any]:
    """Return the figures: ``numpy`` in ms; ``rows``, one for each case, in ms and as ratios."""
    commands = [YARDSTICK, *(arguments for arguments, _ in CASES.values())]
    with tempfile.TemporaryDirectory() as folder:
        # byte code lies ready, as in an installed package, whatever Python was told of it here
        environment = {**os.environ, "PYTHONPYCACHEPREFIX": folder, "PYTHONDONTWRITEBYTECODE": ""}
        for arguments in commands:
            processor_time(arguments, environment)
        rounds = [[processor_time(arguments, environment) for arguments in commands] for _ in range(repetitions)]
    times = np.array(rounds) * 1e3
    ratios = times[:, 1:] / times[:, :1]
    low, middle, high = np.percentile(ratios, [25, 50, 75], axis=0)
    rows = [
        {
            "case": case, "milliseconds": float(np.median(times[:, k + 1])), "ratio": float(middle[k]),
            "ratio_quartiles": (float(low[k]), float(high[k])), "limit": limit,
        }
        for k, (case, (_, limit)) in enumerate(CASES.items())
    ]  # fmt: skip
    holds = all(row["ratio"] <= row["limit"] for row in rows)
    return {"numpy": float(np.median(times[:, 0])), "rows": rows, "holds": holds}


def processor_time(arguments: list[str], environment: dict[str, str]) -> float:
    """Return the processor time in s of a fresh interpreter with these arguments."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    figures = measure()
    for row in figures["rows"]:
        print(row)
    sys.exit(int(not figures["holds"]))
