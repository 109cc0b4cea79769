"""``python -m replant``."""

from replant.cli import main

if __name__ == "__main__":
    main()
