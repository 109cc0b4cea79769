"""A file that is whole or not there."""

import os
from pathlib import Path

import pytest

from replant.numerics.operating_system import replacing


def test_a_name_as_long_as_names_can_be(tmp_path: Path) -> None:
    path = tmp_path / ("n" * os.pathconf(tmp_path, "PC_NAME_MAX"))
    with replacing(path) as new:
        new.write_bytes(b"content")
    assert path.read_bytes() == b"content"
    assert list(tmp_path.iterdir()) == [path]


def test_after_an_error_the_file_before_is_there_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"before")

    def write_half() -> None:
        with replacing(path) as new:
            new.write_bytes(b"half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_half()
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_of_the_temporary_name_is_not_followed(tmp_path: Path) -> None:
    other, path = tmp_path / "other", tmp_path / "a"
    other.write_bytes(b"mine")
    with replacing(path) as new:
        name = new
    name.symlink_to(other)
    with replacing(path) as new:
        assert new == name
        new.write_bytes(b"content")
    assert (other.read_bytes(), path.read_bytes()) == (b"mine", b"content")
