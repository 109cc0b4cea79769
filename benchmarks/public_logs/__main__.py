"""`python benchmarks/public_logs --mirror DIR [--only NAME ...]`: see `public_logs.command`."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from public_logs.command import main

if __name__ == "__main__":
    sys.exit(main())
