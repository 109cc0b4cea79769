"""`python benchmarks/rows [--seed 1] [--family known|feedback|random]`: see `rows.command`."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # worker processes inherit it

from rows.command import main

if __name__ == "__main__":
    sys.exit(main())
