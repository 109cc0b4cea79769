"""docs/constants.md: the tuned constants, from the string that stands below each numeric constant of a module.

The string's first paragraph says what the number means, and ends with its unit in brackets; of a plain fact a comment
on its line may say it.  Lines may follow:

    Level: ...        of a statistical test or quantile
    Derivation: ...   how it follows from something else
    Origin: ...       how a tuned number was chosen
    Sensitivity: ...  what changes when it is halved and doubled, as `make sensitivity` measures it

`--check` compares the page with the source, and says which constant lacks a part of its string.
"""

from __future__ import annotations

import ast
import re
import sys
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

NOT_RECORDED = "not recorded"
NOTHING = (
    "halved or doubled, nothing changes on these records.",
    "halved or doubled, no verdict changes, and no error by a quarter.",
)

_HEAD = """# The tuned constants

*Which numbers were chosen, and what happens if they are others?*

{tuned} constants are tuned. {others} others follow from something else, stand for a level, or are plain facts: a
comment at each says which. The string below a tuned one in the source says what it means and where it comes from.
`make pages` makes this page of these strings.

`make sensitivity` halves and doubles a constant, of a number between 0.5 and 1.5 its distance from one, on records with
noise, outliers, failing sensors, gaps, jitter, changes and plants of other kinds. An effect is another verdict, another
time at which a failure is noticed, an error that grows or shrinks by a quarter. Where none is named, none was seen, of
most not in the last bit. {unmeasured} are not measured.
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
        """Whether meaning and unit are said, and a recorded origin and the sensitivity of a tuned constant."""
        said = self.paragraphs
        recorded = "Origin" in said and not said["Origin"].startswith(NOT_RECORDED)
        origin = self.kind != "tuned" or (recorded and "Sensitivity" in said)
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
            _, mark, comment = text.splitlines()[node.end_lineno - 1].partition("  # ")
            said = said or (f"{comment}." if mark else "")
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
    """Return the constants to be measured, as "assessment.verdict.ALPHA", and their values."""
    chosen = [found for found in constants() if "Sensitivity" in found.paragraphs]
    return {f"{found.module}.{name}": _value(found.value) for found in chosen for name in found.names}


def _value(source: str) -> Any:
    """Return the value of an expression made of numbers alone."""
    return eval(source, {"__builtins__": {}})


def page() -> str:
    """Return the page."""
    found = constants()
    tuned = [one for one in found if one.kind == "tuned"]
    head = _HEAD.format(
        tuned=_count(tuned),
        others=_count([one for one in found if one.kind != "tuned"]),
        unmeasured=_count([one for one in tuned if one.paragraphs.get("Sensitivity") == f"{NOT_MEASURED}."]),
    )
    lines = [head]
    for module in dict.fromkeys(one.module for one in tuned):
        lines += [f"`{module}`", *(_line(one) for one in tuned if one.module == module), ""]
    return "\n".join(lines)


def _count(found: list[Constant]) -> int:
    return sum(len(one.names) for one in found)


def _line(one: Constant) -> str:
    names = ", ".join(f"`{name}`" for name in one.names)
    effect = one.paragraphs.get("Sensitivity", "")
    words = "" if effect in NOTHING else f" {effect[:1].upper()}{effect[1:]}"
    return f": {names} = {one.value} [{one.unit}]: {one.meaning}.{words}"


def faults() -> list[str]:
    """Return what is to be mended, a line each."""
    lacking = [one for one in constants() if not one.is_complete]
    found = [f"{one.module}, line {one.line}: {', '.join(one.names)} lacks meaning, unit, Origin or Sensitivity"
             for one in lacking]  # fmt: skip
    if PAGE.read_text(encoding="utf-8") != page():
        found.append(f"{PAGE.relative_to(ROOT)} is not the present one: make pages")
    return found


if __name__ == "__main__":
    if sys.argv[1:] == ["--check"]:
        sys.exit("\n".join(faults()) or 0)
    PAGE.write_text(page(), encoding="utf-8")
