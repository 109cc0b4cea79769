"""Forged checkpoints of identifiers with a reference: refused, with what is wrong in one line."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.errors import DamagedCheckpointError
from replant.kernels.schema import LARGEST, REFERENCE
from replant.online.checkpoint.earlier_versions import BEFORE
from replant.online.checkpoint.encoding import DIGEST, MAGIC, START, decode, encode
from support.cases import every

DT = 0.1


def taken(samples: int, *, reference: bool = True) -> rp.Identifier:
    rng = np.random.default_rng(2)
    u, r = np.repeat(rng.choice([-1.0, 1.0], 40), 5), rng.standard_normal(200)
    y = rp.TransferFunction([2.0], [1.0, 0.5]).simulate(u, DT) + 0.01 * rng.standard_normal(200)
    ident = rp.Identifier(rp.Structure(1), DT, startup=50)
    ident.update_many(u[:samples], y[:samples], r=r[:samples] if reference else None)
    return ident


def refusal(ident: rp.Identifier, forge: Callable[[dict[str, Any]], object]) -> str:
    """What is said of an identifier's attributes after a change that no identifier makes."""
    attributes = ident.__getstate__()
    forge(attributes)
    with pytest.raises(DamagedCheckpointError) as caught:
        decode(encode(attributes))
    assert "\n" not in str(caught.value)
    return str(caught.value)


@every("value", [np.nan, np.inf, -np.inf, 2.0 * LARGEST])
def test_one_that_is_collected_can_be_used(value: float) -> None:
    ident = taken(20)
    ident._state.recent[3, REFERENCE] = value
    assert "not accepted" in refusal(ident, lambda attributes: None)


@every("samples", [20, 150])
@every("reference", [False, True])
def test_whether_there_is_one_agrees_with_the_rest(samples: int, reference: bool) -> None:
    def forge(attributes: dict[str, Any]) -> None:
        attributes["_reference"] = not reference

    assert re.search("reference|shape", refusal(taken(samples, reference=reference), forge))


@pytest.mark.parametrize("value", [1, "yes", None])
def test_whether_there_is_one_is_a_truth_value(value: Any) -> None:
    assert "reference is a" in refusal(taken(20), lambda attributes: attributes.update(_reference=value))


@pytest.mark.parametrize("value", [np.nan, np.inf, 2.0 * LARGEST])
def test_one_that_is_kept_is_finite(value: float) -> None:
    ident = taken(150)
    ident._state.recent[7, REFERENCE] = value
    assert "not valid" in refusal(ident, lambda attributes: None)
    ident = taken(150)
    ident._state.reference_now = value
    assert "not valid" in refusal(ident, lambda attributes: None)


def test_the_state_says_so_too() -> None:
    ident = taken(150)
    ident._state.has_reference = False
    assert "differ in has_reference" in refusal(ident, lambda attributes: None)


def test_a_settings_that_cannot_use_one_is_refused() -> None:
    ident = rp.Identifier(rp.Structure(1), DT, startup=50, optimizer="amsgrad")
    assert "cannot use" in refusal(ident, lambda attributes: attributes.update(_reference=True))


def test_a_file_of_an_older_format_is_refused_by_its_number() -> None:
    data = taken(20).to_bytes()
    before = START.pack(MAGIC, BEFORE - 1, 8) + data[START.size : -DIGEST]
    with pytest.raises(DamagedCheckpointError, match=f"its format is version {BEFORE - 1}"):
        decode(before + data[-DIGEST:])
