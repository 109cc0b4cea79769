"""Results at a prompt and in a notebook: a few lines that hold G(s), and a picture."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

import replant as rp
from support.builders import random_plant, record

U, Y = record(random_plant(1, 2), 1, 800, 0.1, noise=0.05)
LOG = rp.Log(U, Y, 0.1, others={"pump": U * np.arange(800)})


@cache
def fitted() -> rp.FitResult:
    return rp.fit(LOG, poles=2)


@cache
def large() -> rp.FitResult:
    return rp.fit(*record(random_plant(3, 6, 2), 3, 4000, 0.1, noise=0.01), 0.1, poles=6, zeros=5)


SHOWN: dict[str, Callable[[], Any]] = {
    "fit": fitted,
    "large fit": large,
    "run": cache(lambda: rp.run(LOG, poles=2)),
    "search": cache(lambda: rp.search(LOG, poles=range(1, 4))),
    "step": lambda: fitted().model.step(),
    "impulse": lambda: fitted().model.impulse(),
    "bode": lambda: fitted().model.bode(),
    "nyquist": lambda: fitted().model.nyquist(),
    "poles": lambda: fitted().model.poles(),
    "large poles": lambda: large().model.poles(),
    "model": lambda: large().model,
    "log": lambda: LOG,
    "g": lambda: large().transfer_function,
    "uncertainty": lambda: large().uncertainty,
    "noise": lambda: large().noise,
    "validation": lambda: fitted().model.validate(LOG),
    "trace": lambda: rp.Identifier(poles=2, dt=0.1).update_many(U, Y),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", SHOWN)
def test_no_result_prints_more_than_twelve_lines(what: str) -> None:
    text = repr(SHOWN[what]())
    assert len(text.splitlines()) <= 12
    assert max(map(len, text.splitlines())) < 1000


@pytest.mark.parametrize("what", ["fit", "run", "search"])
def test_results_say_g_fit_and_verdict(what: str) -> None:
    result = SHOWN[what]()
    model = getattr(result, "best", result).model
    text = repr(result)
    assert str(model.transfer_function) in text
    assert f"{model.simulated_fit:.1f} %" in text
    assert model.verdict.status in text


def test_responses_say_what_they_end_at() -> None:
    step = fitted().model.step()
    assert f"{step.output[-1]:.4g} +- " in repr(step)
    assert repr(fitted().model.bode()).startswith("<Bode over ")
    assert repr(rp.TransferFunction([2.0], [1.0, 0.5])) == "<TransferFunction 2 / (s + 0.5)>"


@pytest.mark.slow
@pytest.mark.parametrize("what", ["fit", "run", "search", "step", "impulse", "bode", "nyquist", "poles"])
def test_a_notebook_shows_the_picture(what: str) -> None:
    shown = SHOWN[what]()._repr_html_()
    assert '<img src="data:image/png;base64,' in shown
    assert "<TransferFunction" not in shown


def test_without_matplotlib_a_notebook_shows_words(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(self: Any, ax: Any = None) -> Any:
        raise rp.MissingDependencyError("pip install matplotlib")

    monkeypatch.setattr(rp.Model, "plot", missing)
    assert fitted()._repr_html_() == fitted().model._repr_html_()


def test_of_a_constant_input_no_coefficients_are_shown() -> None:
    result = rp.fit(np.ones(300), np.random.default_rng(0).standard_normal(300), dt=0.1, poles=1)
    text = repr(result)
    assert text.splitlines()[0] == "<FitResult without a model: u -> y"
    assert "not excited: the input is constant" in text
    assert "a0" not in text
    assert "%" not in text
    assert not result.has_model
    assert fitted().has_model
