"""The separate process in which a parser reads a file: it may crash on damaged bytes, or take memory without end.

`parser_process` starts it by its path, with the function that reads the file, the file, the libraries to import before
memory is limited, those that must not be imported, then folders to import from.  Requests are lines of JSON on standard
input; an answer is a line of JSON, and the bytes of the arrays that it lists.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

if TYPE_CHECKING:
    import numpy as np

    from replant.data.logs.table import Table

_TO_ANSWER = 1 << 20  # memory kept for the answer [bytes]
Answer = tuple[dict[str, Any], "list[np.ndarray[Any, Any]]"]
Reader = Callable[[Path], "Table"]


def main() -> None:
    """See above."""
    function, name, libraries, absent, *folders = sys.argv[1:]
    out = os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)  # some libraries print what they cannot read
    sys.path += folders  # at the end, so that no module of the user hides one of Python
    sys.modules.update(dict.fromkeys(filter(None, absent.split(","))))  # type: ignore[arg-type]
    from replant.data.logs import table as reading

    read = reader(function)
    for library in filter(None, libraries.split(",")):
        with contextlib.suppress(ImportError):  # which the reader says
            importlib.import_module(library)
    path = Path(name)
    reading.begin(path.stat().st_size if path.is_file() else 0)
    with contextlib.suppress(BrokenPipeError):
        _serve(read, path, out)
    os._exit(0)  # nothing of a damaged file is to be put in order


def reader(name: str) -> Reader:
    """Return the function that reads a format, given as ``module.function`` of this folder."""
    module, _, function = name.partition(".")
    read: Reader = getattr(importlib.import_module(f"replant.data.logs.{module}"), function)
    return read


def _serve(read: Reader, path: Path, out: BinaryIO) -> None:
    try:
        table = read(path)
    except Exception as error:
        _write(out, _failure(error), [])
        return
    _write(out, about(table), [])
    for line in sys.stdin.buffer:
        try:
            for message, arrays in answers(table, json.loads(line)):
                _write(out, message, arrays)
        except BrokenPipeError:
            raise
        except Exception as error:
            _write(out, _failure(error), [])


def about(table: Table) -> dict[str, Any]:
    """Return what a table tells of itself."""
    return {
        "names": table.names,
        "in_seconds": sorted(table.in_seconds),
        "origins": list(table.origins.items()),
        "approximate_rows": table.approximate_rows,
        "notes": table.notes,
        "dt": table.dt,
        "left_out": dict(table.left_out),
        "stamped": table.stamps is not None,
    }


def answers(table: Table, request: dict[str, Any]) -> Iterator[Answer]:
    """Yield what answers a request: blocks of rows, stamps of a column, or the words for a row."""
    import numpy as np

    from replant.data.logs import table as reading

    if "row" in request:
        yield {"row": table.describe_row(request["row"])}, []
        return
    if "stamps" in request:
        assert table.stamps is not None
        blocks: Any = iter([[table.stamps(request["stamps"])]])
    else:
        blocks = table.blocks(request["columns"])
    for block in blocks:
        reading.allow(found=sum(int(np.count_nonzero(np.isfinite(array))) for array in block))
        yield {"lengths": [array.size for array in block]}, block
    yield {"end": True}, []


def _failure(error: Exception) -> dict[str, Any]:
    from replant.data.logs import table as reading
    from replant.errors import ReplantError

    reading.allow(held=_TO_ANSWER)  # what the error still holds may be all that was allowed
    if isinstance(error, ReplantError):
        return {"error": type(error).__name__, "text": str(error)}
    if isinstance(error, OSError) and error.errno is not None:
        return {"error": "OSError", "code": error.errno, "text": error.strerror}
    return {"error": "", "text": " ".join(str(error).split())[:120] or type(error).__name__}


def _write(out: BinaryIO, message: dict[str, Any], arrays: list[np.ndarray[Any, Any]]) -> None:
    import numpy as np

    out.write(json.dumps(message).encode() + b"\n")
    for array in arrays:
        out.write(np.ascontiguousarray(array, np.float64).data.cast("B") if array.size else b"")
    out.flush()


if __name__ == "__main__":
    main()
