"""What the system refuses, in one line with what to do about it; files written as a whole; threads."""

from __future__ import annotations

import errno
from pathlib import Path

from replant.numerics.operating_system import Worker, one_line, reason_of, refusal, replacing
from support.cases import every

FULL = OSError(errno.ENOSPC, "No space left on device", "a/b")
WORDS = [
    (reason_of(FULL), "No space left on device"),
    (reason_of(MemoryError()), "out of memory"),
    (one_line(FULL), "No space left on device: 'a/b'"),
    (refusal(OSError(errno.EMFILE, "Too many open files")),
     "Too many open files; raise the limit on open files (ulimit -n)"),
    (refusal(MemoryError()), "out of memory; free memory, or raise its limit (ulimit -v)"),
    (refusal(ValueError("invalid")), None),
]  # fmt: skip


@every("got, expected", WORDS)
def test_words(got: str | None, expected: str | None) -> None:
    assert got == expected


def test_a_file_is_replaced_as_a_whole(tmp_path: Path) -> None:
    with replacing(tmp_path / "a") as new:
        new.write_bytes(b"content")
        assert not (tmp_path / "a").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_a_thread_is_joined() -> None:
    done: list[bool] = []
    worker = Worker(lambda: done.append(True))
    worker.start()
    worker.join()
    assert done == [True]
