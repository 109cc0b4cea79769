"""The path of an estimate: which of its samples stay, and that they stay as they were."""

from __future__ import annotations

import numpy as np

from replant.kernels.monitoring import scatter
from replant.kernels.schema import FIXED, ROOM, PathSlots
from support.cases import every
from support.references import kept_samples


def walk(samples: int, entries: int = 3) -> tuple[PathSlots, np.ndarray, np.ndarray]:
    """Offer every sample of a path as the kernel of one sample does; return it, and the estimates and P along it."""
    generator = np.random.default_rng(samples)
    theta = generator.standard_normal((samples + 1, entries))
    upper = np.triu(generator.standard_normal((samples + 1, entries, entries)), 1) + np.eye(entries)
    diagonal = generator.uniform(0.1, 1.0, (samples + 1, entries))
    kept = PathSlots.zeros(FIXED | {"T": entries, "PATH": ROOM})
    for k in range(1, samples + 1):
        if k >= kept.due:
            scatter.keep(kept.fields, theta[k], upper[k], diagonal[k], float(k))
    return kept, theta, np.einsum("kij,kj,kij->ki", upper, diagonal, upper)


@every("samples", [1, 5, 31, 32, 33, 34, 48, 63, 64, 65, 66, 1000, 4096, 5000])
def test_the_rows_are_every_stepth_estimate_and_its_variances(samples: int) -> None:
    kept, theta, variances = walk(samples)
    counts = kept_samples(samples, ROOM)
    assert kept.kept == len(counts)
    rows = kept.rows[: len(counts)]
    np.testing.assert_array_equal(rows[:, 0], theta[counts])
    np.testing.assert_allclose(rows[:, 1], variances[counts], rtol=1e-14)


@every("samples", [32, 33, 77, 1000, 12345])
def test_a_long_record_always_has_at_least_half_the_rows_in_steps_that_double(samples: int) -> None:
    kept = walk(samples, 1)[0]
    assert ROOM / 2 <= kept.kept <= ROOM
    assert kept.step == 2 ** np.ceil(np.log2((samples + 1) / (ROOM + 1)))  # doubled when one more is due
