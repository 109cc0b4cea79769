"""Scenarios C, D and I: a plant that changes, the simulated actuator, and recorded logs."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import replant as rp
from accuracy.bounds import Bound
from accuracy.experiment import Experiment, Method, truth_of
from accuracy.linear import DEFAULT, LEAST_SQUARES, OFFLINE, buffered, same
from accuracy.methods import Article, Figures, Offline, Online, Tracked
from accuracy.records import Measured
from accuracy.tracking import DT, Varying
from replant.estimation.optimizers import KalmanTracking
from replant.logs import read_log
from replant.rigs import deap_rig, deap_voltage
from replant.verdict import simulate

# C. What an engineer knows beforehand: a1 goes through a range of 40 in 1000 s, a0 through one of 180 in 500 s, and
# b0 stands still.  q is the square of a quarter of the range over the time it takes.
PACE = ((40.0 / 4) ** 2 / 1000.0, (180.0 / 4) ** 2 / 500.0, 0.0)
NAMES_C = ("a1", "a0", "b0")
KALMAN = "Kalman tracking, with instruments"


def scenario_c() -> Iterator[Experiment]:
    """Parameters that change, random binary input."""
    for hold in (10, 5, 20):
        methods: dict[str, Method] = {
            KALMAN: Tracked(Online({"optimizer": KalmanTracking(PACE)})),
            "Kalman tracking, no instruments": Tracked(
                Online({"optimizer": KalmanTracking(PACE), "instruments": False})
            ),
        }
        for factor in (10.0, 0.1):
            pace = tuple(factor * q for q in PACE)
            methods[f"Kalman tracking, q times {factor:g}"] = Tracked(Online({"optimizer": KalmanTracking(pace)}))
        methods |= {name: Tracked(method) for name, method in buffered().items() if isinstance(method, Online)}
        methods[DEFAULT] = Tracked(Online())
        limits = {f"rms {name}": limit for name, limit in zip(NAMES_C, (0.9, 4.5, 0.65), strict=True)}
        yield Experiment(
            f"C hold-{hold}",
            f"b0/(s^2+a1(t)s+a0(t)), random binary held {hold} samples, noise variance 0.1, 1000 s",
            rp.Structure(poles=2),
            DT,
            12,
            Varying(hold),
            methods,
            bounds=(Bound(KALMAN, "at most", limits),),
            beside=hold != 10,
        )


@dataclass(frozen=True)
class Actuator:
    """Makes the records of the demo's rig: 240 s at 1 kHz; the voltage is another one each run."""

    samples: int = 240_000

    def __call__(self, run: int) -> Measured:
        """Return the record of a run."""
        rig = deap_rig(noise=5e-3)
        u = deap_voltage(self.samples, seed=run)
        return Measured(u, rig.measure(u, seed=1000 + run), preprocess=rig.preprocess)


def scenario_d() -> Iterator[Experiment]:
    """The demo's rig with 5 um of noise."""
    rig, structure = deap_rig(), rp.Structure(poles=3, zeros=1)
    yield Experiment(
        "D actuator",
        "the demo's actuator, voltage steps of 10 ms to 20 s, 5 um of noise",
        structure,
        rig.dt,
        8,
        Actuator(),
        {
            DEFAULT: Online(),
            OFFLINE: Offline(),
            "article: buffered AMSGrad, gbt filters": Article("gbt"),
            "article: buffered AMSGrad, exact filters": Article("exact"),
            "buffered amsgrad, with instruments": Online({"optimizer": "amsgrad", "instruments": True}),
            LEAST_SQUARES: Offline("least_squares"),
        },
        truth_of(rig.plant, structure),
        (Bound(DEFAULT, "error", same(structure.names, 5.0, a1=0.5, b1=0.5, a2=2.0)),),
    )


@dataclass(frozen=True)
class Log:
    """A recorded log and what an independent output-error fit of it says.

    Attributes
    ----------
    file, input, output : str
    dt : float
        In s.
    poles : int
    gain, fit : float
        Reference; NaN where there is none.  Without a reference for the fit the others are its authors' figures, with
        which no promise goes.
    time_constants : tuple of float
        Reference in s, slowest first.
    """

    file: str
    input: str
    output: str
    dt: float
    poles: int
    gain: float
    time_constants: tuple[float, ...]
    fit: float


