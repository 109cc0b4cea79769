"""What is kept of a record too long to be held."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from replant.online.runs import result
from replant.online.runs.result import Recorder
from support.cases import every


@every("cuts", [[], [1], [400, 401, 700], [999]])
def test_newest_samples_and_every_peak_are_kept(monkeypatch: pytest.MonkeyPatch, cuts: list[int]) -> None:
    monkeypatch.setattr(result, "POINTS", 50)
    u, y = np.random.default_rng(0).standard_normal((2, 1000))
    y[77] = 30.0
    model = 0.5 * y
    recorder, ends = Recorder(1000, newest=300), [0, *cuts, 1000]
    for begin, end in pairwise(ends):
        recorder.take(u[begin:end], y[begin:end], model[begin:end])
    found = recorder.overview(shift=2.0)
    assert found is not None
    assert found.samples == 1000
    np.testing.assert_array_equal(found.newest_input, u[-300:])
    np.testing.assert_array_equal(found.newest_output, y[-300:])
    np.testing.assert_array_equal(recorder.output(2.0), model[-300:] + 2.0)
    assert found.output.values.size <= 50
    assert found.output.values.max() == 30.0
    assert found.model.values.max() == 17.0
    assert found.residual.values.max() == 30.0 - 17.0
    assert found.output.places[found.output.values.argmax()] == pytest.approx(77, abs=2 * found.output.step)


def test_a_record_that_is_held_needs_none() -> None:
    recorder = Recorder(10)
    recorder.take(np.ones(10), np.ones(10), np.arange(10.0))
    assert recorder.overview(0.0) is None
    np.testing.assert_array_equal(recorder.output(1.0), np.arange(1.0, 11.0))
