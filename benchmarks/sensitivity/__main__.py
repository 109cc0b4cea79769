"""Halve and double each tuned constant, and say what changes on a battery of records: `make sensitivity`.

Every value has a process of its own, forked from one that has not imported the package; what came of each is added to
out/sensitivity.jsonl, so that a run that was interrupted goes on; `--write` puts that into the strings below the
constants.  Processor time: nine seconds a value, over an hour for all.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import math
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "src" / "replant"
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "benchmarks")]

import scipy.linalg  # noqa: E402  what takes long to import, once for all processes
import scipy.signal  # noqa: E402, F401
from constants_page import measurable  # noqa: E402

from sensitivity.adjustable import make_copy  # noqa: E402
from sensitivity.comparison import scaled, words, write  # noqa: E402

LONGEST = 60
"""Processor time that one value may take; usual are nine seconds [s]."""


def measured(changed: Mapping[str, Any]) -> dict[str, Any]:
    """Run the battery in a process of its own with these values."""
    read, write = os.pipe()
    child = os.fork()
    if child:
        os.close(write)
        with os.fdopen(read, "rb") as pipe:
            content = pipe.read()
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        late = code in (-signal.SIGXCPU, -signal.SIGKILL)
        return json.loads(content) if content else {"failed": "it takes over a minute" if late else "it crashes"}
    os.environ["ADJUSTED_CONSTANTS"] = json.dumps(changed)
    if any(name.startswith("kernels.") for name in changed):
        _compile(Path(sys.path[0]).parent)
    if changed:  # else kernels may have to be compiled
        resource.setrlimit(resource.RLIMIT_CPU, (LONGEST, LONGEST))
    try:
        import warnings

        warnings.simplefilter("ignore")
        from sensitivity.battery import CASES, outcome

        result: dict[str, Any] = {}
        for name, case in CASES.items():
            try:
                result[name] = dataclasses.asdict(outcome(case()))
            except Exception as error:  # a value that cannot be is told as such
                result[name] = {"failed": f"{type(error).__name__}: {error}"}
    except BaseException:
        result = {"failed": traceback.format_exc()[-300:]}
    with os.fdopen(write, "wb") as pipe:
        pipe.write(json.dumps(result).encode())
    os._exit(0)


def _compile(folder: Path) -> None:
    """Have the copy's kernels compiled with the values of this process, which loads them."""
    from replant.kernels import native

    made = Path(tempfile.mkdtemp()) / native.LIBRARY.name
    subprocess.run([sys.executable, "-m", "translator.library", "--out", str(made)], cwd=folder / "tools", check=True)
    native.LIBRARY = made


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", help="names, as assessment.verdict.ALPHA")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "sensitivity.jsonl")
    parser.add_argument("--write", action="store_true", help="only write what was measured into the source")
    parser.add_argument("--seconds", type=float, default=math.inf, help="processor time to spend")
    arguments = parser.parse_args()
    if arguments.write:
        write([json.loads(line) for line in arguments.out.read_text(encoding="utf-8").splitlines()], SOURCE)
        return
    usual = measurable()
    chosen = arguments.only or list(usual)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    done = set()
    if arguments.out.exists():
        done = {(row["name"], row["factor"]) for row in map(json.loads, arguments.out.read_text().splitlines())}
    folder = _copy(usual)
    sys.path.insert(0, str(folder / "src"))
    before = measured({})
    if "failed" in before:
        raise SystemExit(before["failed"])
    begun = os.times()
    for name in chosen:
        for factor in (0.5, 2.0):
            spent = os.times()
            if sum(spent[:4]) - sum(begun[:4]) > arguments.seconds:
                return
            value = scaled(usual[name], factor)
            if (name, factor) in done or value == usual[name]:
                continue
            at = time.perf_counter()
            after = measured({name: value})
            row = {
                "name": name,
                "usual": usual[name],
                "factor": factor,
                "value": value,
                "words": words(before, after),
            }
            with arguments.out.open("a") as file:
                file.write(json.dumps(row | {"outcomes": after}) + "\n")
            print(f"{name} = {value} ({time.perf_counter() - at:.0f} s): {row['words']}", flush=True)


def _copy(usual: Mapping[str, Any]) -> Path:
    """Return the folder of a copy of this source, made where there is none yet: it keeps the compiled kernels."""
    files = [*sorted((SOURCE).rglob("*.py")), Path(__file__).with_name("adjustable.py")]
    digest = hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]
    folder = Path(tempfile.gettempdir()) / f"replant-adjustable-{os.getuid()}-{digest}"
    if not folder.exists():
        with tempfile.TemporaryDirectory(dir=folder.parent) as made:
            make_copy(SOURCE, Path(made), usual)
            Path(made).rename(folder)
            Path(made).mkdir()  # which is removed now
    return folder


if __name__ == "__main__":
    main()
