"""`python benchmarks/campaign [--seed 1] [--family random|field] [--only NUMBER ...]`: see `campaign.command`."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # worker processes inherit it

from campaign.command import main

if __name__ == "__main__":
    sys.exit(main())
