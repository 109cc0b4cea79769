"""Opening a log takes time in proportion to its columns: 100,000 beside 10,000 of them, in the same run.

    python benchmarks/wide_logs.py

Ends with exit code 1 where ten times the columns take more than forty times the processor's time; where the cost is
quadratic it is a hundred times.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from replant.logs import read_columns

FEW, MANY, LIMIT = 10_000, 100_000, 40.0
HEADERS = {"numbers": "{}", "quoted": '"{}"', "names": "c{}", "none": ""}
REPETITIONS = 3


def cost(path: Path, header: str, columns: int) -> float:
    """Return the least processor time in s of opening a log with so many columns."""
    names = "t," + ",".join(header.format(k) for k in range(1, columns)) + "\n" if header else ""
    path.write_text(names + (",".join(["1.5"] * columns) + "\n") * 3)
    spent = []
    for _ in range(REPETITIONS):
        begun = time.process_time()
        assert len(read_columns(path).names) == columns
        spent.append(time.process_time() - begun)
    return min(spent)


def main() -> int:
    """Print a ratio for each kind of header."""
    worst = 0.0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "wide.csv"
        for name, header in HEADERS.items():
            ratio = cost(path, header, MANY) / cost(path, header, FEW)
            print(f"header of {name}: {MANY:,} columns take {ratio:.1f} times as long to open as {FEW:,}")
            worst = max(worst, ratio)
    return int(worst > LIMIT)


if __name__ == "__main__":
    sys.exit(main())
