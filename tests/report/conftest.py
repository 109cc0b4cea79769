"""Results for figures and reports: small, of known outcome, with and without covariances."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.estimation.settings import Request
from replant.online.runs.result import History, Result
from replant.online.runs.run import run_online
from replant.report.result_page import write_report
from support.builders import with_model

DT = 0.05
PLANT = rp.TransferFunction([3.0, 6.0], [1.0, 1.6, 4.0])


def steps(samples: int, seed: int = 1, hold: int = 20) -> np.ndarray:
    """A random binary input."""
    return np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], -(-samples // hold)), hold)[:samples]


def identify(u: np.ndarray, y: np.ndarray, **request: Any) -> Result:
    """An online run whose every setting is definite."""
    settings: dict[str, Any] = {
        "structure": rp.Structure(poles=2, zeros=1),
        "filter": rp.StateVariableFilter(cutoff=4.0),
        **request,
    }
    with np.errstate(all="ignore"):
        return run_online(Request(dt=DT, **settings), u, y)


def without_covariance(result: Result) -> Result:
    """Return the result without its covariance, as of an estimator that has none."""
    assert result.history is not None
    history = dataclasses.replace(result.history, std=None)
    return dataclasses.replace(with_model(result, covariance=None), history=history)


def with_covariance(result: Result, relative: float = 0.03) -> Result:
    """The same result with a made-up covariance, correlated, and standard deviations over time."""
    assert result.history is not None
    size = result.structure.size
    root = relative * np.diag(np.abs(result.parameters)) @ (np.eye(size) + 0.3 * np.tri(size, k=-1))
    covariance = root @ root.T
    fading = 1.0 + 20.0 * np.exp(-np.linspace(0.0, 8.0, result.history.samples.size))
    history = History(result.history.samples, result.history.parameters, fading[:, None] * np.sqrt(np.diag(covariance)))
    return dataclasses.replace(with_model(result, covariance=covariance), history=history)


def as_log(u: np.ndarray, y: np.ndarray, path: str | Path = "log.csv", dt: float = DT) -> rp.Log:
    return rp.Log(u, y, dt, None, "voltage [V]", "speed [rpm]", Path(path))


@dataclasses.dataclass(frozen=True)
class Case:
    """A result and the log that it came from."""

    result: Result
    log: rp.Log


@pytest.fixture(scope="session")
def plain() -> Case:
    """A good model of a clean record, without uncertainty."""
    u = steps(4000)
    y = PLANT.simulate(u, DT) + 0.02 * np.random.default_rng(2).standard_normal(u.size)
    return Case(without_covariance(identify(u, y)), as_log(u, y))


@pytest.fixture(scope="session")
def uncertain(plain: Case) -> Case:
    """The same with covariances."""
    return Case(with_covariance(plain.result), plain.log)


def _diverged() -> Case:
    u = 1e3 * steps(2000)
    y = PLANT.simulate(u, DT)
    return Case(
        identify(u, y, optimizer=rp.Gradient(gain=1e6), scaling=None, replay=None, normalize=False), as_log(u, y)
    )


def _still() -> Case:
    u, y = np.full(1000, 1.5), np.full(1000, 3.0)
    return Case(identify(u, y), as_log(u, y))


def _three() -> Case:
    u = steps(3)
    return Case(identify(u, PLANT.simulate(u, DT)), as_log(u, PLANT.simulate(u, DT)))


def _rejected() -> Case:
    u, y = steps(500), np.full(500, np.nan)
    return Case(identify(u, y, scaling=None), as_log(u, y))


def _empty() -> Case:
    nothing = np.zeros(0)
    return Case(identify(nothing, nothing, scaling=None), as_log(nothing, nothing))


def _beyond_float32() -> Case:
    u = steps(500)
    y = 1e120 * PLANT.simulate(u, DT)
    return Case(identify(u, y), as_log(u, y))


BAD: dict[str, Callable[[], Case]] = {
    "diverged": _diverged,
    "still": _still,
    "three": _three,
    "rejected": _rejected,
    "empty": _empty,
    "beyond float32": _beyond_float32,
}


@pytest.fixture(
    scope="session",
    params=[pytest.param(name, marks=() if name in ("diverged", "empty") else pytest.mark.slow) for name in BAD],
)
def bad(request: pytest.FixtureRequest) -> tuple[str, Case]:
    """Results of all kinds of faulty records and runs."""
    return request.param, BAD[request.param]()


@pytest.fixture(scope="session")
def bad_report(bad: tuple[str, Case], tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """The name of the case, and its report."""
    name, case = bad
    return name, write_report(tmp_path_factory.mktemp("bad") / "report.html", case.result, case.log)


@pytest.fixture(scope="session")
def long_report(long_case: Case, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of the long record."""
    path = tmp_path_factory.mktemp("million") / "report.html"
    return write_report(path, long_case.result, long_case.log, title="A million samples")


@pytest.fixture(scope="session", params=[200_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
def long_case(request: pytest.FixtureRequest) -> Case:
    """A record of a million samples, in `make test` of a fifth of it, with a hole and a spike of one sample."""
    u = steps(request.param)
    y = PLANT.simulate(u, DT) + 0.02 * np.random.default_rng(2).standard_normal(u.size)
    hole = 4 * u.size // 10
    y[hole : hole + 300] = np.nan
    y[7 * u.size // 10 + 1] = 9.5
    return Case(with_covariance(identify(u, y, replay=None)), as_log(u, y, "million.csv"))
