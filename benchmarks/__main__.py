"""All benchmarks in one run: prints what was found, writes out/bench/bench.json and the page docs/performance.md.

    python benchmarks [SECTION ...]

Without a section all are run, and the page is written.  Exit code 1 says that a figure is not what it should be.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import time
from pathlib import Path

from rich.console import Console

from drawing import draw_scaling
from kernels import FLAGS, describe_machine
from page import SECTIONS, as_csv, page, section, tables

ROOT = Path(__file__).parents[1]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", metavar="SECTION", help=f"of {', '.join(SECTIONS)}; default: all")
    chosen = parser.parse_args().sections or list(SECTIONS)
    unknown = [name for name in chosen if name not in SECTIONS]
    if unknown:
        parser.error(f"no such section: {', '.join(unknown)}; there are {', '.join(SECTIONS)}")
    console = Console(stderr=True)
    figures = {"machine": describe_machine(FLAGS)}
    for name in chosen:
        begun = time.perf_counter()
        figures[name] = importlib.import_module(name).measure()
        console.print(f"{name}: {time.perf_counter() - begun:.0f} s")
        print(section(name, figures[name]), flush=True)
    folder = ROOT / "out" / "bench"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "bench.json").write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    if chosen == list(SECTIONS):
        (ROOT / "docs" / "performance.md").write_text(page(figures), encoding="utf-8")
        for name, rows in tables(figures).items():
            (ROOT / "docs" / "performance" / f"{name}.csv").write_text(as_csv(rows), encoding="utf-8")
        draw_scaling(figures["scaling"]["rows"], ROOT / "docs" / "pictures" / "scaling.svg")
        console.print("wrote docs/performance.md, its tables, its picture and out/bench/bench.json")
    missed = [name for name in chosen if not figures[name].get("holds", True)]
    if missed:
        console.print(f"not as fast as it should be: {', '.join(missed)}")
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
