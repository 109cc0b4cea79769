"""Soak: 1,000 hours of rig time with random faults, then a day of the demo's rig through a whole session.

    python benchmarks/soak [--hours 1000] [--seed 0] [--samples 86400000]

Ends with exit code 1 and the reason if a model that is wrong is called trusted for longer than docs/live.md says, or
if anything drifts in the session.  ``--hours 0`` and ``--samples 0`` leave a part out.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from soak import day, rig_time


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=1000.0, help="of rig time with faults")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--samples", type=int, default=day.DAY, help="of the demo's rig through a session")
    asked = parser.parse_args()
    found = []
    if asked.hours > 0.0:
        found += faults(asked.hours, asked.seed)
    if asked.samples > 0:
        found += day.run(asked.samples)
    if found:
        sys.exit("; ".join(found))


def faults(hours: float, seed: int) -> list[str]:
    """Run rigs with faults, print the table, and return what is not as it should be."""
    begun = time.process_time()

    def report(watch: rig_time.Watch) -> None:
        gone = time.process_time() - begun
        print(
            f"rig {watch.number}: {watch.rig.order} poles, {watch.clock / 3600.0:.1f} h, "
            f"{len(watch.episodes)} faults, {watch.looks} looks; {gone:.0f} s of processor time so far",
            flush=True,
        )
        for line in rig_time.broken(watch.episodes):
            print(f"  {line}", flush=True)

    episodes = rig_time.run(hours, seed, report)
    print(rig_time.table(episodes))
    return rig_time.broken(episodes)


if __name__ == "__main__":
    main()
