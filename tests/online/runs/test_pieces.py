"""Batches, thinned signals and clocks, which come piece by piece."""

from __future__ import annotations

import numpy as np
import pytest

from replant import Structure, TransferFunction
from replant.estimation.settings import Request
from replant.online.runs.result import Clock, ClockRecorder
from replant.online.runs.run_log import compare
from replant.online.runs.thinning import batched
from replant.plotting.over_time import Thinner, thin

SIGNAL = np.array([0.0, 0.0, 9.0, 0.0, 0.0, -7.0, 0.0, 0.0])


def test_batches_of_one_size() -> None:
    parts = [(np.arange(3.0), np.zeros(3)), (np.arange(3.0, 5.0), np.zeros(2))]
    assert [u.tolist() for u, _ in batched(parts, 2)] == [[0.0, 1.0], [2.0, 3.0], [4.0]]


def test_a_thinned_signal_keeps_its_peaks() -> None:
    thinner = Thinner(length=8, points=4)
    thinner.take(SIGNAL[:3])
    thinner.take(SIGNAL[3:])
    assert thinner.thinned.values.tolist() == thin(SIGNAL, points=4).values.tolist() == [0.0, 9.0, 0.0, -7.0]


def test_clocks() -> None:
    assert Clock(0.5).at(np.array([0.0, 3.0])).tolist() == [0.0, 1.5]
    assert Clock.of(0.5, np.array([7.0, 7.5, 9.5])).at(np.array([0.0, 2.0])).tolist() == [0.0, 2.5]
    recorder = ClockRecorder(dt=1.0, length=4)
    recorder.take(np.array([5.0, 6.0]))
    recorder.take(np.array([7.0, 10.0]))
    assert recorder.clock.times is not None
    assert recorder.clock.times.tolist() == [0.0, 1.0, 2.0, 5.0]
    assert recorder.clock.longest == 3.0


def test_methods_on_the_same_record() -> None:
    u = np.where(np.arange(2000) // 50 % 2 == 0, 1.0, -1.0)
    y = TransferFunction([2.0], [1.0, 0.5]).simulate(u, dt=0.1)
    found = compare(Request(Structure(poles=1), 0.1), u, y, ["default", "srivc"])
    assert [each.name for each in found] == ["default", "srivc"]
    for each in found:
        assert each.result is not None
        assert each.result.parameters == pytest.approx([0.5, 2.0])
