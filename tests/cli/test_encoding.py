"""Streams that cannot show every character get plain ones, and never an error."""

from __future__ import annotations

import io
import sys

import pytest

from replant.cli.messages import PLAIN, replace_unencodable


@pytest.mark.parametrize(
    ("encoding", "expected"),
    [
        ("utf-8", "(1.2 ± 0.1)×10⁻⁷ − ∞, ü, 数"),
        ("ascii", "(1.2 +- 0.1)x10^-7 - inf, \\xfc, \\u6570"),
        ("latin-1", "(1.2 ± 0.1)×10^-7 - inf, ü, \\u6570"),
    ],
)
def test_what_a_stream_lacks_is_written_plainly(monkeypatch: pytest.MonkeyPatch, encoding: str, expected: str) -> None:
    streams = [io.TextIOWrapper(io.BytesIO(), encoding=encoding) for _ in range(2)]
    monkeypatch.setattr(sys, "stdout", streams[0])
    monkeypatch.setattr(sys, "stderr", streams[1])
    replace_unencodable()
    for stream in streams:
        assert stream.errors == PLAIN
        stream.write("(1.2 ± 0.1)×10⁻⁷ − ∞, ü, 数")
        stream.flush()
        assert stream.buffer.getvalue().decode(encoding) == expected  # type: ignore[attr-defined]


def test_a_stream_that_is_no_file_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    replace_unencodable()
    print("±")
    assert sys.stdout.getvalue() == "±\n"  # type: ignore[attr-defined]
