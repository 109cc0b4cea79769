"""The entry point of the command line: ``replant`` and ``python -m replant``."""

import sys
from typing import Any


def main() -> Any:
    """Run the command line; Ctrl-C may come while its libraries are still imported."""
    try:
        from replant.cli import main as run

        return run()
    except KeyboardInterrupt:
        print("replant: interrupted", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
