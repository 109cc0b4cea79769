"""`Identifier` of several inputs, of which a controller makes one: a reference gives instruments, sample by sample."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.numerics.linear_algebra import chi2_quantile
from support.cases import every
from support.rows_in_feedback import ASKED, DT, TRUE, distance, looped

LENGTH = 900  # it is solved at 500 and 650 samples


def begun() -> Any:
    return rp.Identifier(**ASKED, dt=DT)


@pytest.mark.slow
@every("load, pole", [(False, 0.0), (True, 0.95)], quick=1)
def test_the_estimate_is_right_under_any_noise(load: bool, pole: float) -> None:
    u, y, r = looped(0, load=load, pole=pole)
    ident = begun()
    ident.update_many(u, y, r=r)
    assert distance(ident) < chi2_quantile(0.9999, TRUE.size)
    assert "input u1 is moved by the reference" in " ".join(ident.assess().reasons)
    assert ident.model.parameters.tobytes() == ident.parameters.tobytes()


def test_pieces_and_checkpoints_change_no_bit() -> None:
    """With a gap, a rejected sample, missing outputs and references that are not known."""
    u, y, r = looped(1, samples=LENGTH)
    t = DT * np.arange(LENGTH)
    t[800:] += 100 * DT
    u[700, 0], y[710:715], r[720:725] = np.nan, np.nan, np.nan
    whole, parts = begun(), begun()
    whole.update_many(u, y, t, r)
    for begin, end in ((0, 3), (3, 520), (520, 722), (722, 801), (801, LENGTH - 1)):
        parts.update_many(u[begin:end], y[begin:end], t[begin:end], r[begin:end])
        parts = rp.Identifier.from_bytes(parts.to_bytes())
    parts.update(u[-1], float(y[-1]), float(t[-1]), float(r[-1]))
    assert parts.to_bytes() == whole.to_bytes()
    assert whole.rejected["no output"] == 10


def test_references_come_with_every_sample_or_with_none() -> None:
    u, y, r = looped(3, samples=20)
    ident = begun()
    ident.update_many(u[:10], y[:10], r=r[:10])
    before = ident.to_bytes()
    for given in (None, np.column_stack([r, r])[10:]):
        with pytest.raises(rp.InvalidArgumentError, match="give r with every sample, or with none: 1 reference"):
            ident.update_many(u[10:], y[10:], r=given)
    assert ident.to_bytes() == before
