"""Exact conversion of settings to plain JSON and back: numbers to the bit, objects by the name of their class."""

from __future__ import annotations

import dataclasses
import math
import warnings
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError
from replant.estimation.filters import FILTERS
from replant.estimation.optimizers import OPTIMIZERS
from replant.estimation.optimizers.optimizer import Replay
from replant.estimation.settings import Request, Scaling, Settings
from replant.model.preprocess import Preprocess
from replant.model.structure import Structure

#: The classes of the objects in settings, by name; filters and optimizers come from their own registries.
_KINDS = Request, Settings, Structure, Scaling, Replay, Preprocess, *FILTERS, *OPTIMIZERS.values()
KINDS: dict[str, type] = {kind.__name__: kind for kind in _KINDS}

#: The floats that JSON cannot express.
UNUSUAL = {"inf": math.inf, "-inf": -math.inf, "nan": math.nan}
#: The NumPy types that can be stored.
NUMBERS = ("|b1", "|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f2", "<f4", "<f8")


def to_plain(name: str, value: Any) -> Any:
    """Return ``value`` as JSON values; a value that JSON cannot express becomes an object with one tag."""
    kind = type(value)
    if value is None or kind in (bool, int, str):
        return value
    if kind is float:
        return value if math.isfinite(value) else {"float": repr(value)}
    if kind is list:
        return [to_plain(f"{name}[{i}]", entry) for i, entry in enumerate(value)]
    if kind is tuple:
        return {"tuple": [to_plain(f"{name}[{i}]", entry) for i, entry in enumerate(value)]}
    if kind is dict:
        return {"dict": [[key, to_plain(f"{name}[{key!r}]", entry)] for key, entry in value.items()]}
    if isinstance(value, np.generic | np.ndarray) and value.dtype.kind in "fiub" and value.dtype.itemsize <= 8:
        little = np.asarray(value).astype(value.dtype.newbyteorder("<"))
        return {"numpy": [little.dtype.str, list(value.shape), little.tobytes().hex()]}
    if KINDS.get(kind.__name__) is kind:
        fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        inside = f"{name}." if name else ""
        return {kind.__name__: {key: to_plain(f"{inside}{key}", entry) for key, entry in fields.items()}}
    raise InvalidArgumentError(f"{name} cannot be stored in a checkpoint: {_reason(name, value)}")


def _reason(name: str, value: Any) -> str:
    if callable(value):
        called = getattr(value, "__name__", type(value).__name__)
        remedy = "map the input before the identifier" if name.endswith("input_map") else "give a value"
        return f"{called} is a function, and code is not stored; {remedy} instead"
    return f"it is a {type(value).__name__}, and only replant's own objects, numbers, lists and NumPy arrays are stored"


def from_plain(plain: Any) -> Any:
    """Return the value that `to_plain` has converted."""
    if isinstance(plain, list):
        return [from_plain(entry) for entry in plain]
    if not isinstance(plain, dict):
        return plain
    ((tag, inner),) = plain.items()
    if tag == "float":
        return UNUSUAL[inner]
    if tag in ("tuple", "dict") and not isinstance(inner, list):
        raise TypeError(f"a {tag} is no {type(inner).__name__}")
    if tag == "tuple":
        return tuple(from_plain(entry) for entry in inner)
    if tag == "dict":
        return {key: from_plain(entry) for key, entry in inner}
    if tag == "numpy":
        return _numbers(*inner)
    kind = KINDS.get(tag)
    if kind is None:
        raise ValueError(f"there is no {tag}")
    fields = {key: from_plain(entry) for key, entry in inner.items()}
    if set(fields) != {field.name for field in dataclasses.fields(kind)}:
        raise ValueError(f"{tag} has other settings here")
    with warnings.catch_warnings():  # the user was warned when the settings were chosen
        warnings.simplefilter("ignore")
        built = kind(**fields)  # raises for invalid values
    for key, entry in fields.items():
        if isinstance(entry, bool) and not isinstance(getattr(built, key), bool):
            raise TypeError(f"{key} is a truth value")
    return built


def _numbers(dtype: str, shape: list[int], digits: str) -> Any:
    if dtype not in NUMBERS:
        raise ValueError(f"{dtype} is no kind of number")
    kind = np.dtype(dtype)
    values = np.frombuffer(bytes.fromhex(digits), kind).reshape(shape)
    return values.astype(kind.newbyteorder("="))[()]  # [()]: a number stays a number
