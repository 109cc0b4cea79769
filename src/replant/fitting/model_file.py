"""Model files: check of the target, writing, and reading, with a reason on failure."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, ClassVar, Self

from replant.errors import ModelFileError
from replant.fitting import model_json
from replant.fitting.model_json import LARGEST
from replant.numerics import operating_system
from replant.numerics.limits import file_path
from replant.numerics.operating_system import reason_of

AnyPath = str | os.PathLike[str]


class Written:
    """A model that can be written to a JSON file."""

    LAYOUT: ClassVar[int]

    def to_json(self) -> str:
        """Return the model as one JSON object, whose entries the page JSON describes.

        Raises
        ------
        InvalidArgumentError
            If the input map is a Python function, which no file can hold.
        """
        return json.dumps(self._as_object(), indent=2, allow_nan=False, ensure_ascii=False) + "\n"

    @classmethod
    def from_json(cls, written: str | bytes) -> Self:
        """Return the model that `to_json` has written, equal to the bit.

        Parameters
        ----------
        written : str or bytes
            What `to_json` has returned, or the content of a file of `save`.

        Raises
        ------
        ModelFileError
            If it is no such JSON, or of a newer version.
        """
        with model_json.in_one_line():
            return cls._of_object(model_json.parsed(written))

    def save(self, path: AnyPath) -> None:
        """Write the model as JSON; the file is never half-written.

        Parameters
        ----------
        path : path
            Of the file, which is replaced.

        Raises
        ------
        ModelFileError
            If the file cannot be written.
        InvalidArgumentError
            If the input map is a Python function.
        """
        written = self.to_json()
        check_target(path)
        try:
            with operating_system.replacing(Path(path).resolve()) as new:
                new.write_text(written, encoding="utf-8", newline="\n")
        except (OSError, ValueError, RuntimeError) as error:
            raise ModelFileError(f"{path}: the model could not be written ({reason_of(error)})") from error

    def _as_object(self) -> dict[str, Any]:
        return model_json.as_object(self)  # type: ignore[arg-type]

    @classmethod
    def _of_object(cls, read: Any) -> Self:
        model = cls(**model_json.fields_of(read, cls.LAYOUT))
        model_json.check_consistent(read, model)  # type: ignore[arg-type]
        return model


def check_target(path: AnyPath) -> None:
    """Check that a model may be written to a file: that it does not exist, or holds a model, and its folder exists."""
    path = file_path("path", path)
    try:
        file = Path(path).resolve()
        has_folder, exists, begin = file.parent.is_dir(), file.exists(), b""
        if file.is_file():
            with file.open("rb") as stream:
                begin = stream.read(LARGEST)
    except (OSError, ValueError, RuntimeError) as error:
        raise ModelFileError(f"{path}: the model could not be written ({reason_of(error)})") from error
    if not has_folder:
        raise ModelFileError(f"{path}: there is no folder {file.parent}")
    if exists and not _looks_like_model(begin):
        raise ModelFileError(f"{path}: it exists and is no model; give another name")


def holds_model(path: AnyPath) -> bool:
    """Return whether a file looks like a model that `save` has written; False if it cannot be read."""
    try:
        file = Path(path)
        return file.is_file() and _looks_like_model(file.read_bytes() if file.stat().st_size <= LARGEST else b"")
    except (OSError, ValueError):
        return False


def _looks_like_model(begin: bytes) -> bool:
    return b'"schema_version"' in begin and b'"den"' in begin  # of each row if there are several


def read(path: AnyPath) -> bytes:
    """Return the bytes of a file."""
    path = file_path("path", path)
    try:
        size = Path(path).stat().st_size if Path(path).is_file() else -1
        if 0 <= size <= LARGEST:
            return Path(path).read_bytes()
    except (OSError, ValueError) as error:
        raise ModelFileError(f"{path}: it cannot be read ({reason_of(error)})") from error
    missing = not Path(path).exists()
    raise ModelFileError(f"{path}: " + ("no such file" if missing else "it is no model that --save has written"))
