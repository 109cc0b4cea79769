"""docs/state.md: every number of an identifier's state, made from the schema."""

from __future__ import annotations

from pathlib import Path

from replant.kernels import schema
from replant.kernels.slot_tables import Block, Choice, Flag, Integer, Nested, Real, Slot, Table

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "state.md"

_HEAD = """# The state of an identifier

*Which numbers does an identifier keep, where do they lie, and who changes them?*

This page is made from
`src/replant/kernels/schema.py` by `make pages`.

An identifier's state is five arrays. `ints` (int64) and `reals` (float64) are listed below; beside them lie three
filter banks, the replay buffer, and the newest raw samples. Kernels find a number by its upper-case name
(`ints[at.ALARM]`, `reals[ints[at.AT_THETA] : ...]`), the code above them by a property (`state.alarm`, `state.theta`).
A checkpoint holds the arrays as they are; the ranges below are checked when one is loaded.

| dimension | meaning |
|---|---|
| n | poles |
| N | n + 2 |
| T | entries of the regressor: the parameters, then the nuisances of the refined filter |
| M, S | numbers of the optimizer's memory and of its settings |
| RING | past inputs kept for the dead time |
"""


def page() -> str:
    """Return the page."""
    fixed = "".join(f"| {name} | {size} |\n" for name, size in schema.FIXED.items())
    parts = [_HEAD + fixed]
    for table, title in (
        (schema.StateSlots, "The state"),
        (schema.ColourSlots, "Its block `colour`"),
        (schema.PathSlots, "Its block `path`"),
    ):
        parts += [f"## {title}\n\n{table.__doc__}\n", *_tables(table)]
    parts += ["## Named values\n", *(_values(kind) for kind in (schema.Alarm, schema.Doubt))]
    return "\n".join(parts)


def _tables(table: type[Table]) -> list[str]:
    found = []
    for title, slots in (("Integers", table.integers), ("Numbers", table.scalars), ("Blocks", table.blocks)):
        if slots:
            rows = "\n".join(_row(slot) for slot in slots)
            found.append(
                f"### {title}\n\n| name | kind | meaning | unit | changed by |\n|---|---|---|---|---|\n{rows}\n"
            )
    return found


def _row(slot: Slot) -> str:
    return f"| `{slot.name}` | {_kind(slot)} | {slot.meaning} | {slot.unit} | {slot.writer} |"


def _kind(slot: Slot) -> str:
    match slot:
        case Nested():
            return "see below"
        case Block():
            return f"({slot.shape})"
        case Flag():
            return "truth"
        case Choice():
            return slot.kind.__name__
        case Integer():
            return f"{slot.least} or more" + (f", below {slot.below}" if slot.below else "")
        case Real():
            ends = (("from", slot.least), ("to", slot.most))
            limits = [f"{word} {limit:g}" for word, limit in ends if abs(limit) < 1e300]
            return " ".join(limits) or ("any" if slot.finite else "any, or not finite")
    return ""


def _values(kind: type[schema.IntEnum]) -> str:
    rows = "\n".join(f"| {member.name} | {member.value} |" for member in kind)
    return f"`{kind.__name__}`: {kind.__doc__}\n\n| name | value |\n|---|---|\n{rows}\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
