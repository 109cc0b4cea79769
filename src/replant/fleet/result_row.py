"""Result row: what is kept of a rig, and the columns of the table of results."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from replant.arguments import FloatArray
from replant.fleet.printable import printable
from replant.fleet.watched_record import UNKNOWN, Movement
from replant.identified.model import Model
from replant.model.structure import Structure

FAILED = "failed"  # what stands in place of the verdict where a rig could not be identified


@dataclass(frozen=True, eq=False)
class Row:
    """What is kept of a rig.

    Attributes
    ----------
    rig : str
    verdict : str
        The status, or `FAILED`.
    reasons : tuple of str
    source : str
        Its first file, from the folder of all logs on.
    files : int
    model : Model or None
    samples : int
    rejected : tuple of (str, int)
        Samples left out, by reason.
    begin, end : float
        Time of the first and of the last sample in s; dates of Parquet files since 1970.
    movement : Movement
    notes : tuple of str
        What is to be known of the files, such as a line that was left out.
    seconds : float
        How long it took.
    """

    rig: str
    verdict: str
    reasons: tuple[str, ...]
    source: str
    files: int
    model: Model | None = None
    samples: int = 0
    rejected: tuple[tuple[str, int], ...] = ()
    begin: float = math.nan
    end: float = math.nan
    movement: Movement = UNKNOWN
    notes: tuple[str, ...] = ()
    seconds: float = 0.0


def table_of(rows: Sequence[Row], structure: Structure) -> Any:
    """Return rows as a `pyarrow.Table`: the columns of `schema`, the model's JSON, and the seconds that each took."""
    import pyarrow

    columns: dict[str, list[Any]] = {field.name: [] for field in schema(structure)} | {"model": [], "seconds": []}
    for row in rows:
        cells = _cells(row, structure)
        for name, values in columns.items():
            values.append(cells.get(name))
    return pyarrow.table(columns, schema=part_schema(structure))


def schema(structure: Structure) -> Any:
    """Return the columns of the table of results as a `pyarrow.Schema`.

    Examples
    --------
    >>> [name for name in schema(Structure(1)).names if "b0" in name or "pole" in name]
    ['b0', 'b0_std', 'pole1_real', 'pole1_imag']
    """
    import pyarrow

    text, number, count = pyarrow.string(), pyarrow.float64(), pyarrow.int64()
    fields = [("rig", text), ("verdict", text), ("reasons", text)]
    fields += [(each, number) for name in structure.names for each in (name, f"{name}_std")]
    fields += [(f"pole{k}_{part}", number) for k in range(1, structure.poles + 1) for part in ("real", "imag")]
    fields += [(name, number) for name in ("damping", "dc_gain", "dc_gain_std", "fit", "fit_one_step", "dt")]
    fields += [("samples", count), ("rejected", count), ("rejected_why", text)]
    fields += [(name, number) for name in ("begin", "end", "input_std", "output_std", "output_held")]
    fields += [("source", text), ("files", count), ("notes", text), ("covariance", pyarrow.list_(number))]
    return pyarrow.schema(fields)


def part_schema(structure: Structure) -> Any:
    """Return the columns of a task's part of the results."""
    import pyarrow

    return schema(structure).append(pyarrow.field("model", pyarrow.string())).append(
        pyarrow.field("seconds", pyarrow.float64())
    )  # fmt: skip


def _cells(row: Row, structure: Structure) -> dict[str, Any]:
    """Return the cells of a row by column; a figure that is not known is left out."""
    numbers: dict[str, float] = {"begin": row.begin, "end": row.end, **vars(row.movement)}
    cells: dict[str, Any] = {
        "rig": row.rig, "verdict": row.verdict, "reasons": printable("; ".join(row.reasons)), "source": row.source,
        "files": row.files, "notes": printable("; ".join(row.notes)), "samples": row.samples,
        "rejected": sum(count for _, count in row.rejected),
        "rejected_why": ", ".join(f"{count} {why}" for why, count in row.rejected if count), "seconds": row.seconds,
    }  # fmt: skip
    if row.model is not None:
        cells |= {"model": _one_line(row.model), "covariance": _flat(row.model.covariance)}
        numbers |= _figures(row.model, structure)
    return cells | {name: value for name, value in numbers.items() if math.isfinite(value)}


def _one_line(model: Model) -> str:
    return json.dumps(json.loads(model.to_json()), ensure_ascii=False)


def _flat(covariance: FloatArray | None) -> list[float] | None:
    return None if covariance is None else covariance.ravel().tolist()


def _figures(model: Model, structure: Structure) -> dict[str, float]:
    known, transfer = model.uncertainty, model.transfer_function
    found = dict(zip(structure.names, model.parameters.tolist(), strict=True))
    if known is not None:
        found |= {f"{name}_std": std for name, std in zip(structure.names, known.std.tolist(), strict=True)}
        found["dc_gain_std"] = known.dc_gain_std
    poles = sorted(transfer.poles.tolist(), key=lambda pole: (abs(pole), pole.real, pole.imag))
    for k, pole in enumerate(poles, 1):
        found |= {f"pole{k}_real": complex(pole).real, f"pole{k}_imag": complex(pole).imag}
    with np.errstate(all="ignore"):
        found["dc_gain"] = float(transfer.dc_gain)
    found["damping"] = min(mode.damping for mode in transfer.modes)
    return found | {"fit": model.simulated_fit, "fit_one_step": model.one_step_fit, "dt": model.dt}
