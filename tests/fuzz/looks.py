"""What may be done with a thing that came out of a call: a number that is accepted must be of use everywhere."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np

import replant as rp
from fuzz.public import DT, MODEL_FIELDS, T, U, Y, model
from replant import rigs
from replant.fleet import write_page
from replant.sklearn import TransferFunctionRegressor
from support.builders import identifier


def looked_at(thing: Any) -> list[Callable[[], Any]]:
    """What may be done with a thing that came out of a call: read every property, call every method of no argument."""
    match thing:
        case rp.Identifier():
            return [
                lambda: thing.update_many(U, Y), lambda: thing.update(1.0, 2.0), thing.assess, thing.to_bytes,
                lambda: thing.update_many(U, Y, T, U), lambda: thing.model, thing.finish, *_read(thing),
            ]  # fmt: skip
        case rp.Ensemble():
            return [lambda: thing.update_many(U, Y), lambda: thing.update(1.0, 2.0), *_read(thing)]
        case rp.Model():
            return [
                lambda: thing.simulate(U), lambda: thing.simulate(U, T, y=Y), lambda: thing.predict(U, Y),
                lambda: thing.validate(U, Y), lambda: thing.validate(U, Y, T), thing.step, thing.impulse, thing.bode,
                thing.plot, lambda: thing.to_control(3), lambda: thing.bode([0.1, 1.0]), lambda: thing.step(3.0),
                lambda: rp.Model.from_json(thing.to_json()), lambda: thing.step().plot(), lambda: thing.bode().plot(),
                lambda: thing.nyquist().plot(), lambda: thing.poles().plot(), lambda: thing.poles(), *_read(thing),
            ]  # fmt: skip
        case rp.Log():
            return [
                lambda: rp.fit(thing, poles=1), lambda: rp.run(thing, poles=1), lambda: rp.decimate(thing, 2),
                lambda: rp.detrend(thing), lambda: rp.resample(thing, 1.5 * thing.dt), lambda: model().validate(thing),
                lambda: rp.bandpass(thing, 1.0), lambda: rp.from_rest(thing),
                lambda: rp.search(thing, poles=(1,)), lambda: rp.fit([thing, thing], poles=1), *_read(thing),
            ]  # fmt: skip
        case rp.TransferFunction():
            return [
                lambda: thing.simulate(U, DT), lambda: thing.simulate(U, DT, input_hold="foh"),
                lambda: thing.response([0.0, 1.0]), lambda: thing.free_responses(10, DT), lambda: thing.to_control(3),
                lambda: str(thing), *_read(thing),
            ]  # fmt: skip
        case rp.Structure():
            return [
                lambda: thing.transfer_function(np.ones(thing.size)), lambda: rp.fit(U, Y, DT, thing),
                lambda: rp.Identifier(thing, DT).update_many(U, Y), lambda: rp.run(U, Y, DT, thing), *_read(thing),
            ]  # fmt: skip
        case rp.StateVariableFilter():
            return [
                lambda: thing.discretize(2, DT, 0.25), lambda: thing.polynomial(2),
                lambda: identifier(filter=thing).update_many(U, Y),
                lambda: rp.fit(U, Y, DT, poles=2, method="least_squares", filter=thing),
            ]  # fmt: skip
        case rp.Replay():
            return [lambda: identifier(replay=thing).update_many(U, Y)]
        case rp.Scaling():
            return [lambda: identifier(structure=rp.Structure(2), scaling=thing).update_many(U, Y)]
        case rp.Preprocess():
            return [
                lambda: rp.fit(U, Y, DT, poles=1, preprocess=thing),
                lambda: rp.run(U, Y, DT, poles=1, preprocess=thing),
                lambda: rp.Identifier(poles=1, dt=DT, preprocess=thing).update_many(U, Y),
            ]  # fmt: skip
        case rp.NoiseModel():
            return [lambda: thing.spectrum([0.0, 1.0]), *_read(thing), lambda: _with_noise(thing).predict(U, Y)]
        case rp.Uncertainty():
            return [lambda: thing.response([0.1, 1.0]), *_read(thing)]
        case rp.Trace():
            return [thing.before, lambda: thing.index([0.5, 2.0]), lambda: thing + thing, thing.to_pandas]
        case rp.Gradient.__base__():  # an optimizer
            return [
                lambda: identifier(thing, structure=rp.Structure(1)).update_many(U, Y),
                lambda: rp.run(U, Y, DT, poles=1, optimizer=thing),
            ]
        case rigs.Rig():
            return [lambda: thing.measure(U), lambda: thing.crept(10), *_read(thing)]
        case TransferFunctionRegressor():
            return [
                lambda: thing.fit(U[:, None], Y).predict(U[:, None]),
                lambda: thing.partial_fit(U[:, None], Y).predict(U[:, None]),
            ]
        case rp.FitResult():
            return [lambda: thing.model.step(), lambda: thing.model.validate(U, Y), *_read(thing)]
        case rp.Validation():
            return [thing.plot, lambda: repr(thing), *_read(thing)]
        case rp.fleet.Fleet():
            return [thing.to_pandas, lambda: write_page(thing), lambda: thing.verdicts]
    readable = type(thing).__module__.startswith("replant")
    plot = [thing.plot] if hasattr(thing, "plot") and readable else []
    return [*plot, *(_read(thing) if readable else [])]


def _with_noise(noise: rp.NoiseModel) -> rp.Model:
    return rp.Model(**{**MODEL_FIELDS, "noise": noise})


def _read(thing: Any) -> list[Callable[[], Any]]:
    """Read one property, or call a method without arguments."""
    acts = []
    for name in dir(type(thing)):
        known = getattr(type(thing), name)
        if name.startswith("_") or inspect.isclass(known):
            continue
        if not callable(known):
            acts.append(lambda name=name: getattr(thing, name))
        elif list(inspect.signature(known).parameters) == ["self"]:
            acts.append(lambda name=name: getattr(thing, name)())
    return [*acts, lambda: repr(thing)]
