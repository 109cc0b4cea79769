"""Structure: names and their order, sizes, and the structures that cannot be."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

import replant as rp
from support.cases import every


@every("poles", range(1, 11))
def test_names_count_down_and_agree_with_the_size(poles: int) -> None:
    for zeros in range(poles):
        for bias in (False, True):
            structure = rp.Structure(poles, zeros, bias=bias)
            a, b = structure.names[:poles], structure.names[poles : poles + zeros + 1]
            assert [int(name.removeprefix("a")) for name in a] == list(range(poles))[::-1]
            assert [int(name.removeprefix("b")) for name in b] == list(range(zeros + 1))[::-1]
            assert structure.names[poles + zeros + 1 :] == (("bias",) if bias else ())
            assert structure.size == len(structure.names) == poles + zeros + 1 + bias


def test_what_is_given_is_kept_and_frozen() -> None:
    structure = rp.Structure(poles=np.int64(3), zeros=1, delay=0.25, bias=True)
    assert (structure.poles, structure.zeros, structure.delay, structure.bias) == (3, 1, 0.25, True)
    assert structure == rp.Structure(3, 1, 0.25, True)
    assert hash(structure) == hash(rp.Structure(3, 1, 0.25, True))
    with pytest.raises(dataclasses.FrozenInstanceError):
        structure.poles = 4


@every(
    ("arguments", "named", "kind"),
    [
        ({"poles": 0}, "poles", ValueError),
        ({"poles": -1}, "poles", ValueError),
        ({"poles": 11}, "poles", ValueError),
        ({"poles": 1, "zeros": 1}, "zeros must be fewer than poles, .*--feedthrough", ValueError),
        ({"poles": 1, "zeros": 2, "feedthrough": True}, "zeros must be at most as many as poles, got 2", ValueError),
        ({"poles": 2, "zeros": 5}, "zeros", ValueError),
        ({"poles": 2, "zeros": -1}, "zeros", ValueError),
        ({"poles": 1, "delay": -1e-9}, "delay", ValueError),
        ({"poles": 1, "delay": math.nan}, "delay", ValueError),
        ({"poles": 1, "delay": math.inf}, "delay", ValueError),
        ({"poles": 2.0}, "poles", TypeError),
        ({"poles": "2"}, "poles", TypeError),
        ({"poles": None}, "poles", TypeError),
        ({"poles": True}, "poles", TypeError),
        ({"poles": 2, "zeros": 0.0}, "zeros", TypeError),
        ({"poles": 1, "delay": "a"}, "delay", TypeError),
        ({"poles": 1, "delay": None}, "delay", TypeError),
        ({"poles": 1, "delay": 1j}, "delay", TypeError),
        ({"poles": 1, "delay": [0.1]}, "delay", TypeError),
        ({"poles": 1, "bias": 5}, "bias", TypeError),
        ({"poles": 1, "bias": "yes"}, "bias", TypeError),
        ({"poles": 1, "bias": None}, "bias", TypeError),
    ],
    ids=repr,
)
def test_an_impossible_structure_is_refused_by_name(
    arguments: dict[str, Any], named: str, kind: type[Exception]
) -> None:
    with pytest.raises(kind, match=named) as caught:
        rp.Structure(**arguments)
    assert isinstance(caught.value, rp.ReplantError)
    assert "\n" not in str(caught.value)
