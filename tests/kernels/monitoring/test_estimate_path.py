"""The path of an estimate: which of its samples stay, and that they stay as they were."""

from __future__ import annotations

import itertools

import numpy as np

from replant.kernels.monitoring import scatter
from replant.kernels.schema import FIXED, ROOM, PathSlots
from support.cases import every
from support.references import kept_samples


def walk(samples: int, entries: int = 3, last: int = 0) -> tuple[PathSlots, np.ndarray, np.ndarray, list[int]]:
    """Offer every sample of a path as the kernel of one sample does; return it, and estimates, P, and when one was due.

    The ``last`` entries are an initial state.
    """
    generator = np.random.default_rng(samples)
    theta = generator.standard_normal((samples + 1, entries))
    upper = np.triu(generator.standard_normal((samples + 1, entries, entries)), 1) + np.eye(entries)
    diagonal = generator.uniform(0.1, 1.0, (samples + 1, entries))
    kept, due = PathSlots.zeros(FIXED | {"T": entries, "PATH": ROOM}), []
    known, work = entries - last, np.empty(100)
    for k in range(1, samples + 1):
        if k >= kept.due:
            scatter.keep(kept.fields, theta[k], upper[k], diagonal[k], known, float(k), work)
            due.append(k)
    return kept, theta, np.einsum("kij,kj,klj->kil", upper, diagonal, upper), due


@every("samples", [1, 5, 31, 32, 33, 34, 48, 63, 64, 65, 66, 1000, 4096, 5000])
@every("last", [0, 1])
def test_the_rows_are_what_the_blocks_say_and_the_variances(samples: int, last: int) -> None:
    kept, theta, covariances, due = walk(samples, last=last)
    counts, known = kept_samples(samples, ROOM), 3 - last
    assert kept.kept == len(counts)
    said = {due[0]: np.zeros(known)}
    for begin, end in itertools.pairwise(due):
        grown = np.mean(np.diag(covariances[end])[:known] / np.diag(covariances[begin])[:known])
        block = np.linalg.solve(covariances[end][:known, :known], (theta[end] - theta[begin])[:known])
        said[end] = said[begin] + np.sqrt(grown) * block
    rows = kept.rows[: len(counts)]
    np.testing.assert_allclose(rows[:, 0, :known], [said[k] for k in counts], rtol=1e-9, atol=1e-9)
    assert not rows[:, 0, known:].any()
    np.testing.assert_allclose(rows[:, 1], [np.diag(covariances[k]) for k in counts], rtol=1e-14)
    np.testing.assert_array_equal(kept.rows[len(counts), 0], theta[due[-1]])


def test_a_direction_that_a_matrix_lacks_gets_nothing() -> None:
    matrix, vector = np.array([4.0, 0.0, 2.0, 1.0]), np.array([2.0, 1.0])
    scatter.solve(matrix, vector, 2)
    np.testing.assert_array_equal(vector, [0.5, 0.0])


@every("samples", [32, 33, 77, 1000, 12345])
def test_a_long_record_always_has_at_least_half_the_rows_in_steps_that_double(samples: int) -> None:
    kept = walk(samples, 1)[0]
    assert ROOM / 2 <= kept.kept < ROOM
    assert kept.step == 2 ** np.ceil(np.log2((samples + 1) / ROOM))  # doubled when the room is full
