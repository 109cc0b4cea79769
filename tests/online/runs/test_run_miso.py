"""`rp.run` of several inputs: what `Identifier` makes of the record, finished."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import replant as rp
from support.cases import every
from support.rows import ASKED, DT, FAST, SLOW, noisy, row_of, toggling

U = toggling(5, samples=1200)
Y = noisy(5, row_of(U, FAST, SLOW))


def test_a_run_is_the_identifier_finished() -> None:
    found = rp.run(U, Y, DT, **ASKED)
    ident = rp.Identifier(**ASKED, dt=DT, startup=120)
    ident.update_many(U, Y)
    ident.finish()
    assert isinstance(found, rp.RowFit)
    np.testing.assert_array_equal(found.parameters, ident.parameters)
    assert found.verdict.status == "trusted"
    assert found.output.shape == Y.shape
    assert found.fit == pytest.approx(rp.fit(U, Y, DT, **ASKED).fit, abs=0.1)


def test_stamps_and_references_come_with_the_samples() -> None:
    t = DT * np.arange(Y.size) + np.where(np.arange(Y.size) < 700, 0.0, 100.0)
    found = rp.run(U, Y, DT, **ASKED, t=t, reference=U)
    assert found.parameters == pytest.approx(rp.fit(U, Y, DT, **ASKED, t=t, reference=U).parameters, rel=1e-3)


@every(
    "more, words",
    [
        ({"structure": rp.Structure(1)}, "several inputs take no structure yet: leave it out"),
        ({"optimizer": "amsgrad"}, "several inputs take no optimizer yet: leave it out"),
        ({"preprocess": rp.Preprocess()}, "several inputs take no preprocess yet: leave it out"),
        ({"t": DT * np.arange(7)}, "t has 7 rows and y 1200 samples: give one row for each"),
        ({"reference": U[:9]}, "reference has 9 rows and y 1200 samples: give one row for each"),
        ({"poles": (1, 1, 1)}, "poles has 3 entries"),
    ],
)
def test_what_does_not_match_is_named(more: dict[str, Any], words: str) -> None:
    with pytest.raises(rp.InvalidArgumentError, match=words):
        rp.run(U, Y, DT, **(ASKED | more))
