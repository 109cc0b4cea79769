"""Loops of a benchmark, compiled as the package's kernels are, into a library of their own."""

from __future__ import annotations

import functools
import hashlib
import inspect
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from replant.kernels.native import KERNELS, Kernel, Library, source_hash

TOOLS = Path(__file__).resolve().parents[1] / "tools"


@functools.cache
def compiled(kernel: Kernel) -> Callable[..., Any]:
    """Return a loop of a benchmark, compiled; made once for each state of the sources."""
    return _library(kernel.python.__module__).kernel(kernel.name)


@functools.cache
def _library(module: str) -> Library:
    if str(TOOLS) not in sys.path:
        sys.path.insert(0, str(TOOLS))
    from translator.library import build

    own = [kernel for kernel in KERNELS if kernel.python.__module__ == module]
    package = Path(inspect.getfile(Library)).parent
    text = source_hash(package, TOOLS / "translator") + module + inspect.getsource(sys.modules[module])
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    path = Path(tempfile.gettempdir()) / f"replant-benchmark-{os.getuid()}-{digest}.so"
    if not path.exists():
        build(path, instead=own)
    return Library(path)