TCLAB = "tclab/tclab_kuntz_rawlings_2022.mat"
MOTOR = "un_dcmotor/DCmotor_prbs_open_exp.csv"
LOGS = {
    "motor": Log(MOTOR, "u", "y", 0.02, 1, 1704.0, (0.470,), 80.0),
    "motor-second-order": Log(MOTOR, "u", "y", 0.02, 2, math.nan, (0.453, 0.008), 80.4),
    "heater": Log("un_thermal/Thermal_prbs_open_exp.csv", "u", "y", 0.8, 1, 1.037, (31.5,), 93.4),
    "motor-2": Log("un_thermal/dcmotor2_prbs_open_exp.csv", "u", "y", 0.02, 2, 467.8, (0.1814, 0.0273), math.nan),
    "ball-and-hoop": Log("ayala_ballhoop/randomStepSequence.mat", "u", "y", 0.1, 1, 11.58, (1.585,), 86.1),
    "tclab-1": Log(TCLAB, "data.udat[:,0]", "data.ydat[:,0]", 1.0, 1, 0.687, (192.0,), 73.3),
    "tclab-2": Log(TCLAB, "data.udat[:,1]", "data.ydat[:,1]", 1.0, 1, 0.533, (252.0,), 59.4),
}


def data_folder() -> Path:
    """Return where the recorded logs lie: $REPLANT_DATA, or ../shared/datasets beside the project."""
    beside = Path(__file__).resolve().parents[3] / "shared" / "datasets"
    return Path(os.environ.get("REPLANT_DATA", beside))


@dataclass(frozen=True)
class Recorded:
    """Reads a log."""

    log: Log

    def __call__(self, run: int) -> Measured:
        """Return the record; there is but one."""
        log = self.log
        read = read_log(data_folder() / log.file, input=log.input, output=log.output, dt=log.dt)
        return Measured(read.input, read.output)


@dataclass(frozen=True)
class AsAnEngineerReadsIt:
    """Gain, time constants and simulated fit (estimated initial state and offset) of an estimator's model.

    Online, a tenth of the log is the start-up; else nothing is chosen.
    """

    online: bool

    def __call__(self, structure: rp.Structure, dt: float, measured: Measured) -> Figures:
        """Return the figures "fit", "K", "tau1" .. from the slowest on."""
        method = Online({"startup": measured.u.size // 10}) if self.online else Offline()
        found = method(structure, dt, measured)
        model = structure.transfer_function(np.array([found[name][0] for name in structure.names]))
        figures = {"fit": simulate(model, measured.u, measured.y, dt).fit, "K": model.dc_gain}
        taus = sorted((-1.0 / model.poles.real).tolist(), reverse=True)
        figures |= {f"tau{number}": tau for number, tau in enumerate(taus, 1)}
        return {name: (float(value), math.nan) for name, value in figures.items()}


def scenario_i() -> Iterator[Experiment]:
    """Recorded logs, defaults only."""
    for key, log in LOGS.items():
        taus = {f"tau{number}": tau for number, tau in enumerate(log.time_constants, 1)}
        bounds: tuple[Bound, ...] = ()
        if not math.isnan(log.fit):
            bounds = (
                Bound(DEFAULT, "at least", {"fit": log.fit - 0.5}),
                Bound(DEFAULT, "error", dict.fromkeys(taus, 7.0) | ({} if math.isnan(log.gain) else {"K": 3.0})),
            )
        yield Experiment(
            f"I {key}",
            f"{log.file}, {log.input} to {log.output}, {log.poles} pole{'s' * (log.poles > 1)}",
            rp.Structure(log.poles),
            log.dt,
            1,
            Recorded(log),
            {DEFAULT: AsAnEngineerReadsIt(online=True), OFFLINE: AsAnEngineerReadsIt(online=False)},
            {"fit": log.fit, "K": log.gain} | taus,
            bounds,
            reads_data=True,
        )
