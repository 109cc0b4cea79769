"""Results: those of a fleet, read from its folder (`Fleet`)."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from replant.errors import InvalidArgumentError, LogError
from replant.fleet.files import ABOUT, MODELS, TABLE
from replant.fleet.job import Job
from replant.fleet.store import column, read_table
from replant.identified.model import Model
from replant.limits import file_path
from replant.model.structure import Structure


@dataclass(frozen=True, eq=False)
class Fleet:
    """The results of a fleet.

    Attributes
    ----------
    folder : Path
        Holds ``rigs.parquet`` with one row a rig, ``models.jsonl``, ``timing.parquet`` and ``report.html``.
    structure : Structure
        Of all models.
    input_name, output_name : str
        The columns that were asked for.
    logs, by : str
        What was identified.
    job : Job or None
        How it was identified; None for results that were loaded.
    """

    folder: Path
    structure: Structure
    input_name: str = "u"
    output_name: str = "y"
    logs: str = ""
    by: str = ""
    job: Job | None = None

    def table(self) -> Any:
        """Return one row a rig as a `pyarrow.Table`, sorted by rig."""
        return read_table(self.folder, TABLE)

    def to_pandas(self) -> Any:
        """Return one row a rig as a `pandas.DataFrame`, sorted by rig."""
        return self.table().to_pandas()

    def __len__(self) -> int:
        return int(self.table().num_rows)

    @property
    def verdicts(self) -> dict[str, int]:
        """How many rigs have each verdict, the most frequent first; "failed" are those without a model."""
        counts = self.table().column("verdict").value_counts().to_pylist()
        return {
            each["values"]: each["counts"] for each in sorted(counts, key=lambda one: (-one["counts"], one["values"]))
        }

    def model(self, rig: str) -> Model:
        """Return the model of a rig.

        Parameters
        ----------
        rig : str

        Raises
        ------
        InvalidArgumentError
            If there is no such rig, or it has no model.
        """
        begin = f'{{"rig": {json.dumps(rig)}, "model": '
        with (self.folder / MODELS).open(encoding="utf-8") as lines:
            for line in lines:
                if line.startswith(begin):
                    return Model.from_json(line[len(begin) : -2])
        raise InvalidArgumentError(f"{self.folder}: no rig {rig!r} with a model")

    def column(self, name: str) -> Any:
        """Return a column of numbers (N,) as float64, in the order of the rigs; NaN where a figure is not known."""
        return column(self.table(), name)


def load(folder: str | Path) -> Fleet:
    """Return the results in a folder that `fit` or ``replant fleet --out`` has written.

    Raises
    ------
    LogError
        If there are none.

    Examples
    --------
    >>> load("no-such-folder")
    Traceback (most recent call last):
    replant.errors.LogError: no-such-folder: no results of `replant fleet` there (fleet.json cannot be read)
    """
    folder = file_path("folder", folder)
    try:
        about = json.loads(Path(folder, ABOUT).read_text(encoding="utf-8"))
        structure = Structure(**about["structure"])
        entered, given, logs, by = (str(about[name]) for name in ("input_name", "output_name", "logs", "by"))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise LogError(f"{folder}: no results of `replant fleet` there ({ABOUT} cannot be read)") from error
    return Fleet(Path(folder), structure, entered, given, logs, by)
