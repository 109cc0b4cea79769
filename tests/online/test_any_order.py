"""Whatever comes, in whatever order: finite estimates, a covariance that is one, constant memory, no matter the chunks.

The second-order optimizers and instruments, through start-up and its new solutions; `test_identifier` has the others.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

import replant as rp
from support.builders import state
from support.cases import examples

DT, STARTUP = 0.1, 40
STRUCTURE = rp.Structure(2, 1)
KINDS: dict[str, dict[str, Any]] = {
    "default": {},
    "bias": {"structure": rp.Structure(2, 1, bias=True), "preprocess": rp.Preprocess("identity", "first", "first")},
    "dead time": {"structure": rp.Structure(2, 1, delay=0.13)},
    "forgetting": {"optimizer": rp.RecursiveLeastSquares(time_constant=20.0)},
    "tracking": {"optimizer": rp.KalmanTracking(1e-3)},
    "fixed filter": {
        "filter": rp.StateVariableFilter(3.0),
        "optimizer": rp.RecursiveLeastSquares(),
        "instruments": True,
    },
    "without instruments": {"optimizer": rp.KalmanTracking(1e-3), "instruments": False},
    "buffered AMSGrad": {
        "optimizer": rp.AMSGrad(step_size=1e-3),
        "instruments": True,
        "replay": rp.Replay(capacity=100, batch_size=5),
    },
}


class Rig:
    """The plant (s + 4)/(s^2 + 2 s + 4) with noise, sampled at multiples of a quarter of DT, its input held."""

    def __init__(self, seed: int, stamped: bool) -> None:
        system = np.array([[-2.0, -4.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]) * DT / 4
        self.quarter, self.x = expm(system), np.zeros(3)
        self.generator, self.stamped, self.t, self.u = np.random.default_rng(seed), stamped, 3.0, 0.0

    def sample(self, *, rest: bool = False, quarters: int | None = None) -> tuple[float, float, float | None]:
        """Let time pass and measure; then a new input, unless it ``rest``s."""
        if quarters is None:
            quarters = int(self.generator.integers(3, 6)) if self.stamped else 4
        self.x[2] = self.u
        self.x = np.linalg.matrix_power(self.quarter, quarters) @ self.x
        self.t += quarters * DT / 4
        if not rest and self.generator.random() < 0.3:
            self.u = float(self.generator.choice([-1.0, 1.0]))
        y = float(self.x[0] + 4.0 * self.x[1] + 0.02 * self.generator.standard_normal())
        return self.u, y, self.t if self.stamped else None


operations = st.one_of(
    st.tuples(st.sampled_from(["update", "chunk", "rest"]), st.integers(1, 120)),
    st.tuples(st.just("gap"), st.sampled_from([10, 90, 4000])),
    st.tuples(st.sampled_from(["reset", "clone", "freeze", "resume", "finish"]), st.just(0)),
    st.tuples(st.just("bad"), st.integers(0, 6)),
)
BAD = [
    (math.nan, 0.0),
    (0.0, math.inf),
    (-math.inf, math.nan),
    (1e300, 1.0),
    (1.0, -1e151),
    (0.0, math.nan),
    (1e308, 1e308),
]


def made(kind: str) -> rp.Identifier:
    return rp.Identifier(**{"structure": STRUCTURE, "dt": DT, "startup": STARTUP, **KINDS[kind]})


def stream(rig: Rig, name: str, count: int) -> tuple[list[float], list[float], list[float] | None]:
    samples = [rig.sample(rest=name == "rest") for _ in range(count)]
    u, y, t = zip(*samples, strict=True)
    return list(u), list(y), list(t) if rig.stamped else None


def apply(ident: rp.Identifier, rig: Rig, name: str, value: int, *, one_by_one: bool) -> rp.Identifier:
    """Do one thing to an identifier; samples go in as the operation says, or the other way."""
    if name in ("update", "chunk", "rest", "gap"):
        if name == "gap" and rig.stamped:
            rig.sample(quarters=value)
        u, y, t = stream(rig, name, value if name != "gap" else 5)
        if one_by_one:
            for k in range(len(u)):
                ident.update(u[k], y[k], None if t is None else t[k])
        else:
            ident.update_many(u, y, t)
    elif name == "bad":
        u, y = BAD[value]
        stamp = None if not rig.stamped else [math.nan, rig.t - 1.0, rig.t + 0.1 * DT][value % 3]
        assert math.isnan(ident.update(u, y, stamp))
    elif name == "reset":
        ident.reset()
    elif name == "clone":
        ident = ident.clone()
    elif name == "finish":
        if ident.samples > 30:
            ident.finish()
    elif ident.settings is not None:
        (ident.freeze if name == "freeze" else ident.resume)()
    return ident


def sizes(ident: rp.Identifier) -> dict[str, int]:
    return {name: len(content) for name, content in state(ident).items()}


def assert_sound(ident: rp.Identifier) -> None:
    """Finite numbers everywhere, and factors of a symmetric positive definite covariance."""
    assert np.isfinite(ident.parameters).all()
    if ident.settings is None:
        return
    running = ident._state
    assert np.isfinite(running.theta).all()
    assert np.isfinite(running.banks).all()
    assert np.isfinite(running.buffer).all()
    assert np.isfinite(running.recent).all()
    if ident.settings.optimizer.keeps_covariance:
        size = running.entries
        memory = running.memory[: size * size + size]
        U, D = memory[: size * size].reshape(size, size), memory[size * size :]
        np.testing.assert_array_equal(np.tril(U), np.eye(size))
        assert np.isfinite(U).all()
        assert (D > 0).all()
        assert np.isfinite(D).all()
    if ident.settings.instruments and ident.settings.optimizer.keeps_covariance:
        covariance = ident.covariance
        np.testing.assert_array_equal(covariance, covariance.T)
        assert (np.diag(covariance) > 0).all()
        std = np.sqrt(np.diag(covariance))
        assert np.linalg.eigvalsh(covariance / np.outer(std, std)).min() > -1e-9


def steps_of(script: list[tuple[str, int]]) -> Iterator[tuple[str, int]]:
    """Enough to start with, then the script."""
    yield "update", STARTUP + 5
    yield from script


@settings(deadline=None, derandomize=True, max_examples=examples(64), suppress_health_check=[HealthCheck.too_slow])
@given(
    kind=st.sampled_from(sorted(KINDS)),
    seed=st.integers(0, 50),
    stamped=st.booleans(),
    script=st.lists(operations, min_size=2, max_size=14),
)
def test_any_interleaving_is_sound_and_the_chunks_do_not_matter(
    kind: str, seed: int, stamped: bool, script: list[tuple[str, int]]
) -> None:
    ident, twin = made(kind), made(kind)
    rig, other = Rig(seed, stamped), Rig(seed, stamped)
    size: dict[str, int] = {}
    for name, value in steps_of(script):
        ident = apply(ident, rig, name, value, one_by_one=name == "update")
        twin = apply(twin, other, name, value, one_by_one=name != "update")
        assert_sound(ident)
        assert (ident.samples, ident.rejected, ident.status) == (twin.samples, twin.rejected, twin.status)
        assert (ident.settings is None) == (twin.settings is None)
        assert state(ident) == state(twin)
        if ident.settings is not None:
            assert ident.settings == twin.settings
            size = size or sizes(ident)
            assert sizes(ident) == size


def test_a_long_stream_of_everything_keeps_memory_and_finds_the_plant() -> None:
    """The counter-test: such streams do teach.  Three thousand samples with holes, gaps, rests and bad samples."""
    ident, rig = made("default"), Rig(0, True)
    for k in range(60):
        ident = apply(ident, rig, "chunk", 50, one_by_one=False)
        name, value = [("bad", k % 7), ("gap", 400), ("rest", 30), ("clone", 0), ("update", 7)][k % 5]
        ident = apply(ident, rig, name, value, one_by_one=True)
    assert ident.samples > 3000
    assert sum(ident.rejected.values()) == 12
    assert_sound(ident)
    away = ident.parameters - [2.0, 4.0, 1.0, 4.0]
    assert (np.abs(away) < 0.05 * np.array([2.0, 4.0, 1.0, 4.0])).all()
