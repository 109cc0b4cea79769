"""Records that tell little or nothing: every way to a model ends with one, with none, or with one line of ours.

No exception of the linear algebra and no warning of NumPy comes through: warnings are errors here.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import replant as rp
from replant.errors import ReplantError
from replant.fitting.structure_search import search
from replant.live.make_view import EstimateHistory, make_view
from replant.live.view import SessionInfo
from support.builders import random_plant
from support.cases import every

DT = 0.05
SAMPLES = 600

Record = tuple[np.ndarray, np.ndarray, rp.Structure]


def square(rng: np.random.Generator) -> np.ndarray:
    return np.where(np.arange(SAMPLES) // int(rng.integers(5, 120)) % 2 == 0, 1.0, -1.0)


def plant_record(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    u = np.repeat(rng.choice([-1.0, 1.0], SAMPLES // 6), 6)
    return u, random_plant(int(rng.integers(100)), int(rng.integers(1, 4))).simulate(u, DT)


def walk(rng: np.random.Generator) -> Record:
    """A square wave in, a random walk out that it has nothing to do with."""
    return square(rng), np.cumsum(rng.standard_normal(SAMPLES)), rp.Structure(8, 3)


def too_many_poles(rng: np.random.Generator) -> Record:
    u = rng.standard_normal(SAMPLES)
    return u, random_plant(1, 1).simulate(u, DT), rp.Structure(int(rng.integers(3, 9)), 2)


def constant_input(rng: np.random.Generator) -> Record:
    return np.full(SAMPLES, rng.standard_normal()), rng.standard_normal(SAMPLES), rp.Structure(2)


def one_sine(rng: np.random.Generator) -> Record:
    u = np.sin(rng.uniform(0.01, 1.0) * np.arange(SAMPLES))
    return u, random_plant(2, 2).simulate(u, DT), rp.Structure(int(rng.integers(2, 6)), 1)


def no_output(rng: np.random.Generator) -> Record:
    return square(rng), np.zeros(SAMPLES), rp.Structure(3, 1)


def any_scale(rng: np.random.Generator) -> Record:
    u, y = plant_record(rng)
    of_input, of_output = 10.0 ** rng.choice([-300.0, -160.0, 0.0, 140.0, 300.0], 2)
    return u * of_input, y * of_output, rp.Structure(2)


def coarse(rng: np.random.Generator) -> Record:
    u, y = plant_record(rng)
    return u, np.round(3.0 * y / np.ptp(y)), rp.Structure(4, 2)


def itself(rng: np.random.Generator) -> Record:
    u, _ = plant_record(rng)
    return u, u.copy(), rp.Structure(3, 2)


def not_stable(rng: np.random.Generator) -> Record:
    u, _ = plant_record(rng)
    return u, np.cumsum(np.cumsum(u)), rp.Structure(int(rng.integers(2, 7)), 1)


def ordinary(rng: np.random.Generator) -> Record:
    u, y = plant_record(rng)
    return u, y + 0.05 * y.std() * rng.standard_normal(SAMPLES), rp.Structure(int(rng.integers(1, 6)))


def outcome(way: Callable[[], object]) -> str:
    """What a way to a model says: nothing, or a line of ours."""
    try:
        way()
    except ReplantError as mistake:
        return str(mistake)
    return ""


KINDS = [
    walk, too_many_poles, constant_input, one_sine, no_output, any_scale, coarse, itself, not_stable, ordinary
]  # fmt: skip


@pytest.mark.slow
@every("kind", [*KINDS[1:], *KINDS[:1]], ids=lambda kind: kind.__name__, quick=1)
@every("seed", range(2), quick=1)
def test_every_way_to_a_model_ends_in_good_order(kind, seed: int) -> None:
    u, y, structure = kind(np.random.default_rng([seed, KINDS.index(kind)]))
    live = rp.Identifier(structure, DT, startup=100)
    for part in (slice(0, 350), slice(350, None)):
        live.update_many(u[part], y[part])
        make_view(live, SessionInfo(), EstimateHistory(structure.size))
    live.finish()
    view = make_view(live, SessionInfo(), EstimateHistory(structure.size))
    assert view.verdict == live.assess().status
    for way in (
        lambda: rp.fit(u, y, DT, structure),
        lambda: rp.fit(u, y, DT, structure, method="srivc"),
        lambda: search(u, y, DT, poles=(1, 2), zeros=(0,)),
    ):
        assert "\n" not in outcome(way)


@pytest.mark.slow
def test_a_walk_that_ended_a_session_is_no_model() -> None:
    generator = np.random.default_rng(0)
    for _ in range(10):
        u, y, structure = walk(generator)
        ident = rp.Identifier(structure, DT, startup=SAMPLES)
        ident.update_many(u, y)
        assert ident.assess().status != "trusted"
