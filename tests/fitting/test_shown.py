"""Results at a prompt and in a notebook: a few lines that hold G(s), and a picture."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import replant as rp
from support.builders import random_plant, record

LARGE = rp.fit(*record(random_plant(3, 6, 2), 3, 4000, 0.1, noise=0.01), 0.1, poles=6, zeros=5)
U, Y = record(random_plant(1, 2), 1, 800, 0.1, noise=0.05)
LOG = rp.Log(U, Y, 0.1, others={"pump": U * np.arange(800)})
FITTED = rp.fit(LOG, poles=2)

SHOWN: dict[str, Callable[[], Any]] = {
    "fit": lambda: FITTED,
    "large fit": lambda: LARGE,
    "run": lambda: rp.run(LOG, poles=2),
    "search": lambda: rp.search(LOG, poles=range(1, 4)),
    "step": lambda: FITTED.model.step(),
    "impulse": lambda: FITTED.model.impulse(),
    "bode": lambda: FITTED.model.bode(),
    "nyquist": lambda: FITTED.model.nyquist(),
    "poles": lambda: FITTED.model.poles(),
    "large poles": lambda: LARGE.model.poles(),
    "model": lambda: LARGE.model,
    "log": lambda: LOG,
    "g": lambda: LARGE.transfer_function,
    "uncertainty": lambda: LARGE.uncertainty,
    "noise": lambda: LARGE.noise,
    "validation": lambda: FITTED.model.validate(LOG),
    "trace": lambda: rp.Identifier(poles=2, dt=0.1).update_many(U, Y),
}


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
    step = FITTED.model.step()
    assert f"{step.output[-1]:.4g} +- " in repr(step)
    assert repr(FITTED.model.bode()).startswith("<Bode over ")
    assert repr(rp.TransferFunction([2.0], [1.0, 0.5])) == "<TransferFunction 2 / (s + 0.5)>"


@pytest.mark.parametrize("what", ["fit", "run", "search", "step", "impulse", "bode", "nyquist", "poles"])
def test_a_notebook_shows_the_picture(what: str) -> None:
    shown = SHOWN[what]()._repr_html_()
    assert '<img src="data:image/png;base64,' in shown
    assert "<TransferFunction" not in shown


def test_without_matplotlib_a_notebook_shows_words(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(self: Any, ax: Any = None) -> Any:
        raise rp.MissingDependencyError("pip install matplotlib")

    monkeypatch.setattr(rp.Model, "plot", missing)
    assert FITTED._repr_html_() == FITTED.model._repr_html_()
