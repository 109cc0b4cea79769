"""What a test reads or sets inside of a running identifier: the one place that reaches for its private state."""

from __future__ import annotations

import numpy as np

import replant as rp
from replant.estimation.engine import estimate_covariance
from replant.estimation.engine.state import State


def state_of(ident: rp.Identifier) -> State:
    """The arrays that the kernels work on; an identifier that has solved its record again has others."""
    return ident._state


def factors_of(ident: rp.Identifier) -> tuple[np.ndarray, np.ndarray]:
    """Copies of U (T, T) and D (T,) of an optimizer with a covariance, in scaled parameters."""
    upper, diagonal = state_of(ident).factors
    return upper.copy(), diagonal.copy()


def set_covariance(ident: rp.Identifier, variances: float | np.ndarray) -> None:
    """Make the covariance diagonal, with these variances (T,) of the scaled parameters."""
    upper, diagonal = state_of(ident).factors
    upper[:], diagonal[:] = np.eye(diagonal.size), variances


def path_of(ident: rp.Identifier) -> np.ndarray:
    """Copy of the path of the estimate (B, 2, T): W and diagonals of P after each block."""
    path = state_of(ident).path
    return path.rows[: int(path.kept)].copy()


def slowness_of(ident: rp.Identifier) -> float:
    """How many times wider the estimate scatters than the residual's power and colour predict."""
    assert ident.settings is not None
    return estimate_covariance.slowness(state_of(ident), ident.settings)
