"""A copy of the package whose constants a fresh process can set as it imports them, kernels included.

Python modules: each assignment of a constant asks for its value, so whoever imports the name, and whatever is derived
from it, sees that.  Compiled kernels take constants as literals: in the copy each of them is read from a fixed address
of the memory instead, so that the kernels are compiled once for all values.
"""

from __future__ import annotations

import ast
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

# Shared by all kernels of the copy; far from where the system puts anything by itself.
RUNTIME = '''"""The values of constants in this copy of the package, see benchmarks/sensitivity/adjustable.py."""

import ctypes
import json
import mmap
import os

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

ADDRESS, SIZE = 0x5F0000000000, 4096
CHANGED = json.loads(os.environ.get("ADJUSTED_CONSTANTS", "{}"))
FIXED = 0x100000  # MAP_FIXED_NOREPLACE

_map = ctypes.CDLL(None, use_errno=True).mmap
_map.restype = ctypes.c_void_p
_map.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long]
if _map(ADDRESS, 2 * SIZE, 3, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | FIXED, -1, 0) != ADDRESS:
    raise OSError("the memory of the constants is taken")
REALS = (ctypes.c_double * (SIZE // 8)).from_address(ADDRESS)
INTS = (ctypes.c_int64 * (SIZE // 8)).from_address(ADDRESS + SIZE)


def value(name, usual, slot=None):
    """Return the value of a constant in this process, and tell the kernels."""
    now = CHANGED.get(name, usual)
    if isinstance(usual, tuple):
        now = tuple(now)
    if slot is not None:
        (REALS if isinstance(usual, float) else INTS)[slot] = now
    return now


def _load(builder, slot, base, kind):
    address = builder.add(ir.Constant(ir.IntType(64), base), builder.mul(slot, ir.Constant(ir.IntType(64), 8)))
    return builder.load(builder.inttoptr(address, kind.as_pointer()))


@intrinsic
def real(typing, slot):
    return types.float64(types.int64), lambda c, b, s, a: _load(b, a[0], ADDRESS, ir.DoubleType())


@intrinsic
def whole(typing, slot):
    return types.int64(types.int64), lambda c, b, s, a: _load(b, a[0], ADDRESS + SIZE, ir.IntType(64))
'''


def make_copy(source: Path, target: Path, values: Mapping[str, Any]) -> None:
    """Copy the package ``source`` to ``target`` with constants, as "assessment.change_tests.SURE", adjustable."""
    shutil.copytree(source, target / "replant", ignore=shutil.ignore_patterns("__pycache__"))
    (target / "adjusted.py").write_text(RUNTIME, encoding="utf-8")
    slots = {name: slot for slot, name in enumerate(sorted(values))}
    for path in sorted((target / "replant").rglob("*.py")):
        module = ".".join(path.relative_to(target / "replant").with_suffix("").parts)
        text = path.read_text(encoding="utf-8")
        changed = _Module(module, ast.parse(text), slots, values).changed(text)
        if changed != text:
            path.write_text(changed, encoding="utf-8")


class _Module:
    """What is replaced in the text of one module."""

    def __init__(self, module: str, tree: ast.Module, slots: dict[str, int], values: Mapping[str, Any]) -> None:
        self.module, self.tree, self.slots, self.values = module, tree, slots, values
        self.kernel = module.startswith("kernels.") and module != "kernels.schema"
        self.known = dict(self._known())

    def _known(self) -> Iterator[tuple[str, str]]:
        """Yield names in this module and the constants, or modules, that they stand for."""
        for name in self.slots:
            home, _, own = name.rpartition(".")
            if home == self.module:
                yield own, name
        for node in ast.walk(self.tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("replant"):
                home = (node.module or "")[len("replant.") :]
                for alias in node.names:
                    yield alias.asname or alias.name, f"{home}.{alias.name}" if home else alias.name

    def changed(self, text: str) -> str:
        found = [*self._assignments(text), *(self._uses() if self.kernel else ())]
        if not found:
            return text
        lines = text.splitlines(keepends=True)
        for node, new in sorted(found, key=lambda pair: (pair[0].lineno, pair[0].col_offset), reverse=True):
            first, last = node.lineno - 1, node.end_lineno - 1
            before, after = lines[first].encode()[: node.col_offset], lines[last].encode()[node.end_col_offset :]
            lines[first : last + 1] = [(before + new.encode() + after).decode()]
        place = next(
            i for i, node in enumerate(self.tree.body)
            if not (isinstance(node, ast.Expr) or (isinstance(node, ast.ImportFrom) and node.module == "__future__"))
        )  # fmt: skip
        lines.insert(self.tree.body[place].lineno - 1, "import adjusted\n")
        return "".join(lines)

    def _assignments(self, text: str) -> Iterator[tuple[ast.expr, str]]:
        for node in self.tree.body:
            target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
            name = f"{self.module}.{target.id}" if isinstance(target, ast.Name) else ""
            if name in self.slots:
                plain = ast.get_source_segment(text, node.value)
                slot = f", {self.slots[name]}" if self.module.startswith("kernels.") else ""
                yield node.value, f'adjusted.value("{name}", ({plain}){slot})'

    def _uses(self) -> Iterator[tuple[ast.expr, str]]:
        for function in ast.walk(self.tree):
            if isinstance(function, ast.FunctionDef):
                for statement in function.body:
                    for node in ast.walk(statement):
                        name = self._named(node)
                        if name:
                            yield node, name

    def _named(self, node: ast.AST) -> str:
        if isinstance(node, ast.Name):
            name = self.known.get(node.id, "")
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            name = f"{self.known.get(node.value.id, '')}.{node.attr}"
        else:
            return ""
        if name not in self.slots or not name.startswith("kernels."):
            return ""
        kind = "real" if isinstance(self.values[name], float) else "whole"
        return f"adjusted.{kind}({self.slots[name]})"
