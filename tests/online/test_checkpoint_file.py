"""Files that are whole at every moment: a process that dies at any step, a disk that fails at any step."""

from __future__ import annotations

import errno
import io
import os
import resource
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from replant.errors import CheckpointError, MissingCheckpointError
from replant.online import checkpoint_file as files
from support.cases import every

FIRST, SECOND, THIRD, LAST = (bytes([n]) * 5_000 for n in range(1, 5))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Return a file that was written twice."""
    file = tmp_path / "rig.checkpoint"
    files.write(file, FIRST)
    files.write(file, SECOND)
    return file


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def assert_clean(file: Path, now: bytes, before: bytes) -> None:
    assert file.read_bytes() == now
    assert files.previous(file).read_bytes() == before
    assert names(file.parent) == {file.name, f"{file.name}.previous"}


class Died(BaseException):
    """The process is dead: nothing that it would do follows, not even in ``finally``."""


@contextmanager
def system(act: Callable[[int, str], None]) -> Iterator[list[str]]:
    """Call ``act(number, name)`` before each call into the system that changes a disk; yields the names so far."""
    calls: list[str] = []

    def watched(name: str, original: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            if name == "open" and (arguments[1:2] or ("r",))[0] in ("r", "rb"):
                return original(*arguments, **options)
            calls.append(name)
            if name == "fsync" and os.fstat(arguments[0]).st_size == len(THIRD):
                with unfinished(arguments[0]):  # until it is synced, what was written may be there in part
                    act(len(calls) - 1, name)
            else:
                act(len(calls) - 1, name)
            return original(*arguments, **options)

        return call

    with pytest.MonkeyPatch.context() as patch:
        for owner, name in ((os, "link"), (os, "replace"), (os, "unlink"), (os, "fsync"), (io, "open")):
            patch.setattr(owner, name, watched(name, getattr(owner, name)))
        yield calls


@contextmanager
def unfinished(descriptor: int) -> Iterator[None]:
    try:
        yield
    except Died:
        os.ftruncate(descriptor, len(THIRD) // 2)
        raise


def dies_at(step: int) -> Callable[[int, str], None]:
    def act(number: int, name: str) -> None:
        if number >= step:
            raise Died

    return act


def fails_at(step: int, code: int) -> Callable[[int, str], None]:
    def act(number: int, name: str) -> None:
        if number == step:
            raise OSError(code, os.strerror(code))

    return act


def fails_to_link(number: int, name: str) -> None:
    if name == "link":
        raise PermissionError(errno.EPERM, "no second names on this disk")


def steps(file: Path, linking: bool = True) -> int:
    """How many calls into the system a write takes."""
    with system(lambda number, name: None if linking else fails_to_link(number, name)) as calls:
        files.write(file, SECOND)
    return len(calls)


def restored(file: Path) -> None:
    files.write(file, FIRST)
    files.write(file, SECOND)


@pytest.mark.parametrize("linking", [True, False], ids=["linking", "copying"])
def test_dying_at_any_step_leaves_whole_files(file: Path, linking: bool) -> None:
    found = set()
    for step in range(steps(file, linking)):
        restored(file)

        def act(number: int, name: str, step: int = step) -> None:
            dies_at(step)(number, name)
            if not linking:
                fails_to_link(number, name)

        with system(act), pytest.raises(Died):
            files.write(file, THIRD)
        now, before = file.read_bytes(), files.previous(file).read_bytes()
        assert (now, before) in {(SECOND, FIRST), (THIRD, FIRST), (THIRD, SECOND)}, f"step {step}"
        found.add((now, before))
        files.write(file, LAST)  # whatever is left there does not disturb
        assert_clean(file, LAST, now)
    assert len(found) == 3


def test_dying_at_any_step_while_the_file_is_damaged_leaves_one_whole(file: Path) -> None:
    for step in range(steps(file)):
        restored(file)
        file.write_bytes(b"damaged")
        with system(dies_at(step)), pytest.raises(Died):
            files.write(file, THIRD)
        assert file.read_bytes() == THIRD or files.previous(file).read_bytes() == FIRST, f"step {step}"


def test_dying_at_any_step_of_the_first_writing_leaves_nothing_or_all(tmp_path: Path) -> None:
    for step in range(6):
        file = tmp_path / f"{step}"
        with system(dies_at(step)), pytest.raises(Died):
            files.write(file, THIRD)
        assert not file.exists() or file.read_bytes() == THIRD
        assert not files.previous(file).exists()


@every("code", [errno.ENOSPC, errno.EIO, errno.EROFS, errno.EDQUOT], ids=errno.errorcode.get)
def test_failing_at_any_step_is_one_error_and_leaves_whole_files(file: Path, code: int) -> None:
    refusals = []
    for step in range(steps(file)):
        restored(file)
        with system(fails_at(step, code)) as calls:
            try:
                files.write(file, THIRD)
            except CheckpointError as error:
                refusals.append(str(error))
            else:
                assert file.read_bytes() == THIRD
                assert calls[step] in ("link", "unlink")  # copied instead; cleared next time
        assert file.read_bytes() in (SECOND, THIRD)
        assert files.previous(file).read_bytes() in (FIRST, SECOND)
        files.write(file, LAST)
        assert names(file.parent) == {file.name, f"{file.name}.previous"}
    assert set(refusals) == {f"{file}: the checkpoint could not be written ({os.strerror(code)})"}
    assert len(refusals) >= 5


def test_the_new_file_is_on_the_disk_before_it_takes_the_place_and_that_before_the_previous_one_goes(
    file: Path,
) -> None:
    with system(lambda number, name: None) as calls:
        files.write(file, THIRD)
    order = [name for name in calls if name not in ("unlink", "link")]
    assert order == ["open", "fsync", "replace", "fsync", "replace"]
    assert_clean(file, THIRD, SECOND)


def test_without_second_names_the_previous_one_is_copied(file: Path) -> None:
    with system(fails_to_link):
        files.write(file, THIRD)
    assert_clean(file, THIRD, SECOND)


def test_what_killed_processes_left_is_cleared(file: Path) -> None:
    for ending in (".new", ".old"):
        Path(f"{file}{ending}").write_bytes(b"half")
    files.write(file, THIRD)
    assert_clean(file, THIRD, SECOND)


# --- the real system's refusals


@contextmanager
def limited(size: int) -> Iterator[None]:
    """No file may grow beyond ``size``: the system refuses in the middle of writing, as it does on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_disk_that_is_full_in_the_middle(file: Path) -> None:
    with limited(3_000), pytest.raises(CheckpointError, match="could not be written"):
        files.write(file, THIRD)
    assert_clean(file, SECOND, FIRST)
    files.write(file, THIRD)
    assert_clean(file, THIRD, SECOND)


