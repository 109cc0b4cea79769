"""Seeded damage to the bytes of a file: flipped bits, other bytes, a cut, a splice, a run of one byte."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from replant.errors import LogError


def damaged(content: bytes, seed: int) -> bytes:
    """Return the bytes with one to four damages of one kind."""
    rng = np.random.default_rng(seed)
    data = bytearray(content)
    kind = rng.integers(5)
    if kind == 0:
        return bytes(data[: rng.integers(len(data))])
    for _ in range(rng.integers(1, 5)):
        at, source, length = int(rng.integers(len(data))), int(rng.integers(len(data))), int(rng.integers(1, 64))
        if kind == 1:
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 2:
            data[at] = int(rng.integers(256))
        elif kind == 3:
            data[at : at + length] = data[source : source + length]
        else:
            length = min(length % 8 + 1, len(data) - at)
            data[at : at + length] = int(rng.choice([0, 127, 128, 255])).to_bytes() * length
    return bytes(data)


def is_read_or_refused(path: Path, read: Callable[[Path], object]) -> bool:
    """Return whether a file is read; if not, it is refused in one line that names it."""
    message = ""
    try:
        read(path)
    except LogError as error:
        message = str(error)
    assert not message or message.startswith(f"{path}: ")
    assert "\n" not in message
    return not message
