"""`python benchmarks/accuracy [--scenario A B ..] [--runs N]`: see `accuracy.command`."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # worker processes inherit it

from accuracy.command import main

if __name__ == "__main__":
    sys.exit(main())
