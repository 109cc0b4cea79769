"""What is looked at after an update, in place of the whole memory of an optimizer."""

from __future__ import annotations

import numpy as np

from replant.kernels.optimizers import gradient
from support.cases import every

ORDER = 3
ANY = (np.inf, -np.inf, np.nan)
#: Settings, and what an update can leave in each block of the memory: a square that leaves float64 is infinite.
CASES = {
    gradient.AMSGRAD: ([1e-3, 0.9, 0.999, 1e-8], {"first": ANY, "second": ANY[:1], "largest": ANY[:1]}),
    gradient.INTEGRAL_COST: ([0.1, 2.0, 0.1], {"R": ANY, "Q": ANY, "slope": ANY}),
}


@every("algorithm", CASES)
def test_it_is_not_finite_when_any_of_the_memory_is_not(algorithm: int) -> None:
    layout, (settings, blocks) = gradient.MEMORY[algorithm], CASES[algorithm]
    row = np.array([[0.5, -0.25, 0.0, 1.0, 0.7]])
    for name, values in blocks.items():
        for place in range(layout.of(np.zeros(layout.size(ORDER)), name, ORDER).size):
            for broken in values:
                theta, memory = np.array([0.0, 0.4, -0.2]), np.full(layout.size(ORDER), 0.5)
                layout.of(memory, name, ORDER)[place] = broken
                with np.errstate(all="ignore"):
                    gradient.learn(algorithm, theta, memory, np.array(settings), row, np.zeros(1, np.int64), 1, 0, 1.0)
                part = gradient.telling_part(algorithm, ORDER, memory)
                assert not np.isfinite(memory).all(), "the case breaks nothing"
                assert not (np.isfinite(theta).all() and np.isfinite(part).all()), (name, place, broken)
