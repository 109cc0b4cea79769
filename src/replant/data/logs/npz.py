"""NumPy archives (.npz): vectors by name, the columns of a matrix as ``name[:,0]``."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replant.data.logs.arrays import array_table
from replant.data.logs.damage import damage_as_log_error
from replant.data.logs.table import Table


def read(path: Path) -> Table:
    """Open a NumPy archive.

    Raises
    ------
    LogError
        If it is not an archive that ``numpy.savez`` writes, or holds no signal.
    """
    with damage_as_log_error(path, ".npz archive", "save it with numpy.savez"):
        with zipfile.ZipFile(path):
            pass  # numpy.load would also accept a file with a single array
        return array_table(path, _arrays(path))


def _arrays(path: Path) -> Iterator[tuple[str, NDArray[Any]]]:
    with np.load(path, allow_pickle=False) as archive:
        for name in archive.files:
            try:
                array = archive[name]
            except ValueError:  # Python objects are no signals, and unsafe to load
                continue
            if isinstance(array, np.ndarray):
                yield name, array
