"""A feed of views as a running identification makes them, of a simulated plant: what the dashboard is tested with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import replant as rp
from replant.fitting.model_json import as_object
from replant.live.dashboard.app import Hub
from replant.live.make_view import NO_BODE, NO_STEP, bode_of, step_of
from replant.verdict import fit_percent, simulate

DT = 0.01
PLANT = rp.TransferFunction([3.0, 6.0], [1.0, 1.6, 40.0])
STRUCTURE = rp.Structure(poles=2, zeros=1)
CHUNK = 20  # samples between two views
WINDOW = 1000  # samples that a view shows
SETTLED = 4000  # samples after which the plant is found


def record(samples: int = 40_000, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Input and noisy output of the plant."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 0.0, 1.0, 2.0], -(-samples // 60)), 60)[:samples]
    return u, PLANT.simulate(u, DT) + 0.1 * rng.standard_normal(samples)


def plain(values: Any) -> Any:
    """Numbers as JSON has them: None for what is not finite."""
    if isinstance(values, complex):
        return {"real": values.real, "imag": values.imag}
    if isinstance(values, list | tuple):
        return [plain(value) for value in values]
    if isinstance(values, dict):
        return {key: plain(value) for key, value in values.items()}
    if isinstance(values, np.ndarray | np.generic):
        return plain(values.tolist())
    return None if isinstance(values, float) and not np.isfinite(values) else values


class Feed:
    """An identification of `PLANT` that makes one view after the other and obeys commands."""

    def __init__(self, plant_record: tuple[np.ndarray, np.ndarray] | None = None) -> None:
        self.u, self.y = plant_record or record()
        self.hub = Hub(command=self.obey, report=self.report)
        self._settled: tuple[rp.Identifier, list[tuple[float, list[float], list[float]]]] | None = None
        self.forget()
        self._start()

    def forget(self) -> None:
        """Be as new, but for what was learned."""
        self.commands: list[str] = []
        self.change: dict[str, Any] = {}  # what every view says instead
        self.before_report: Callable[[], object] = lambda: None

    def _start(self) -> None:
        self.identifier = rp.Identifier(STRUCTURE, DT)
        self.adapting = True
        self.taken = 0
        self.history: list[tuple[float, list[float], list[float]]] = []

    def settle(self) -> None:
        """Go on from where the plant is found, unless it is; that is learned once."""
        if self.taken < SETTLED:
            if self._settled is None:
                self._start()
                while self.taken < SETTLED:
                    self.advance(200)
                self._settled = self.identifier.clone(), self.history
            self.adapting, self.taken = True, SETTLED
            self.identifier, self.history = self._settled[0].clone(), list(self._settled[1])
        self.advance()

    def obey(self, name: str) -> None:
        self.commands.append(name)
        if name == "reset":
            self._start()
        elif self.identifier.status != "starting":
            self.adapting = name == "adapt"
            (self.identifier.resume if self.adapting else self.identifier.freeze)()

    def report(self) -> bytes:
        self.before_report()
        return b"<!doctype html><title>report</title>"

    def advance(self, samples: int = CHUNK) -> dict[str, Any]:
        """Learn the next samples, starting over at the record's end, and publish what can be seen then."""
        where = np.arange(self.taken, self.taken + samples) % self.u.size
        self.identifier.update_many(self.u[where], self.y[where])
        self.taken += samples
        view = plain({**self._view(), **self.change})
        self.hub.publish(view)
        return view

    def _view(self) -> dict[str, Any]:
        ident, model, at = self.identifier, self.identifier.transfer_function, DT * self.taken
        known, verdict = ident.uncertainty, ident.assess()
        starting = ident.status == "starting"
        self.history = [*self.history, (at, ident.parameters.tolist(), known.std.tolist())][-1000:]
        responses = (NO_BODE, NO_STEP) if starting else (bode_of(model, known, DT), step_of(model, known))
        modes = () if starting else known.modes
        gain = model.dc_gain if model.den[-1] else np.nan
        return {
            **{"at": at, "samples": ident.samples, "rejected": ident.rejected, "counters": {"malformed": 0, "lost": 0}},
            **{"source": "tcp://127.0.0.1:9000", "source_state": "connected", "rate": 1 / DT, "lag": 8e-4},
            **{"status": ident.status, "adapting": self.adapting, "names": ident.names},
            **{"parameters": ident.parameters, "std": known.std, "num": model.num, "den": model.den, "delay": 0.0},
            **{"poles": [mode.mode.pole for mode in modes], "pole_covariance": [mode.covariance for mode in modes]},
            **{"zeros": [] if starting else model.zeros.tolist(), "dc_gain": gain, "dc_gain_std": known.dc_gain_std},
            **{"verdict": verdict.status, "excited": verdict.excited, "reasons": verdict.reasons},
            **self._window(model, starting),
            **{"bode": vars(responses[0]), "step": vars(responses[1]), "truth": None},
            **{"input_label": "input", "output_label": "output"},
            "model": {} if starting else as_object(ident.model),
            "history": dict(zip(("t", "parameters", "std"), map(list, zip(*self.history, strict=True)), strict=True)),
        }

    def _window(self, model: rp.TransferFunction, starting: bool) -> dict[str, Any]:
        first = max(0, self.taken - WINDOW)
        where = np.arange(first, self.taken) % self.u.size
        u, y = self.u[where], self.y[where]
        run = np.full(y.size, np.nan) if starting else simulate(model, u, y, DT).output
        fit = np.nan if starting else fit_percent(y, run)
        t = DT * np.arange(first, self.taken)
        window = {"t": t, "u": u, "y": y, "model": run, "residual": y - run, "left_out": []}
        return {"simulated": fit, "residual_std": np.nan if starting else 0.1, "window": window}
