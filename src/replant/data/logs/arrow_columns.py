"""Columns of Arrow as float64: which types are read, and time stamps as seconds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replant.errors import LogError, shown

_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def is_stamp(kind: Any) -> bool:
    """Return whether an Arrow type is that of time stamps, or of times between them."""
    import pyarrow.types

    return bool(pyarrow.types.is_timestamp(kind) or pyarrow.types.is_duration(kind))


def check_type(path: Path, field: Any) -> None:
    """Check that a field of a schema holds numbers or time stamps."""
    from pyarrow import types

    number = types.is_integer(field.type) or types.is_floating(field.type) or types.is_decimal(field.type)
    if not (number or types.is_boolean(field.type) or is_stamp(field.type)):
        raise LogError(
            f"{path}: column {shown(field.name)} holds {field.type}, not numbers; choose another, or convert it"
        )


def as_float(column: Any, origin: list[int]) -> NDArray[np.float64]:
    """Convert a column of numbers or time stamps to float64; a null is NaN.

    ``origin`` holds the first stamp of the file, once there is one.
    """
    import pyarrow
    from pyarrow import types

    if not is_stamp(column.type):
        if types.is_boolean(column.type):
            column = column.cast(pyarrow.int8())
        values = column.cast(pyarrow.float64(), safe=False).to_numpy(zero_copy_only=False)
        return np.array(values, dtype=np.float64)
    counts = column.cast(pyarrow.int64())
    valid = np.asarray(counts.is_valid().to_numpy(zero_copy_only=False))
    exact = np.asarray(counts.fill_null(0).to_numpy())  # int64: nanoseconds since 1970 do not fit a float64
    seconds = np.full(exact.shape, np.nan)
    if valid.any():
        if not origin:
            origin.append(int(exact[valid][0]))
        seconds[valid] = (exact[valid] - origin[0]) * _SECONDS[column.type.unit]
    return seconds
