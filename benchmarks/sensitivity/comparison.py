"""How a constant is changed, what two runs of the battery say of it, and where that is written."""

from __future__ import annotations

import json
import math
import re
import textwrap
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from sensitivity.outcome import Outcome

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


def words(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """Say what differs between two runs of the battery."""
    if "failed" in after:
        return f"cannot be: {after['failed']}"
    broken = [name for name in before if "failed" in after[name]]
    if broken:
        return f"cannot be: {broken[0]} ends with {after[broken[0]]['failed'].partition(':')[0]}"
    if json.dumps(before) == json.dumps(after):
        return "nothing changes on these records"
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


def write(rows: Iterable[Mapping[str, Any]], package: Path) -> None:
    """Write what was measured below each constant, after "Sensitivity: ", in the source of ``package``."""
    said: dict[str, dict[float, str]] = {}
    for row in rows:
        said.setdefault(row["name"], {})[row["factor"]] = row["words"]
    for name, by_factor in said.items():
        home, _, own = name.rpartition(".")
        path = package / f"{home.replace('.', '/')}.py"
        lines = path.read_text(encoding="utf-8").splitlines()
        assigned = re.compile(rf"(\w+, )*{own}(, \w+)*(: Final)? = ")  # two numbers may share a line and its words
        begin = next(i for i, line in enumerate(lines) if assigned.match(line))
        begin = next(i for i in range(begin, len(lines)) if lines[i].startswith("Sensitivity: "))
        end = lines.index('"""', begin)
        lines[begin:end] = textwrap.wrap(f"Sensitivity: {sentence(by_factor)}.", 120, break_on_hyphens=False)
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def sentence(by_factor: Mapping[float, str]) -> str:
    halved, doubled = by_factor.get(0.5, "the same number"), by_factor.get(2.0, "not measured")
    return f"halved or doubled, {halved}" if halved == doubled else f"halved, {halved}; doubled, {doubled}"
