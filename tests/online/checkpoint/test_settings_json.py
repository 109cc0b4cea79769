"""Settings in JSON: every value comes back as it was, to the bit and to the type; what cannot be told is refused."""

from __future__ import annotations

import json
import math
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import replant as rp
from replant.estimation.optimizers import OPTIMIZERS
from replant.online.checkpoint.settings_json import KINDS, from_plain, to_plain
from support.builders import Thing
from support.cases import every


def round_trip(value: Any) -> Any:
    return from_plain(json.loads(json.dumps(to_plain("value", value), allow_nan=False)))


def identical(one: Any, other: Any) -> bool:
    if isinstance(one, float) and type(one) is type(other):
        return struct.pack("<d", one) == struct.pack("<d", other) or (math.isnan(one) and math.isnan(other))
    if isinstance(one, list | tuple):
        return type(one) is type(other) and len(one) == len(other) and all(map(identical, one, other))
    return type(one) is type(other) and bool(one == other)


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.lists(inner).map(tuple),
)


def test_settings_in_plain_words() -> None:
    assert to_plain("replay", rp.Replay(seed=3)) == {
        "Replay": {"capacity": 20000, "batch_size": 20, "warmup": 20, "seed": 3}
    }
    assert to_plain("limits", (0.5, np.inf)) == {"tuple": [0.5, {"float": "inf"}]}
    plain = {"Structure": {"poles": 2, "zeros": 1, "delay": 0.0, "bias": False, "feedthrough": False}}
    assert from_plain(plain) == rp.Structure(2, 1)


@given(PLAIN)
def test_numbers_words_lists_and_tuples(value: Any) -> None:
    assert identical(round_trip(value), value)


@given(st.dictionaries(st.text(), st.integers()))
def test_dictionaries_keep_their_order(value: dict[str, int]) -> None:
    assert list(round_trip(value).items()) == list(value.items())


@every("kind", OPTIMIZERS.values(), ids=OPTIMIZERS)
def test_every_optimizer(kind: Any) -> None:
    assert round_trip(kind.suggested(1e-3, 5_000)) == kind.suggested(1e-3, 5_000)


@every(
    "value",
    [
        rp.Structure(3, 3, 0.1, True, True),
        rp.StateVariableFilter(denominator=[1.0, 3.0, 2.0], input_hold="foh"),
        rp.StateVariableFilter(denominator=(1, 3, 2)),
        rp.StateVariableFilter(cutoff=0.1 + 0.2),
        rp.RefinedFilter("foh"),
        rp.Scaling(1e-300, (math.nextafter(1.0, 2.0), 5e-324)),
        rp.Replay(7, 3, 2, 2**63 - 1),
        rp.Preprocess("square", "first", -0.0),
        rp.KalmanTracking([0.1, 3.0]),
    ],
    ids=str,
)
def test_every_setting(value: Any) -> None:
    assert round_trip(value) == value
    assert repr(round_trip(value)) == repr(value)


@every("dtype", ["f4", "f8", ">f8", "i4", "u8", "?"])
def test_numpys_numbers_and_arrays(dtype: str) -> None:
    values = np.array([[0.1, 1.0, 0.0], [7.3, 2.0, 1.0]]).astype(dtype)
    loaded = round_trip(values)
    assert loaded.dtype == values.dtype.newbyteorder("=")
    np.testing.assert_array_equal(loaded, values)
    assert loaded.flags.writeable
    scalar = values[0, 0]
    assert type(round_trip(scalar)) is type(scalar)
    assert round_trip(scalar) == scalar


def test_a_warning_that_was_given_is_not_repeated() -> None:
    with pytest.warns(UserWarning, match="rings"):
        ident = rp.Identifier(
            rp.Structure(1), 1.0, filter=rp.StateVariableFilter(3.0, method="gbt"), optimizer=rp.Gradient(0.1)
        )
    rp.Identifier.from_bytes(ident.to_bytes())


def squared(u: Any) -> Any:
    return u * u


@dataclass(frozen=True)
class Own(rp.Gradient):
    """An optimizer of the user's."""


#: Another class under a name that is known.
Gradient = dataclass(frozen=True)(type("Gradient", (rp.Gradient,), {"__annotations__": {}}))


@every(
    ("changes", "words"),
    [
        ({"preprocess": rp.Preprocess(squared)}, "preprocess.input_map cannot be stored in a checkpoint: squared is"),
        ({"preprocess": rp.Preprocess(np.cbrt)}, "preprocess.input_map cannot be stored in a checkpoint: cbrt is"),
        ({"optimizer": Own(1.0)}, "optimizer cannot be stored in a checkpoint: it is a Own"),
        ({"optimizer": Gradient(1.0)}, "optimizer cannot be stored in a checkpoint: it is a Gradient"),
    ],
)
def test_what_cannot_be_told_is_refused_by_name(changes: dict[str, Any], words: str) -> None:
    ident = rp.Identifier(rp.Structure(1), 0.1, **{"optimizer": rp.Gradient(1.0), **changes})
    with pytest.raises(rp.InvalidArgumentError, match=words) as caught:
        ident.to_bytes()
    assert "\n" not in str(caught.value)


@every("value", [Thing(), b"x", 1j, {1, 2}, np.longdouble(1), np.array(["a"]), np.array([Thing()])])
def test_other_things_are_refused(value: Any) -> None:
    with pytest.raises(rp.InvalidArgumentError, match="thing cannot be stored"):
        to_plain("thing", value)


@every(
    "plain",
    [
        {},
        {"Structure": {"poles": 2}},
        {"Structure": {"poles": 0, "zeros": 0, "delay": 0.0, "bias": False, "feedthrough": False}},
        {"Popen": {"args": "true"}},
        {"Structure": {}, "Replay": {}},
        {"numpy": ["O", [1], "00" * 8]},
        {"numpy": ["<f8", [10**12], "00" * 8]},
        {"float": "one"},
        {"float": "1.0"},
        {"numpy": ["<f8,<f8", [], "00" * 16]},
        {"Replay": {"capacity": True, "batch_size": 2, "warmup": 1, "seed": 0}},
        {"Replay": {"capacity": 5.0, "batch_size": 2, "warmup": 1, "seed": 0}},
        {"Gradient": {"gain": True}},
        {"tuple": {"a": 1}},
        {"tuple": 3},
    ],
    ids=str,
)
def test_what_was_not_written_here_is_not_read(plain: Any) -> None:
    with pytest.raises((ValueError, TypeError, AttributeError, KeyError)):
        from_plain(plain)


def test_every_kind_has_one_name() -> None:
    assert all(kind.__name__ == name for name, kind in KINDS.items())
    assert len(KINDS) == 8 + len(OPTIMIZERS)
