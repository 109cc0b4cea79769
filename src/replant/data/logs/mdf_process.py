"""The separate process in which asammdf parses a measurement data file: it may crash on damaged bytes.

`mdf.py` starts it by its path, with the largest memory in bytes, the file, the channels to read (``group:number``,
with commas between them; none: to list them all), then folders to import from.  It writes a line of JSON (the channels,
or an error), then the stamps and the values of the channels as float64.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

TIME = 1
"""Kind of a group's master channel that is time; others are angle, distance and index [code]."""


def listed(file: Any) -> list[list[Any]]:
    """Return the channels over time: group, number in the group, name of the group, name, unit."""
    found: list[list[Any]] = []
    for group, about in enumerate(file.groups):
        master = file.masters_db.get(group)
        if master is None or getattr(about.channels[master], "sync_type", TIME) != TIME:
            continue
        name = str(getattr(about.channel_group, "acq_name", "") or f"group {group}")
        for number, channel in enumerate(about.channels):
            if number != master:
                found.append([group, number, name, channel.name, _unit(channel)])
    return found


def _unit(channel: Any) -> str:
    conversion = getattr(channel, "conversion", None)
    return str(getattr(channel, "unit", "") or getattr(conversion, "unit", "") or "").strip()


def signal(file: Any, group: int, number: int) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return stamps and values of a channel, NaN where the logger marked it as invalid; None if it holds no numbers."""
    import numpy as np

    found = file.get(group=group, index=number, ignore_invalidation_bits=True)
    if found.samples.dtype.kind not in "biuf" or found.samples.ndim != 1:
        return None
    values = np.array(found.samples, np.float64)
    if found.invalidation_bits is not None:
        values[np.asarray(found.invalidation_bits, np.bool_)] = np.nan
    return np.array(found.timestamps, np.float64), values


def opened(path: str) -> Any:
    """Open a file."""
    from asammdf import MDF

    return MDF(path)


def main() -> None:
    """See above."""
    _, memory, path, channels, *folders = sys.argv
    with contextlib.suppress(ImportError, ValueError, OSError):  # Windows has no such limit
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (int(memory),) * 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    sys.path += folders  # at the end, so that no module of the user hides one of Python
    out = sys.stdout.buffer
    arrays: list[Any] = []
    with (
        Path(os.devnull).open("w") as nowhere,
        contextlib.redirect_stdout(nowhere),
    ):  # asammdf prints what it cannot read
        try:
            with opened(path) as file:
                if channels:
                    places = [place.split(":") for place in channels.split(",")]
                    found = [signal(file, int(group), int(number)) for group, number in places]
                    arrays = [array for one in found if one is not None for array in one]
                    message: dict[str, Any] = {"samples": [None if one is None else one[0].size for one in found]}
                else:
                    message = {"channels": listed(file)}
        except Exception as error:
            message, arrays = {"error": str(error) or type(error).__name__}, []
    out.write(json.dumps(message).encode() + b"\n")
    for array in arrays:
        out.write(array.tobytes())


if __name__ == "__main__":
    main()
