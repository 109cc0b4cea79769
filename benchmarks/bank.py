"""A bank of structures on random stable plants: how often its order is right, and its cost beside that of its members.

    python benchmarks/bank.py [--seed 1] [--plants 100] [--first 0]

Plants of one to four poles and no or one zero, 2000 to 4000 samples, white or AR noise at 20 to 30 dB, and PRBS, steps
or a multisine as input; a bank of one to four poles.  The order counts where it can be told: by the best model with a
pole less, its noise model free, the log-likelihood is expected to be more than `APART` smaller.  Of one plant in ten
the members are also run by themselves, and the processor times compared.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

import replant as rp
from campaign.plants import drawn_input
from replant.estimation.engine.record import Record
from replant.estimation.simulation.model_run import prediction_error
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression

APART = 6.0  # log-likelihood by which an order is told from the one below, as for step tests [nats]
ORDERS = 1, 2, 3, 4
DECADES = 1.0  # between the slowest and the fastest pole, at the most
SAMPLES = (2_000, 4_000)
DECIBELS = (20.0, 30.0)
INPUTS = "PRBS", "steps", "multisine"
LAGS = 400  # samples of the noise's response that its covariances are summed over
COMPARED = 10  # of so many plants, one is run by its members alone, too


@dataclass(frozen=True, eq=False)
class Experiment:
    """A record of a known plant, whose noise is 1/D of white noise of a known deviation."""

    plant: rp.TransferFunction
    dt: float
    u: FloatArray
    clean: FloatArray
    y: FloatArray
    noise: FloatArray
    deviation: float

    @property
    def order(self) -> int:
        """Number of poles."""
        return self.plant.den.size - 1

    def structure(self, poles: int) -> rp.Structure:
        """Return the bank's structure with so many poles, and the plant's zeros where there may be as many."""
        return rp.Structure(poles, min(self.plant.num.size, poles) - 1)

    @classmethod
    def drawn(cls, seed: int, number: int) -> Experiment:
        """Return a record; the same for the same two numbers."""
        rng = np.random.default_rng([seed, number])
        order = int(rng.choice(ORDERS))
        poles: list[complex] = []
        while len(poles) < order:
            w = float(10.0 ** rng.uniform(0.0, DECADES))
            if order - len(poles) > 1 and rng.random() < 0.5:
                damping = float(10.0 ** rng.uniform(-1.0, 0.0))
                pole = w * complex(-damping, math.sqrt(1.0 - damping**2))
                poles += [pole, pole.conjugate()]
            else:
                poles.append(complex(-w))
        signs = rng.choice([-1.0, -1.0, -1.0, 1.0], int(rng.integers(min(order, 2))))
        zeros = signs * 10.0 ** rng.uniform(0.0, DECADES, signs.size)
        a, b = np.poly(poles).real, np.atleast_1d(np.poly(zeros)).real
        plant, dt = rp.TransferFunction(a[-1] / b[-1] * b, a), rng.uniform(0.05, 0.5) / float(np.abs(poles).max())
        samples = int(rng.integers(*SAMPLES))
        u = drawn_input(rng, str(rng.choice(INPUTS)), plant, dt, samples)
        clean = plant.simulate(u, dt)
        noise = np.array([1.0]) if rng.random() < 0.5 else np.array([1.0, -rng.uniform(0.5, 0.95)])
        coloured = lfilter([1.0], noise, rng.standard_normal(samples + LAGS))[LAGS:]
        deviation = float(clean.std() * 10.0 ** (-rng.uniform(*DECIBELS) / 20.0) / coloured.std())
        return cls(plant, dt, u, clean, clean + deviation * coloured, noise, deviation)

    @property
    def nats(self) -> float:
        """By how much the order below is expected to be less likely, its noise model free."""
        if self.order == 1:
            return math.inf
        structure, size = self.structure(self.order - 1), self.u.size
        record = Record(self.u, self.clean, np.array([self.dt]), "zoh")
        response = lfilter([1.0], self.noise, np.eye(1, LAGS)[0])
        covariances = [float(response[: LAGS - lag] @ response[lag:]) * self.deviation**2 for lag in range(5)]

        def error(theta: FloatArray) -> FloatArray:
            found = prediction_error(structure, theta, record, self.dt)
            return np.full(size, 1e3) if found is None else found

        def short_of(theta: FloatArray) -> float:
            left = error(theta)
            both = [left[lag:] @ left[: size - lag] / size + covariances[lag] for lag in range(5)]
            power = float(Autoregression.of_covariances(np.array(both)).power)
            return 0.5 * size * math.log(max(power, 1e-300) / self.deviation**2)

        begun = rp.fit(self.u, self.clean + 1e-6 * self.y, self.dt, structure=structure).parameters
        best = least_squares(
            lambda part: lfilter(self.noise, [1.0], error(part * begun)) / self.deviation, np.ones(begun.size),
            max_nfev=5,
        )  # fmt: skip
        return min(short_of(begun), short_of(best.x * begun))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--plants", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()
    likeliest, leads, trusted, costs, others = 0, 0, 0, [], 0
    for number in range(given.first, given.first + given.plants):
        made = Experiment.drawn(given.seed, number)
        structures = [made.structure(poles) for poles in ORDERS]
        begun = time.process_time()
        bank = rp.Identifier(structure=structures, dt=made.dt)
        bank.update_many(made.u, made.y)
        whole = time.process_time() - begun
        if number % COMPARED == 0:
            begun = time.process_time()
            for structure in structures:
                rp.Identifier(structure, dt=made.dt).update_many(made.u, made.y)
            costs.append(whole / (time.process_time() - begun))
        nats, status = made.nats, bank.assess().status
        found = ORDERS[int(np.argmax(bank.weights))], bank.structure.poles
        weights = ", ".join(f"{each:.2g}" for each in bank.weights)
        print(f"{number}: order {made.order}, found {found[0]}, served {found[1]} ({status}); weights {weights}; "
              f"{nats:.1f} nats", flush=True)  # fmt: skip
        if nats <= APART:
            others += 1
            continue
        likeliest += found[0] == made.order
        leads += found[1] == made.order
        trusted += status == "trusted"
    told = given.plants - others
    print(f"of {told} plants whose order can be told: {likeliest} found, {leads} served, {trusted} trusted")
    if costs:
        print(f"cost over the sum of the members: median {np.median(costs):.2f}, largest {max(costs):.2f}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
