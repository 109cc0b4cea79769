"""docs/constants.md: every numeric constant of a module, from the string that stands below it.

The string's first paragraph says what the number means, and ends with its unit in brackets.  Lines may follow:

    Level: ...        of a statistical test or quantile
    Derivation: ...   how it follows from something else
    Origin: ...       how a tuned number was chosen
    Sensitivity: ...  what changes when it is halved and doubled, as `make sensitivity` measures it
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "replant"
PAGE = ROOT / "docs" / "constants.md"
FIELDS = ("Level", "Derivation", "Origin", "Sensitivity")
NOT_MEASURED = "not measured"

_HEAD = """# The constants

*Which numbers were chosen, why so, and what happens if they are others?*

This page is made from the strings below the
constants by `make pages`; `make sensitivity` measures what is said of halving and doubling.

The experiment: records of one kind each (white and slow noise, outliers, failing and coarse sensors, gaps, jitter,
changes of gain, a load step, an input that rests, plants that are not linear or of higher order, a short record) are
identified with one constant halved, and doubled; of a number between 0.5 and 1.5 the distance from one is. Noted is
which estimates are trusted, when a failure or change is noticed, which samples are held against a record without
reason, and errors that grow or shrink by a quarter and more. One record stands for each kind, so a single one that is
trusted or not may be chance. "Nothing changes on these records" says that
each verdict and figure of theirs stays the same to the last bit: no decision of theirs lies between the values, which
does not say that none does elsewhere.

{tuned} constants are tuned, {unmeasured}; {derived} follow from something else or stand for a
level; {facts} are plain facts: sizes, formats, time-outs.
"""


@dataclass(frozen=True)
class Constant:
    """A numeric constant, or several that are assigned together, and what is said of it."""

    module: str
    names: tuple[str, ...]
    value: str
    line: int
    text: str

    @property
    def paragraphs(self) -> dict[str, str]:
        """What is said, by field; "" is the meaning."""
        found, field = {"": ""}, ""
        for line in self.text.strip().splitlines():
            head, colon, rest = line.partition(": ")
            if colon and head in FIELDS:
                field, line = head, rest
            found[field] = f"{found.get(field, '')} {line.strip()}".strip()
        return found

    @property
    def meaning(self) -> str:
        """What the number is, without its unit."""
        return self._parts[0]

    @property
    def unit(self) -> str:
        """Its unit; empty where none is given."""
        return self._parts[1]

    @property
    def _parts(self) -> tuple[str, str]:
        found = re.fullmatch(r"(.*?) \[([^][]+)\]\.", self.paragraphs[""])
        return (found[1], found[2]) if found else (self.paragraphs[""], "")

    @property
    def kind(self) -> str:
        """One of "tuned", "derived" and "fact"."""
        said = self.paragraphs
        if "Level" in said or "Derivation" in said:
            return "derived"
        return "tuned" if "Origin" in said or "Sensitivity" in said else "fact"

    @property
    def is_complete(self) -> bool:
        """Whether meaning and unit are said, and origin and sensitivity of a tuned constant."""
        said = self.paragraphs
        origin = self.kind != "tuned" or ("Origin" in said and "Sensitivity" in said)
        return bool(self.meaning and self.unit and origin)


@cache
def constants() -> list[Constant]:
    """Return every numeric constant of the package's modules, in order."""
    return [found for path in sorted(SOURCE.rglob("*.py")) for found in _of_module(path)]


def _of_module(path: Path) -> Iterator[Constant]:
    text = path.read_text(encoding="utf-8")
    body = ast.parse(text).body
    module = ".".join(path.relative_to(SOURCE).with_suffix("").parts)
    for node, after in zip(body, [*body[1:], None], strict=True):
        names = _names(node)
        value = getattr(node, "value", None)
        if names and value is not None and _is_numeric(value):
            said = after.value.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else ""
            shown = re.sub(r"\s+", " ", ast.get_source_segment(text, value) or "")
            yield Constant(module, names, shown, node.lineno, said if isinstance(said, str) else "")


def _names(node: ast.stmt) -> tuple[str, ...]:
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    flat = [part for target in targets for part in getattr(target, "elts", [target])]
    names = tuple(part.id for part in flat if isinstance(part, ast.Name))
    return names if names and all(name.isupper() for name in names) else ()


def _is_numeric(value: ast.expr) -> bool:
    """Return whether an expression is made of numbers alone, perhaps in a tuple or as a NumPy number."""
    match value:
        case ast.Constant():
            return isinstance(value.value, int | float) and not isinstance(value.value, bool)
        case ast.UnaryOp():
            return _is_numeric(value.operand)
        case ast.BinOp():
            return _is_numeric(value.left) and _is_numeric(value.right)
        case ast.Tuple():
            return bool(value.elts) and all(map(_is_numeric, value.elts))
        case ast.Call(func=ast.Attribute(value=ast.Name(id="np"), attr="uint64")):
            return all(map(_is_numeric, value.args))
    return False


def measurable() -> dict[str, Any]:
    """Return the constants whose sensitivity is measured, as "assessment.change_tests.SURE", and their values."""
    chosen = [found for found in constants() if "Sensitivity" in found.paragraphs]
    return {f"{found.module}.{name}": _value(found.value) for found in chosen for name in found.names}


def _value(source: str) -> Any:
    """Return the value of an expression made of numbers alone."""
    return eval(source, {"__builtins__": {}})


def page() -> str:
    """Return the page."""
    found = constants()
    by_kind = {kind: [one for one in found if one.kind == kind] for kind in ("tuned", "derived", "fact")}
    left = _count([one for one in by_kind["tuned"] if one.paragraphs.get("Sensitivity") == f"{NOT_MEASURED}."])
    head = _HEAD.format(
        tuned=_count(by_kind["tuned"]),
        unmeasured=f"{left} of them not measured" if left else "all of them halved and doubled",
        derived=_count(by_kind["derived"]),
        facts=_count(by_kind["fact"]),
    )
    return "\n".join(
        [
            head,
            "## Tuned\n",
            *_table(by_kind["tuned"], ("Origin", "Sensitivity")),
            "\n## Derived, or of a stated level\n",
            *_table(by_kind["derived"], ("Level", "Derivation", "Sensitivity")),
            "\n## Plain facts\n",
            *_table(by_kind["fact"], ()),
            "",
        ]
    )


def _count(found: list[Constant]) -> int:
    return sum(len(one.names) for one in found)


def _table(found: list[Constant], fields: tuple[str, ...]) -> Iterator[str]:
    """Yield the lines of a table, a module after the other."""
    columns = ["constant", "value", "meaning", "unit"]
    if fields:
        columns += ["origin", "halved, doubled"]
    yield f"| {' | '.join(columns)} |"
    yield "|---" * len(columns) + "|"
    module = ""
    for one in found:
        if one.module != module:
            module = one.module
            yield f"| **{module.replace('.', '/')}** |" + " |" * (len(columns) - 1)
        said = one.paragraphs
        cells = [", ".join(f"`{name}`" for name in one.names), f"`{one.value}`", one.meaning, one.unit]
        if fields:
            cells.append(" ".join(said[field] for field in fields[:-1] if field in said))
            cells.append(said.get("Sensitivity", ""))
        yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
