"""`python benchmarks/steps [--seed 1] [--runs 10]`: see `steps.command`."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # worker processes inherit it

from steps.command import main

if __name__ == "__main__":
    sys.exit(main())
