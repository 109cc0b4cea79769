"""The JSON of a model, of one input, several, or several outputs: one object, versioned, that rebuilds it to the bit.

Derived entries, as ``num``, ``den``, ``poles`` and each ``std``, are written for other programs; ``num``, ``den`` and
``delay`` are compared when the model is read.  With several inputs they are lists, in the order of the inputs.  With
several outputs the object has a list of rows, each the model of one output.
`schema/model-1.json`, `schema/model-2.json` and `schema/model-3.json` describe every entry.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from typing import Any

import numpy as np

from replant.errors import ArgumentTypeError, InvalidArgumentError, ModelFileError, ReplantError, shown
from replant.fitting.model_fields import ModelFields, Provenance, RowFields
from replant.model.noise import NoiseModel
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.numerics.linear_algebra import quiet
from replant.verdict.verdict import STATUSES, Verdict

# some thousand million times the precision of float64
ROUNDED = 1e-6  # difference that the rounding of a computation makes in a covariance [part]
LONGEST = 2**63  # whole numbers that are read are smaller [number]
LARGEST = 1 << 20  # longest text that is read as a model: a hundred times one of ten poles [characters]
LONGEST_REASON = 250  # longest reason why a text is no model [characters]
VERSION = 1  # version of the layout; raised when an entry changes its meaning or is removed [count]
OF_SEVERAL = 2  # version for several inputs, which has lists [count]
OF_OUTPUTS = 3  # version for several outputs, which has rows [count]
PER_INPUT = ("num", "den", "delay", "structure", "poles", "zeros", "dc_gain", "input")  # entries that are lists then

#: The fields of a structure and of where a model comes from, and the kinds of their entries.
STRUCTURE: dict[str, tuple[type, ...]] = {
    "poles": (int,),
    "zeros": (int,),
    "delay": (float, int),
    "bias": (bool,),
    "feedthrough": (bool,),
}
OF_PROVENANCE = ("method", "source", "sha256", "version", "date")


def rows_object(rows: Sequence[RowFields]) -> dict[str, Any]:
    """Return the rows of a model of several outputs as an object of JSON."""
    return {"schema_version": OF_OUTPUTS, "rows": [as_object(row) for row in rows]}


@quiet
def as_object(model: ModelFields | RowFields) -> dict[str, Any]:
    """Return a model as an object of JSON; unknown values are null."""
    known: Any = model.uncertainty
    if isinstance(model, ModelFields):
        if callable(model.input_map):
            raise InvalidArgumentError(
                "the input map is a Python function, which JSON cannot hold: "
                "map the input before the identification, or use input_map='square'"
            )
        layout, known = VERSION, known and (known,)
        inputs: list[dict[str, Any]] = [{"name": model.input_name, "map": model.input_map, "level": model.input_level}]
    else:
        layout, levels = OF_SEVERAL, zip(model.input_names, model.input_levels.tolist(), strict=True)
        inputs = [{"name": name, "level": level} for name, level in levels]
    plants = model.transfer_functions
    std = [value for each in known for value in each.std.tolist()] if known else [math.nan] * model.parameters.size
    noise = model.noise
    written: dict[str, Any] = {
        "schema_version": layout,
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
        "input": inputs,
        "output": {"name": model.output_name, "level": model.output_level},
        "noise": None if noise is None else vars(noise) | {"coefficients": noise.coefficients.tolist()},
        "fit": {"one_step": finite(model.one_step_fit), "simulated": finite(model.simulated_fit)},
        "samples": model.provenance.samples,
        "rejected": dict(model.rejected),
        "verdict": verdict_object(model.verdict),
        "provenance": {name: getattr(model.provenance, name) for name in OF_PROVENANCE},
    }
    return written | {name: written[name][0] for name in PER_INPUT} if layout == VERSION else written


#: What a file holds, and what reads it.
KINDS = {
    VERSION: "a model of one input: read it by load_model, or Model.from_json",
    OF_SEVERAL: "a model of several inputs: read it by load_model, or RowModel.from_json",
    OF_OUTPUTS: "a model of several outputs: read it by load_model, or MatrixModel.from_json",
}


def check_layout(read: Any, layout: int) -> None:
    """Check that an object of JSON has a layout."""
    if layout_of(read) != layout:
        raise ModelFileError(f"it holds {KINDS[layout_of(read)]}")


def check_consistent(read: dict[str, Any], model: ModelFields | RowFields) -> None:
    """Check that the entries for other programs agree with the model."""
    plants, single = model.transfer_functions, isinstance(model, ModelFields)
    for name in ("num", "den"):
        given = [read.get(name)] if single else _items(read, name, len(plants))
        pairs = [(each, getattr(g, name)) for each, g in zip(given, plants, strict=True)]
        if not all(_is_vector(each, own.size) and np.array_equal(_array(each), own) for each, own in pairs):
            raise ModelFileError(f"'{name}' contradicts 'parameters': change both, or neither")
    if ([real(read, "delay")] if single else read.get("delay")) != [g.delay for g in plants]:
        raise ModelFileError("'delay' contradicts 'structure': change both, or neither")


CHECKPOINT = b"\x89replant"  # the first bytes of a file of `Identifier.save`


def parsed(written: str | bytes) -> Any:
    """Return the content of a JSON text, without a check of its entries."""
    if not isinstance(written, str | bytes | bytearray):
        raise ArgumentTypeError(f"written must be the text of a model, got {type(written).__name__} {shown(written)}")
    if len(written) > LARGEST:
        raise ModelFileError(f"it has {len(written):,} characters, where a model has {LARGEST:,} at most")
    if isinstance(written, bytes) and written.startswith(CHECKPOINT):
        raise ModelFileError(
            "it is a checkpoint of an identifier; `replant.load` reads it, and `model` of that is its model"
        )
    try:
        read = json.loads(written, parse_constant=_refuse, object_pairs_hook=_without_repeats)
    except (ValueError, RecursionError) as error:  # also of bytes that are no text
        at = f"line {error.lineno}, column {error.colno}" if isinstance(error, json.JSONDecodeError) else str(error)
        raise ModelFileError(_in_one_line(f"it is no model that --save has written: it is not JSON: {at}")) from error
    return read


@contextmanager
def in_one_line() -> Iterator[None]:
    """Raise errors in the content of a model's JSON as a `ModelFileError` of one line."""
    try:
        yield
    except ReplantError as error:
        text = str(error) if isinstance(error, ModelFileError) else f"it holds no valid model: {error}"
        raise ModelFileError(_in_one_line(text)) from error


