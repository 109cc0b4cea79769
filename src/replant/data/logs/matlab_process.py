"""The separate process in which SciPy parses a MATLAB file: its compiled parser may crash on damaged bytes.

`matlab.py` starts it by its path, so that it imports neither replant nor the user's script.  It reads the file from
standard input.  It writes a line of JSON (name, type, shape and order of the arrays, or an error), then the arrays'
bytes.
"""

from __future__ import annotations

import contextlib
import json
import sys
import warnings
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, BinaryIO

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def load(file: BinaryIO) -> dict[str, Any]:
    """Return the variables of a MATLAB file."""
    import scipy.io

    with warnings.catch_warnings(action="ignore"):  # SciPy warns about variables that are no signals
        contents: dict[str, Any] = scipy.io.loadmat(file)
    return contents


def signals(contents: dict[str, Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the numeric arrays among variables with their names, those in a struct as ``data.time``."""
    for name, value in _arrays(contents):
        is_sampling_time = name.rpartition(".")[2] == "Ts" and value.size == 1
        if value.dtype.kind in "biuf" and (value.size > 1 or is_sampling_time):
            yield name, value


def _arrays(contents: dict[str, Any]) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    import numpy as np

    for name, value in contents.items():
        if name.startswith("__") or not isinstance(value, np.ndarray):
            continue
        if value.dtype.names is None:
            yield name, value
        elif value.size == 1 and not _is_opaque(value):
            fields = value.reshape(-1)[0]
            for field in value.dtype.names:
                if isinstance(fields[field], np.ndarray):
                    yield f"{name}.{field}", fields[field]
                    if field == "signals":
                        yield from _simulink_signals(f"{name}.{field}", fields[field])


def _simulink_signals(name: str, signals: np.ndarray[Any, Any]) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    """Yield the values of what Simulink logs as a structure with time."""
    if signals.dtype.names and "values" in signals.dtype.names:
        for number, signal in enumerate(signals.reshape(-1), 1):
            place = name if signals.size == 1 else f"{name}({number})"
            yield f"{place}.values", signal["values"]


def _is_opaque(value: Any) -> bool:
    """Whether it is an object of a class of MATLAB's, of which SciPy knows the name alone."""
    return value.dtype.names is not None and {"s0", "s1", "s2", "arr"} <= set(value.dtype.names)


def objects(contents: dict[str, Any]) -> dict[str, str]:
    """Return the names of the objects that cannot be read, with their classes."""
    found = {}
    for value in contents.values():
        if hasattr(value, "dtype") and _is_opaque(value):
            for one in value.reshape(-1):
                name, kind = (bytes(part).decode(errors="replace") for part in (one["s0"], one["s2"]))
                found[name] = kind
    return found


def main() -> None:
    """Read standard input, write standard output.  Arguments: largest memory in bytes, then folders to import from."""
    with contextlib.suppress(ImportError, ValueError, OSError):  # Windows has no such limit
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[1]),) * 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    sys.path += sys.argv[2:]  # at the end, so that no module of the user hides one of Python
    out = sys.stdout.buffer
    try:
        contents = load(sys.stdin.buffer)
        found, left_out = dict(signals(contents)), objects(contents)
    except Exception as error:
        out.write(json.dumps({"error": str(error) or type(error).__name__}).encode() + b"\n")
        return
    arrays = [
        (name, array.dtype.str, array.shape, "F" if array.flags.f_contiguous else "C") for name, array in found.items()
    ]
    out.write(json.dumps({"arrays": arrays, "objects": left_out}).encode() + b"\n")
    for array in found.values():
        out.write(array.tobytes("A"))


if __name__ == "__main__":
    main()
