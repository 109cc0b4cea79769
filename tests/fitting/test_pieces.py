"""Times, frequencies, rests and notation of models."""

from __future__ import annotations

import json

import numpy as np
import pytest

from replant import Model, RowModel, Structure, TransferFunction
from replant.fitting.model import latex, usual_interval
from replant.fitting.model_fields import has_rest
from replant.fitting.model_json import as_object
from replant.fitting.responses import frequencies, time_of

LAG = TransferFunction([1.0], [1.0, 0.5])


def test_a_model_rests_within_a_record_that_is_longer_than_its_slowest_mode() -> None:
    assert has_rest(LAG, 10.0)
    assert not has_rest(LAG, 1.0)


def test_times_reach_until_the_slowest_mode_has_settled() -> None:
    assert time_of(LAG)[[0, -1]].tolist() == [0.0, 12.0]


def test_frequencies_reach_from_below_the_roots_to_nyquist() -> None:
    found = frequencies(TransferFunction([1.0], [1.0, 3.0]), dt=0.1)[[0, -1]]
    assert found == pytest.approx([0.1, np.pi / 0.1])


def test_the_usual_interval() -> None:
    assert usual_interval(np.array([0.0, 1.0, 2.0, 9.0]), 0.1) == 1.0
    assert usual_interval(np.array([3.0]), 0.1) == 0.1


def test_a_model_as_latex() -> None:
    text = latex(TransferFunction([2.0], [1.0, 0.5, 3e-5], delay=0.1))
    assert text == r"G(s) = \frac{2}{s^{2} + 0.5\, s + 3 \cdot 10^{-5}}\, e^{-0.1\, s}"


def test_fields_through_json_of_either_layout() -> None:
    one = Model(Structure(1), [1.0, 2.0], dt=0.1)
    several = RowModel((Structure(1), Structure(1, delay=0.5)), [1.0, 2.0, 3.0, 4.0], dt=0.1)
    assert as_object(one)["num"] == [2.0]
    assert as_object(several)["den"] == [[1.0, 1.0], [1.0, 3.0]]
    assert Model.from_json(json.dumps(as_object(one))) == one
    assert RowModel.from_json(json.dumps(as_object(several))) == several
    assert one != several