def _in_one_line(text: str) -> str:
    """Return a reason as one line of limited length, as it may quote a text of the file."""
    flat = " ".join(text.split())
    return flat if len(flat) <= LONGEST_REASON else flat[:LONGEST_REASON] + "..."


def layout_of(read: Any) -> int:
    """Return the version of an object of JSON, which this replant reads."""
    if not isinstance(read, dict) or not ("den" in read or "rows" in read):
        raise ModelFileError("it holds no model: an object with 'num', 'den' and 'parameters' is expected")
    if "schema_version" not in read:
        raise ModelFileError(
            "it has no 'schema_version', and so no working point and no sampling time: identify again with --save"
        )
    layout = entry(read, "schema_version", int)
    if layout > OF_OUTPUTS:
        raise ModelFileError(
            f"its layout has version {layout}, this replant reads up to version {OF_OUTPUTS}: "
            f"install a newer replant (this is {version('replant')})"
        )
    if layout < 1:
        raise ModelFileError(f"schema_version must be 1 or more, got {layout}")
    return int(layout)


def verdict_object(verdict: Verdict) -> dict[str, Any]:
    """Return a verdict as an object of JSON."""
    return {"status": verdict.status, "excited": verdict.excited, "reasons": list(verdict.reasons)}


def finite(value: float) -> float | None:
    """Return a figure for JSON: None if it is not finite."""
    return value if math.isfinite(value) else None


def fields_of(read: dict[str, Any], layout: int) -> dict[str, Any]:
    """Return the fields of the model in an object of JSON; unknown entries are ignored."""
    check_layout(read, layout)
    single = layout == VERSION
    if single:
        read = read | {name: [read[name]] for name in ("structure", "input") if name in read}
    structures = tuple(
        Structure(**{name: entry(shape, name, *kinds) for name, kinds in STRUCTURE.items()})
        for shape in _objects(read, "structure")
    )
    inputs = _objects(read, "input", len(structures))
    input_names = tuple(entry(each, "name", str) for each in inputs)
    levels = [real(each, "level") for each in inputs]
    pairs = zip(input_names, structures, strict=True)
    names = structures[0].names if single else [f"{of}.{name}" for name, each in pairs for of in each.names]
    values = entry(read, "parameters", dict)
    if set(values) != set(names):
        raise ModelFileError(f"'parameters' must be {', '.join(names)}, got {', '.join(values) or 'none'}")
    given, fits, source = entry(read, "output", dict), entry(read, "fit", dict), entry(read, "provenance", dict)
    shared = {
        "parameters": np.array([real(entry(values, name, dict), "value") for name in names]),
        "dt": real(read, "dt"),
        "covariance": matrix_of(read.get("covariance"), len(names)),
        "noise": noise_of(read.get("noise")),
        "input_hold": entry(read, "input_hold", str),
        "output_level": real(given, "level"),
        "output_name": entry(given, "name", str),
        "simulated_fit": perhaps(fits, "simulated"),
        "one_step_fit": perhaps(fits, "one_step"),
        "verdict": verdict_of(entry(read, "verdict", dict)),
        "provenance": Provenance(
            samples=entry(read, "samples", int), **{name: entry(source, name, str) for name in OF_PROVENANCE}
        ),
    }
    if single:
        shared |= {"structure": structures[0], "input_level": levels[0], "input_name": input_names[0]}
        shared["input_map"] = entry(inputs[0], "map", str)
    else:
        shared |= {"structures": structures, "input_names": input_names, "input_levels": np.array(levels)}
    # older files of several inputs have none
    return shared | {"rejected": tuple(entry(read if single else {"rejected": {}} | read, "rejected", dict).items())}