@contextmanager
def unprivileged() -> Iterator[None]:
    """As nobody, where the tests run as root, whom no permission stops."""
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)


def test_a_folder_that_may_not_be_written() -> None:
    with tempfile.TemporaryDirectory() as name:
        file = Path(name, "rig.checkpoint")
        restored(file)
        Path(name).chmod(0o555)
        try:
            with unprivileged(), pytest.raises(CheckpointError, match="Permission denied"):
                files.write(file, THIRD)
            assert_clean(file, SECOND, FIRST)
        finally:
            Path(name).chmod(0o700)


def test_a_folder_that_is_gone(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="No such file or directory"):
        files.write(tmp_path / "gone" / "rig", FIRST)


@every("name", ["", "/dev/null", "/proc/rig.checkpoint", "x" * 300, "a\0b", "file/below"])
def test_names_that_cannot_be_written(name: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(CheckpointError) as caught:
        files.write(tmp_path / name, FIRST)
    assert "\n" not in str(caught.value)
    assert Path("/dev/null").is_char_device()


def test_a_link_stays_one(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    link = tmp_path / "rig"
    link.symlink_to("disk/rig")
    for data in (FIRST, SECOND):
        files.write(link, data)
    assert link.is_symlink()
    assert_clean(tmp_path / "disk" / "rig", SECOND, FIRST)
    assert files.previous(link).read_bytes() == FIRST


def test_reading(tmp_path: Path, file: Path) -> None:
    assert files.read(file) == files.read(str(file)) == SECOND
    with pytest.raises(MissingCheckpointError, match="no such file"):
        files.read(tmp_path / "other")
    with pytest.raises(CheckpointError, match="a directory"):
        files.read(tmp_path)
    with pytest.raises(CheckpointError, match="cannot be read"):
        files.read("a\0b")
    with pytest.raises(CheckpointError, match="not a checkpoint"):
        files.read("/dev/zero")
    os.mkfifo(tmp_path / "pipe")  # which would block
    with pytest.raises(CheckpointError, match="not a checkpoint"):
        files.read(tmp_path / "pipe")
    with pytest.raises(CheckpointError, match="not that of a regular file"):
        files.write(tmp_path / "pipe", FIRST)
