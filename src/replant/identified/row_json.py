"""The JSON of a model of several inputs: as that of one, with lists in the order of the inputs."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from replant.errors import ModelFileError
from replant.identified.model_json import (
    OF_SEVERAL,
    STRUCTURE,
    entry,
    finite,
    in_one_line,
    layout_of,
    matrix_of,
    noise_object,
    noise_of,
    parsed,
    perhaps,
    pole_object,
    real,
    same,
    verdict_object,
    verdict_of,
)
from replant.identified.provenance import Provenance
from replant.identified.row_fields import RowFields
from replant.model.structure import Structure
from replant.statistics.linear_algebra import quiet

OF_PROVENANCE = ("method", "source", "sha256", "version", "date")


def dumps(model: RowFields) -> str:
    """Return a model as JSON, indented."""
    return json.dumps(as_object(model), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


@quiet
def as_object(model: RowFields) -> dict[str, Any]:
    """Return a model as an object of JSON; what is not known is null.

    >>> as_object(RowFields((Structure(1), Structure(1, delay=0.5)), [1.0, 2.0, 3.0, 4.0], dt=0.1))["den"]
    [[1.0, 1.0], [1.0, 3.0]]
    """
    plants, known = model.transfer_functions, model.uncertainty
    std = [math.nan] * model.parameters.size
    if known is not None:
        std = [value for each in known for value in each.std.tolist()]
    levels = zip(model.input_names, model.input_levels.tolist(), strict=True)
    return {
        "schema_version": OF_SEVERAL,
        "num": [g.num.tolist() for g in plants],
        "den": [g.den.tolist() for g in plants],
        "delay": [g.delay for g in plants],
        "structure": [{name: getattr(each, name) for name in STRUCTURE} for each in model.structures],
        "parameters": {
            name: {"value": value, "std": finite(each)}
            for name, value, each in zip(model.names, model.parameters.tolist(), std, strict=True)
        },
        "covariance": None if model.covariance is None else model.covariance.tolist(),
        "poles": [[pole_object(pole) for pole in g.poles.tolist()] for g in plants],
        "zeros": [[{"real": finite(z.real), "imag": finite(z.imag)} for z in g.zeros.tolist()] for g in plants],
        "dc_gain": [finite(g.dc_gain) for g in plants],
        "dt": model.dt,
        "input_hold": model.input_hold,
        "input": [{"name": name, "level": level} for name, level in levels],
        "output": {"name": model.output_name, "level": model.output_level},
        "noise": None if model.noise is None else noise_object(model.noise),
        "fit": {"one_step": finite(model.one_step_fit), "simulated": finite(model.simulated_fit)},
        "samples": model.provenance.samples,
        "verdict": verdict_object(model.verdict),
        "provenance": {name: getattr(model.provenance, name) for name in OF_PROVENANCE},
    }


def is_row(written: str | bytes) -> bool:
    """Return whether a JSON text holds a model of several inputs."""
    with in_one_line():
        return layout_of(parsed(written)) == OF_SEVERAL


def loads(written: str | bytes) -> dict[str, Any]:
    """Return the fields of the model in a JSON text."""
    with in_one_line():
        read = parsed(written)
        if layout_of(read) != OF_SEVERAL:
            raise ModelFileError("it holds a model of one input: read it by load_model, or Model.from_json")
        found = _fields(read)
        model = RowFields(**found)
        for name in ("num", "den"):
            expected = [getattr(g, name) for g in model.transfer_functions]
            pairs = zip(_items(read, name, len(expected)), expected, strict=True)
            if not all(same(given, wanted) for given, wanted in pairs):
                raise ModelFileError(f"'{name}' contradicts 'parameters': change both, or neither")
        if read.get("delay") != [each.delay for each in model.structures]:
            raise ModelFileError("'delay' contradicts 'structure': change both, or neither")
        return found


def _items(read: dict[str, Any], name: str, count: int | None = None) -> list[Any]:
    """Return a list that has an item for each input."""
    items = entry(read, name, list)
    if not items or (count is not None and len(items) != count):
        raise ModelFileError(f"the entry '{name}' must have an item for each input")
    return list(items)


def _fields(read: dict[str, Any]) -> dict[str, Any]:
    shapes = [entry({"structure": each}, "structure", dict) for each in _items(read, "structure")]
    structures = tuple(
        Structure(**{name: entry(each, name, *STRUCTURE[name]) for name in STRUCTURE}) for each in shapes
    )
    inputs = [entry({"input": each}, "input", dict) for each in _items(read, "input", len(structures))]
    names = tuple(entry(each, "name", str) for each in inputs)
    values = entry(read, "parameters", dict)
    wanted = [f"{parameter}.{name}" for name, each in zip(names, structures, strict=True) for parameter in each.names]
    if set(values) != set(wanted):
        raise ModelFileError(f"'parameters' must be {', '.join(wanted)}, got {', '.join(values) or 'none'}")
    given, fits = entry(read, "output", dict), entry(read, "fit", dict)
    source = entry(read, "provenance", dict)
    return {
        "structures": structures,
        "parameters": np.array([real(entry(values, name, dict), "value") for name in wanted]),
        "dt": real(read, "dt"),
        "covariance": matrix_of(read.get("covariance"), len(wanted)),
        "noise": noise_of(read.get("noise")),
        "input_hold": entry(read, "input_hold", str),
        "input_names": names,
        "output_name": entry(given, "name", str),
        "input_levels": np.array([real(each, "level") for each in inputs]),
        "output_level": real(given, "level"),
        "simulated_fit": perhaps(fits, "simulated"),
        "one_step_fit": perhaps(fits, "one_step"),
        "verdict": verdict_of(entry(read, "verdict", dict)),
        "provenance": Provenance(
            samples=entry(read, "samples", int),
            **{name: entry(source, name, str) for name in OF_PROVENANCE},
        ),
    }
