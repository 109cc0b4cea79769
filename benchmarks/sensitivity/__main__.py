"""Halve and double each tuned constant, and say what changes on a battery of records: `make sensitivity`.

Every value has a process of its own, forked from one that has not imported the package; what came of each is added to
out/sensitivity.jsonl, so that a run that was interrupted goes on; `--write` puts that into the strings below the
constants.  Processor time: five seconds a value.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import math
import os
import resource
import sys
import tempfile
import textwrap
import time
import traceback
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tools"), str(ROOT / "benchmarks")]

import numba  # noqa: E402  what takes long to import, once for all processes
import scipy.linalg  # noqa: E402
import scipy.signal  # noqa: E402, F401
from constants_page import measurable  # noqa: E402

from sensitivity.adjustable import make_copy  # noqa: E402
from sensitivity.outcome import Outcome  # noqa: E402

LONGEST = 60
"""Processor time that one value may take; usual are five seconds [s]."""

NOTED = 1.25
"""Ratio of an estimate's errors from which on it is named: chance makes that much of an error of three coefficients
[ratio]."""


def scaled(value: Any, factor: float) -> Any:
    """Return a value halved or doubled; of a share or ratio near one its distance from one."""
    if isinstance(value, tuple):
        return tuple(scaled(part, factor) for part in value)
    if isinstance(value, int):
        return max(round(value * factor), 1)
    if 0.5 < abs(value) <= 1.5 and value != 1.0:
        return 1.0 + (value - 1.0) * factor
    return value * factor


def measured(changed: Mapping[str, Any]) -> dict[str, Any]:
    """Run the battery in a process of its own with these values."""
    read, write = os.pipe()
    child = os.fork()
    if child:
        os.close(write)
        with os.fdopen(read, "rb") as pipe:
            content = pipe.read()
        os.waitpid(child, 0)
        return json.loads(content) if content else {"failed": "the process ends, or does not"}
    os.environ["ADJUSTED_CONSTANTS"] = json.dumps(changed)
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


def words(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """Say what differs between two runs of the battery."""
    if "failed" in after:
        return f"cannot be: {after['failed']}"
    broken = [name for name in before if "failed" in after[name]]
    if broken:
        return f"cannot be: {broken[0]} ends with {after[broken[0]]['failed'][:60]}"
    if json.dumps(before) == json.dumps(after):
        return "not met by these records"
    said: list[str] = []
    pairs = {name: (Outcome(**before[name]), Outcome(**after[name])) for name in before}

    def names(which: Iterable[str]) -> str:
        return ", ".join(f"'{name}'" for name in which)

    for text, chosen in {
        "right estimates no longer trusted": [n for n, (a, b) in pairs.items() if _right(a) and not _right(b)],
        "right estimates trusted only now": [n for n, (a, b) in pairs.items() if _right(b) and not _right(a)],
        "wrong ones trusted": [n for n, (a, b) in pairs.items() if _wrong(b) and not _wrong(a)],
        "wrong ones trusted no longer": [n for n, (a, b) in pairs.items() if _wrong(a) and not _wrong(b)],
    }.items():
        if chosen:
            said.append(f"{text}: {names(chosen)}")
    for name, (a, b) in pairs.items():
        if a.late != b.late:
            said.append(f"'{name}' noticed after {_samples(b.late)} instead of {_samples(a.late)}")
    for name, (a, b) in pairs.items():
        if a.alarms != b.alarms:
            said.append(f"{b.alarms} samples held against '{name}' instead of {a.alarms}")
    for name, (a, b) in pairs.items():
        ratio = b.error / a.error if a.error > 0.0 else 1.0
        if not 1.0 / NOTED < ratio < NOTED and not (math.isnan(a.error) and math.isnan(b.error)):
            said.append(f"error of '{name}' times {ratio:.2g}")
    return "; ".join(said) or "no verdict changes, and no error by a quarter"


def _right(found: Outcome) -> bool:
    return bool(found.trusted and found.is_right)


def _wrong(found: Outcome) -> bool:
    return bool(found.trusted and not found.is_right)


def _samples(late: float) -> str:
    return "never" if math.isinf(late) else f"{late:.0f} samples"


def write(rows: Iterable[Mapping[str, Any]]) -> None:
    """Write what was measured below each constant, after "Sensitivity: ", in the source."""
    said: dict[str, dict[float, str]] = {}
    for row in rows:
        said.setdefault(row["name"], {})[row["factor"]] = row["words"]
    for name, by_factor in said.items():
        home, _, own = name.rpartition(".")
        path = ROOT / "src" / "replant" / f"{home.replace('.', '/')}.py"
        lines = path.read_text(encoding="utf-8").splitlines()
        begin = next(i for i, line in enumerate(lines) if line.startswith((f"{own} = ", f"{own}: Final = ")))
        begin = next(i for i in range(begin, len(lines)) if lines[i].startswith("Sensitivity: "))
        end = lines.index('"""', begin)
        lines[begin:end] = textwrap.wrap(f"Sensitivity: {_sentence(by_factor)}.", 120, break_on_hyphens=False)
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _sentence(by_factor: Mapping[float, str]) -> str:
    halved, doubled = by_factor.get(0.5, "the same number"), by_factor.get(2.0, "not measured")
    return f"halved or doubled, {halved}" if halved == doubled else f"halved, {halved}; doubled, {doubled}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", help="names, as assessment.change_tests.SURE")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "sensitivity.jsonl")
    parser.add_argument("--write", action="store_true", help="only write what was measured into the source")
    parser.add_argument("--seconds", type=float, default=math.inf, help="processor time to spend")
    arguments = parser.parse_args()
    if arguments.write:
        write([json.loads(line) for line in arguments.out.read_text(encoding="utf-8").splitlines()])
        return
    usual = measurable()
    chosen = arguments.only or list(usual)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    done = set()
    if arguments.out.exists():
        done = {(row["name"], row["factor"]) for row in map(json.loads, arguments.out.read_text().splitlines())}
    folder = _copy(usual)
    sys.path.insert(0, str(folder))
    os.environ["NUMBA_CACHE_DIR"] = f"{folder}/kernels"
    numba.config.reload_config()
    measured({})  # the first one compiles
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
    files = [*sorted((ROOT / "src" / "replant").rglob("*.py")), Path(__file__).with_name("adjustable.py")]
    digest = hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]
    folder = Path(tempfile.gettempdir()) / f"replant-adjustable-{os.getuid()}-{digest}"
    if not folder.exists():
        with tempfile.TemporaryDirectory(dir=folder.parent) as made:
            make_copy(ROOT / "src" / "replant", Path(made), usual)
            Path(made).rename(folder)
            Path(made).mkdir()  # which is removed now
    return folder


if __name__ == "__main__":
    main()
