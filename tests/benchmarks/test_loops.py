"""Loops of the benchmarks use kernels by their names and arguments: the compiler says where one has changed."""

from __future__ import annotations

import importlib
import sys

import pytest

from replant.kernels.native import KERNELS
from support.places import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))

from compiled import compiled


@pytest.mark.slow
@pytest.mark.parametrize("module", ["parts", "scaling", "accuracy.tracking"])
def test_loops_of_benchmarks_are_compiled(module: str) -> None:
    importlib.import_module(module)
    loops = [loop for loop in KERNELS if loop.python.__module__ == module]
    assert loops
    assert all(callable(compiled(loop)) for loop in loops)
