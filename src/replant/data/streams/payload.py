"""Payloads: the content of datagrams and messages, which is lines or packed binary numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from replant.arguments import FloatArray
from replant.data.streams.parser import Parser
from replant.data.streams.rows import FIELDS, Malformed
from replant.data.streams.source import Batch

#: The first bytes of a packed payload; four letters that name its columns follow ("ntuy", "tuyr", "uy  ").
MAGIC = b"RPL1"
HEADER = 8  # bytes before the numbers of a packed payload [bytes]


class Payloads:
    """Parses the payloads of one stream.

    A payload holds one or more lines (see `Parser`), or it is packed: `MAGIC`, the columns' letters padded with blanks
    to four, then rows of little-endian float64.

    >>> from collections import Counter
    >>> payloads = Payloads(Parser(Counter()))
    >>> packed = MAGIC + b"uy  " + np.array([[1.0, 0.5], [1.0, 0.7]], "<f8").tobytes()
    >>> payloads.parse([packed], arrived=0.0).y
    array([0.5, 0.7])
    """

    def __init__(self, parser: Parser, *, bare: bool = False) -> None:
        self._parser = parser
        self._bare = bare

    def parse(self, payloads: Sequence[bytes], arrived: float) -> Batch | None:
        """Return the samples in payloads, None if there are none."""
        if not self._bare and not any(payload.startswith(MAGIC) for payload in payloads):
            return self._parser.parse(b"\n".join(payloads), arrived)
        tables: list[FloatArray] = []
        for payload in payloads:
            if self._bare or payload.startswith(MAGIC):
                try:
                    tables.append(self._unpack(payload))
                except Malformed as reason:
                    self._parser.count(str(reason))
            else:
                tables += self._parser.tables(payload)
        return self._parser.batch(tables, arrived)

    def _unpack(self, payload: bytes) -> FloatArray:
        names = (
            self._parser.columns
            if self._bare
            else tuple(payload[len(MAGIC) : HEADER].decode("ascii", "replace").strip())
        )
        numbers = payload if self._bare else payload[HEADER:]
        if names is None or not {"u", "y"} <= set(names) <= set(FIELDS) or len(set(names)) < len(names):
            raise Malformed("not packed right")
        if not numbers or len(numbers) % (8 * len(names)):
            raise Malformed("not packed right")
        table = np.frombuffer(numbers, "<f8").astype(np.float64).reshape(-1, len(names))
        if self._parser.columns is None:
            self._parser.set_columns(names)
        if self._parser.columns is None or names == self._parser.columns:
            return table
        if not set(self._parser.columns) <= set(names):
            raise Malformed("fields missing")
        return table[:, [names.index(name) for name in self._parser.columns]]