def _objects(read: dict[str, Any], name: str, count: int | None = None) -> list[dict[str, Any]]:
    return [entry({name: each}, name, dict) for each in _items(read, name, count)]


def _items(read: dict[str, Any], name: str, count: int | None = None) -> list[Any]:
    """Return a list that has an item for each input."""
    items = entry(read, name, list)
    if not items or (count is not None and len(items) != count):
        raise ModelFileError(f"the entry '{name}' must have an item for each input")
    return list(items)


def entry(where: dict[str, Any], name: str, *kinds: type) -> Any:
    """Return an entry of one of these kinds."""
    if name not in where:
        raise ModelFileError(f"the entry '{name}' is missing")
    value = where[name]
    if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
        wanted = " or ".join(JSON_KINDS[kind] for kind in kinds)
        raise ModelFileError(f"the entry '{name}' must be {wanted}, got {json.dumps(value)[:40]}")
    if isinstance(value, int) and not abs(value) < LONGEST and float not in kinds:
        raise ModelFileError(f"the entry '{name}' is too large")
    return value


JSON_KINDS: dict[type, str] = {
    int: "a whole number",
    float: "a number",
    str: "a text",
    bool: "true or false",
    dict: "an object",
    list: "a list",
}


def real(where: dict[str, Any], name: str) -> float:
    """Return an entry that is a number."""
    try:
        return float(entry(where, name, float, int))
    except OverflowError as error:
        raise ModelFileError(f"the entry '{name}' is too large for float64") from error


def perhaps(where: dict[str, Any], name: str) -> float:
    """Return an entry that is a number; NaN if unknown."""
    return math.nan if where.get(name) is None else real(where, name)


def _array(values: Any) -> FloatArray:
    try:
        return np.array(values, np.float64)
    except OverflowError as error:
        raise ModelFileError("a number is too large for float64") from error


def matrix_of(read: Any, size: int) -> FloatArray | None:
    """Return a covariance, checked."""
    if read is None:
        return None
    rows = read if isinstance(read, list) else []
    if len(rows) != size or not all(_is_vector(row, size) for row in rows):
        raise ModelFileError(f"the entry 'covariance' must be {size} lists of {size} numbers, or null")
    matrix = _array(rows)
    # a variance below the smallest number is written as 0, but its row may hold covariances that are not
    spread = np.sqrt(np.maximum(np.diag(matrix), np.finfo(np.float64).tiny))
    bound = spread * spread[:, None]
    uneven = np.abs(matrix - matrix.T) > ROUNDED * bound
    if (np.diag(matrix) < 0.0).any() or uneven.any() or (np.abs(matrix) > (1.0 + ROUNDED) * bound).any():
        raise ModelFileError("the entry 'covariance' is not valid: a variance below 0, or rows and columns that differ")
    return matrix


def _is_vector(read: Any, size: int | None = None) -> bool:
    fits = isinstance(read, list) and (len(read) == size or size is None)
    return fits and all(isinstance(value, float | int) and not isinstance(value, bool) for value in read)


def noise_of(read: Any) -> NoiseModel | None:
    """Return the noise model in an object of JSON."""
    if read is None:
        return None
    where = entry({"noise": read}, "noise", dict)
    coefficients = entry(where, "coefficients", list)
    if not _is_vector(coefficients):
        raise ModelFileError("the entry 'coefficients' of the noise must be a list of numbers")
    numbers = {name: real(where, name) for name in ("variance", "residual_variance", "dt")}
    return NoiseModel(_array(coefficients), **numbers)


def verdict_of(where: dict[str, Any]) -> Verdict:
    """Return the verdict in an object of JSON."""
    status, reasons = entry(where, "status", str), entry(where, "reasons", list)
    if status not in STATUSES:
        raise ModelFileError(f"the verdict's status must be one of {', '.join(STATUSES)}, got {status!r}")
    if not all(isinstance(reason, str) for reason in reasons):
        raise ModelFileError("the verdict's reasons must be texts")
    return Verdict(status, tuple(reasons), entry(where, "excited", bool))


def pole_object(pole: complex) -> dict[str, Any]:
    """Return a pole as an object of JSON."""
    magnitude = math.hypot(pole.real, pole.imag)  # abs() raises on overflow
    return {
        "real": finite(pole.real),
        "imag": finite(pole.imag),
        "frequency_hz": finite(magnitude / (2 * math.pi)),
        "damping": finite(-pole.real / magnitude) if magnitude else None,
        "time_constant": finite(-1.0 / pole.real) if pole.real else None,
    }


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    read = dict(pairs)
    if len(read) < len(pairs):
        ((name, _),) = Counter(name for name, _ in pairs).most_common(1)
        raise ValueError(f"the entry {name[:40]!r} comes twice")
    return read


def _refuse(constant: str) -> Any:
    raise ValueError(f"{constant} is no number of JSON")
