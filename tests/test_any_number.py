"""Numbers of any type and size: plain ones are kept, or one line names the argument; nothing else is raised.

The calls are those of `fuzz.public`; `python -m fuzz --what calls --tries 5000` makes them by the thousand.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import inspect
import itertools
import pickle
import pkgutil
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import replant as rp
from fuzz.calls import MOST_MEMORY, check_message, limited, trial, watched
from fuzz.hostile import SAME, Rambling
from fuzz.public import FUNCTIONS as FUNCTIONS_OF_ALL
from fuzz.public import classes, folder, missing
from fuzz.trial import FindingError
from replant import signals
from replant.errors import LONGEST
from replant.estimation.settings import Request, Settings
from replant.fitting.model_fields import ModelFields, Provenance, RowFields
from replant.fleet.job import Job
from replant.model.state_space import Response
from replant.online.checkpoint.settings_json import KINDS
from replant.rigs import Rig
from replant.sklearn import TransferFunctionRegressor
from support.builders import engine_state, identifier, record, state
from support.cases import every

WHOLE = [np.int8, np.uint8, np.int16, np.uint16, np.int32, np.uint32, np.int64, np.uint64]
REAL = [np.float16, np.float32, np.float64, np.longdouble, Decimal, Fraction]
CALLS = 40  # `python -m fuzz` makes thousands


class Count(int):
    """A whole number of the user's own kind."""


TRUTHS: dict[str, Callable[[Any], Any]] = {
    "bool": bool,
    "numpy bool": np.bool_,
    "0-d bool": lambda value: np.array(bool(value)),
}
TYPES: dict[str, Callable[[Any], Any]] = {
    **{kind.__name__: kind for kind in [*WHOLE, *REAL]},
    **{f"0-d {kind.__name__}": (lambda value, kind=kind: np.array(value, kind)) for kind in (*WHOLE, np.float64)},
    "int": int,
    "float": float,
    "own int": Count,
    **TRUTHS,
    "text": str,
    "complex": complex,
    "vector": lambda value: np.array([value]),
    "0-d text": lambda value: np.array(str(value)),
    "time": lambda value: np.timedelta64(int(value), "s"),
    "nothing": lambda value: None,
}

STRUCTURE = rp.Structure(5, 2)
CUTOFF = rp.StateVariableFilter(2.0)
MODEL: dict[str, Any] = {
    "structure": rp.Structure(1), "parameters": [1.0, 2.0], "dt": 2.0, "covariance": [[1.0, 0.0], [0.0, 1.0]],
    "input_level": 1.0, "output_level": 2.0, "simulated_fit": 3.0, "one_step_fit": 4.0,
    "provenance": Provenance("given", date="2026-01-01"),
}  # fmt: skip
#: How each class is built of plain numbers, each small and whole, so that every type can hold it.
ROW: dict[str, Any] = {
    "structures": (rp.Structure(1), rp.Structure(1)), "parameters": [5.0, 2.0, 3.0, 4.0], "dt": 2.0,
    "covariance": np.eye(4).tolist(), "input_levels": [1.0, 2.0], "output_level": 3.0,
    "provenance": Provenance("given", date="2026-01-01"),
}  # fmt: skip
EXAMPLES: dict[type, dict[str, Any]] = {
    Job: {"input": "u", "output": "y", "structure": rp.Structure(2), "dt": 2.0, "begin": 1.0, "end": 3.0},
    rp.Structure: {"poles": 5, "zeros": 2, "delay": 2.0, "bias": True, "feedthrough": False},
    rp.Replay: {"capacity": 100, "batch_size": 7, "warmup": 3, "seed": 5},
    rp.NoiseModel: {"coefficients": [1.0, 2.0], "variance": 1.0, "residual_variance": 2.0, "dt": 1.0},
    rp.Scaling: {"output": 2.0, "regressor": (1.0, 2.0, 3.0)},
    rp.Preprocess: {"input_offset": 2.0, "output_offset": 3.0},
    rp.StateVariableFilter: {"cutoff": 2.0, "alpha": 1.0},
    rp.RefinedFilter: {"input_hold": "foh"},
    rp.Gradient: {"gain": 2.0},
    rp.IntegralCost: {"gain": 2.0, "forgetting_rate": 1.0},
    **{kind: {"step_size": 2.0, "epsilon": 1.0} for kind in (rp.Adam, rp.AMSGrad, rp.NAdam, rp.AdaGrad, rp.RMSProp)},
    rp.AdaDelta: {"epsilon": 1.0},
    rp.RecursiveLeastSquares: {"time_constant": 20.0, "initial_covariance": 100.0},
    rp.KalmanTracking: {"process_noise": (1.0, 2.0), "noise_time_constant": 20.0, "initial_covariance": 100.0},
    rp.TransferFunction: {"num": [2.0], "den": [1.0, 3.0], "delay": 2.0},
    rp.Uncertainty: {"structure": rp.Structure(1), "parameters": [1.0, 2.0], "covariance": [[1.0, 0.0], [0.0, 1.0]]},
    rp.Identifier: {"structure": STRUCTURE, "dt": 2.0, "startup": 100, "history": 100},
    rp.Ensemble: {"identifiers": identifier(), "members": 2, "n_jobs": 1},
    rp.Log: {
        "input": [1.0, 2.0], "output": [3.0, 4.0], "dt": 2.0, "time": [0.0, 2.0], "input_name": "u",
        "output_name": "y", "path": Path("log.csv"), "earlier": 3,
    },
    rp.Model: MODEL,
    ModelFields: MODEL,
    RowFields: ROW,
    rp.RowModel: ROW,
    rp.MatrixModel: {"rows": (rp.RowModel(**ROW),)},
    Provenance: {"method": "given", "samples": 3, "date": "2026-01-01"},
    Request: {"structure": STRUCTURE, "dt": 2.0, "startup": 100, "history": 100},
    Settings: {
        "structure": rp.Structure(1), "dt": 2.0, "filter": CUTOFF, "scaling": rp.Scaling(1.0, (1.0, 1.0)),
        "optimizer": rp.Gradient(1.0), "replay": None, "instruments": False, "normalize": True,
        "preprocess": rp.Preprocess(), "startup": 3,
    },
    Rig: {
        "plant": rp.TransferFunction([1.0], [1.0, 1.0]), "dt": 2.0, "input_rest": 1.0, "output_rest": 1.0,
        "noise": 1.0, "creep": 1.0,
    },
}  # fmt: skip
#: Functions that take numbers, not records.
FUNCTIONS: dict[Callable[..., Any], dict[str, Any]] = {
    signals.square: {"samples": 100, "period": 4.0, "dt": 1.0, "amplitude": 2.0},
    signals.prbs: {"samples": 100, "bits": 10, "hold": 3, "amplitude": 2.0, "seed": 5},
    signals.random_steps: {"samples": 100, "shortest": 2, "longest": 20, "low": 1.0, "high": 2.0, "seed": 5},
    signals.multisine: {"samples": 100, "dt": 1.0, "frequencies": [0.125, 0.25], "amplitude": 2.0},
    signals.chirp: {"samples": 100, "dt": 1.0, "first": 1.0, "last": 2.0, "amplitude": 2.0},
    signals.white_noise: {"samples": 100, "rms": 2.0, "seed": 5},
}
#: Made by the package and never by a caller: their numbers are our own.
RESULTS = {
    "Assessment", "Verdict", "Simulation", "FitResult", "RowFit", "Trace", "Loaded", "Recording", "Table", "Batch",
    "Actuator", "Cell", "Experiment", "Improvement", "Plant", "Row", "RowResult", "TableResult", "Replication",
    "Stretch", "Optimizer", "Filter", "DiscreteFilter", "Dashboard", "Hub", "Source", "ReferenceUse", "Validation",
    "Inspection", "ModelComparison", "MatrixFit", "Session", "Signals",
    "Fleet", "Trial",
}  # fmt: skip


def public() -> Iterator[type]:
    """Every class of a public name, and every class that checks its fields."""
    modules = [rp, *(importlib.import_module(info.name) for info in pkgutil.walk_packages(rp.__path__, "replant."))]
    for module in modules:
        for name, thing in vars(module).items():
            if not inspect.isclass(thing) or issubclass(thing, Exception) or not thing.__module__.startswith("replant"):
                continue
            checks = thing.__module__ == module.__name__ and "__post_init__" in vars(thing)
            if checks or name in getattr(module, "__all__", ()):
                yield thing


def converted(example: Any, convert: Callable[[Any], Any]) -> Any:
    """An example, or each number in it, in another type."""
    return [converted(one, convert) for one in example] if type(example) in (list, tuple) else convert(example)


def made(build: Callable[..., Any], arguments: dict[str, Any], named: str) -> Any:
    """What comes of these arguments, in comparable form; None where they are refused, one of them by its name."""
    built = of(lambda: build(**arguments), named)
    if isinstance(built, rp.Identifier):
        built = built.request
    if isinstance(built, rp.Ensemble):
        return len(built), len(built._helpers)
    return None if built is None else plain(built)


def of(act: Callable[[], Any], named: str) -> Any:
    """What an act returns; None where it is refused by one line that names the argument."""
    try:
        return act()
    except rp.ReplantError as error:
        problem = error
    assert isinstance(problem, rp.ArgumentTypeError | rp.InvalidArgumentError)
    assert named in str(problem)
    assert "\n" not in str(problem)
    return None


def plain(value: Any) -> Any:
    """The value as a tree of plain numbers; anything else in it is a failure."""
    if type(value) in (int, float, bool, str, type(None)) or isinstance(value, Path):
        return type(value).__name__, value
    if type(value) is tuple:
        return tuple(map(plain, value))
    if type(value) is dict:
        return tuple((name, plain(each)) for name, each in value.items())
    if isinstance(value, np.ndarray):
        assert value.dtype == np.float64
        return value.shape, value.tolist()
    assert dataclasses.is_dataclass(value), f"a {type(value).__name__} was kept"
    return type(value).__name__, {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}


def test_every_public_class_has_an_example() -> None:
    missing = {kind.__name__ for kind in public() if kind not in EXAMPLES} - RESULTS
    assert not missing, "give an example of plain numbers in EXAMPLES"
    assert set(KINDS.values()) <= set(EXAMPLES), "what a checkpoint builds"


@every(
    ("build", "arguments"),
    [*EXAMPLES.items(), *FUNCTIONS.items()],
    ids=[kind.__name__ for kind in (*EXAMPLES, *FUNCTIONS)],
)
def test_a_number_of_any_type_is_kept_as_a_plain_one(build: Callable[..., Any], arguments: dict[str, Any]) -> None:
    """What takes it keeps plain ones, equal to those of the plain type, or refuses it by name."""
    for name, example in arguments.items():
        holds_numbers = type(example) in (int, float, list, tuple) and name not in ("structures", "rows")
        for kind, convert in TYPES.items() if holds_numbers else ():
            case = f"{build.__name__}({name} as {kind})"
            given = converted(example, convert)
            # a truth value counts as one or zero, where it counts; nothing stands for itself
            expected = example if given is not None else None
            if convert in TRUTHS.values():
                expected = converted(example, lambda x: type(x)(bool(x)))
            got = made(build, {**arguments, name: given}, name)
            if got is not None:
                assert got == made(build, {**arguments, name: expected}, name), case
            if convert in (*WHOLE, int) and type(example) in (int, float):
                assert got is not None, f"{case}: a whole number of NumPy's is one"


def test_narrow_numbers_of_a_structure_do_not_wrap() -> None:
    """Its sizes came out modulo 256, and kernels wrote beyond the end of arrays."""
    changes: dict[str, Any] = {"optimizer": rp.Gradient(1.0), "replay": None}
    narrow = identifier(structure=rp.Structure(np.uint8(5), np.uint8(0)), **changes)
    wide = identifier(structure=rp.Structure(5), **changes)
    assert [array.shape for array in engine_state(narrow).arrays] == [
        array.shape for array in engine_state(wide).arrays
    ]
    u, y = np.ones(100), np.arange(100.0)
    for one in (narrow, wide):
        one.update_many(u, y)
    assert narrow.to_bytes() == wide.to_bytes()


def test_one_sample_of_any_type() -> None:
    for name, kind in itertools.product("uyt", TYPES):
        sample = {"u": 1.0, "y": 2.0, "t": 3.0}
        one, other = identifier(), identifier()
        before = state(one)
        given = TYPES[kind](sample[name])
        if of(lambda one=one, new={**sample, name: given}: one.update(**new), name) is None:
            assert state(one) == before, f"{name} as {kind}"
            continue
        if name == "t" and given is None:
            del sample["t"]
        other.update(**{**sample, **({name: 1.0} if "bool" in kind else {})})
        assert state(one) == state(other), f"{name} as {kind}"


def test_many_samples_of_any_type() -> None:
    for name, kind in itertools.product("uyt", TYPES):
        samples = {"u": [1.0, 0.0, 1.0, 1.0], "y": [0.0, 1.0, 2.0, 3.0], "t": [1.0, 2.0, 3.0, 4.0]}
        one, other = identifier(), identifier()
        before = state(one)
        given = [TYPES[kind](value) for value in samples[name]]
        if of(lambda one=one, new={**samples, name: given}: one.update_many(**new), name) is None:
            assert state(one) == before, f"{name} as {kind}"
            continue
        truths = {name: [float(bool(value)) for value in samples[name]]} if "bool" in kind else {}
        other.update_many(**{**samples, **truths})
        assert state(one) == state(other), f"{name} as {kind}"


def test_a_record_in_any_layout() -> None:
    """Other bytes, the same numbers: big-endian, strided, read-only, a list, a column of a table."""
    u, y = record(rp.TransferFunction([2.0], [1.0, 1.0]), 1, 200, 0.5)
    expected = rp.fit(u, y, 0.5, poles=1).parameters.tolist()
    for number, layout in enumerate(SAME):
        assert rp.fit(layout(u), layout(y), 0.5, poles=1).parameters.tolist() == expected, number


@pytest.mark.slow
def test_a_record_of_narrow_numbers() -> None:
    u, y = record(rp.TransferFunction([2.0], [1.0, 1.0]), 1, 200, 0.5)
    u, y = (u + 1.0).round(), (10.0 * (y - y.min())).round()
    for kind in (*WHOLE, np.float32, np.float16, object, bool):
        given = (u.astype(kind), y.astype(kind), np.float32(0.5), rp.Structure(np.uint8(1)))
        found = of(lambda given=given: rp.fit(*given), "u")
        if found is None:
            assert kind is object
            continue
        expected = rp.fit(u.astype(kind).astype(float), y.astype(kind).astype(float), 0.5, rp.Structure(1))
        assert found.parameters.tolist() == expected.parameters.tolist(), kind
        assert type(found.dt) is float


def test_a_masked_output_is_a_missing_one() -> None:
    u, y = record(rp.TransferFunction([2.0], [1.0, 1.0]), 1, 200, 0.5)
    lost = np.arange(200) % 7 == 3
    spoilt = np.where(lost, 1e9, y)
    masked = rp.fit(u, np.ma.array(spoilt, mask=lost), 0.5, poles=1)
    assert masked.parameters.tolist() == rp.fit(u, np.where(lost, np.nan, y), 0.5, poles=1).parameters.tolist()


def test_every_public_call_is_tried() -> None:
    assert not list(missing()), "add ordinary arguments to fuzz/public.py"


@pytest.mark.slow
def test_calls_with_hostile_arguments() -> None:
    outcomes = Counter(trial(number) for number in range(CALLS))  # raises FindingError with what happened
    assert min(outcomes["result"], outcomes["refused"]) > CALLS / 6, "what refuses all, or accepts all, tries nothing"


@pytest.mark.slow
@every(("name", "make"), lambda: [*classes(), *FUNCTIONS_OF_ALL.items()], quick=8)
def test_every_argument_of_every_call_in_its_worst_form(name: str, make: Callable[[], Any]) -> None:
    """A number of more digits than Python prints, also within a list; an array that is none; floats at their ends."""
    with watched():
        function, ordinary = make()
    for argument, value in ordinary.items():
        for given in worst(value):
            case = f"{name}({argument}: {type(value).__name__} as {type(given).__name__})"
            try:
                with contextlib.chdir(folder()), watched(), limited(MOST_MEMORY):
                    function(**{**ordinary, argument: given})
            except rp.ReplantError as error:
                check_message(error)
            except Exception as error:
                raise AssertionError(case) from error


def worst(value: Any) -> Iterator[Any]:
    """What is the worst in the place of an ordinary argument."""
    yield 10**5000
    if not isinstance(value, int | float):
        yield from (np.array(1.0), [1.0, 10**5000])
    if isinstance(value, np.ndarray | list | tuple) and all(isinstance(each, float) for each in value):
        largest = np.finfo(float).max
        for ends in ([largest, -largest], [5e-324, 1.0]):
            yield np.resize(ends, np.shape(value))


@pytest.mark.slow
def test_the_regressor_takes_a_number_of_any_type() -> None:
    """It keeps its arguments as they were given, as scikit-learn has it, and uses plain ones."""
    u, y = record(rp.TransferFunction([2.0], [1.0, 0.5]), 1, 50, 1.0)
    expected = TransferFunctionRegressor().partial_fit(u[:, None], y).predict(u[:, None]).tolist()
    for name, value in (("poles", 1), ("zeros", 0), ("delay", 0.0), ("dt", 1.0)):
        for kind, convert in TYPES.items():
            if name == "poles" and kind == "vector":  # an entry for each input
                continue
            model = TransferFunctionRegressor(**{name: convert(value)})

            def predicted(model: TransferFunctionRegressor = model) -> Any:
                return model.partial_fit(u[:, None], y).predict(u[:, None]).tolist()

            assert of(predicted, name) in (None, expected), f"{name} as {kind}"


def test_what_must_not_happen_is_found() -> None:
    with pytest.raises(FindingError, match="not one line"):
        check_message(ValueError("two\nlines"))
    with pytest.raises(FindingError, match=f"{LONGEST + 1} characters"):
        check_message(ValueError((LONGEST + 1) * "x"))
    with pytest.raises(FindingError, match="does not name dt"):
        check_message(rp.ArgumentTypeError("must be a number"), ["dt"])
    with pytest.raises(UserWarning, match="stray"), watched():
        warnings.warn("stray", stacklevel=1)
    with pytest.raises(MemoryError), limited(2**20):
        np.zeros(2**30)


def test_an_error_is_one_short_line_whatever_it_repeats() -> None:
    name, columns = 10_000 * "x", [f"column\n{number}" for number in range(1000)]
    repeated = [name, columns, Rambling(), {name: columns}, 10**5000, np.zeros((50, 50, 2)), Fraction(10**5000)]
    for value in repeated:
        for act in (
            lambda value=value: rp.Structure(value),
            lambda value=value: rp.Identifier(value, 0.1),
            lambda value=value: rp.StateVariableFilter(1.0, method=value),
            lambda value=value: rp.Preprocess(value),
            lambda value=value: rp.load_model(value),
            lambda value=value: rp.load(value),
            lambda value=value: rp.fit([0.0, 1.0], [0.0, 1.0], value, poles=1),
        ):
            with pytest.raises(rp.ReplantError) as found:
                act()
            check_message(found.value)
    kinds = [kind for kind in vars(rp.errors).values() if inspect.isclass(kind) and issubclass(kind, rp.ReplantError)]
    for kind in kinds:
        error = kind(f"{name}: {columns}: choose another one")
        assert len(str(error)) <= LONGEST
        assert "\n" not in str(error)
        assert str(error).endswith("choose another one")
        assert str(pickle.loads(pickle.dumps(error))) == str(error), "workers send it"


def test_responses_of_a_pole_slower_than_any_time() -> None:
    """1 / 1e-320 is infinite: such a pole never settles, as an integrator does not."""
    slow, still = (rp.Model(rp.Structure(1), [pole, 2.0], dt=0.1) for pole in (1e-320, 0.0))
    assert slow.step().time.tolist() == still.step().time.tolist()
    assert np.allclose(slow.step().output, still.step().output, rtol=1e-12)
    assert slow.bode().frequency.tolist() == still.bode().frequency.tolist()


def test_a_dead_time_longer_than_any_memory_gives_no_output() -> None:
    """Before the first input has acted the output is zero: nothing of the dead time need be held."""
    g = rp.TransferFunction([2.0], [1.0, 0.5], delay=1e9)
    assert not g.simulate(np.ones(50), 1e-2).any()
    whole = rp.TransferFunction([2.0], [1.0, 0.5], delay=0.25)
    u = np.random.default_rng(1).standard_normal(40)
    response, parts = Response(whole, 0.1), (3, 0, 1, 2, 14, 20)
    joined = np.concatenate([response.take(part).output for part in np.split(u, np.cumsum(parts)[:-1])])
    assert joined.tolist() == whole.simulate(u, 0.1).tolist()


def test_what_no_machine_has_memory_for_is_refused_by_name() -> None:
    for act, named in (
        (lambda: rp.Ensemble(identifier(), members=2**31), "members"),
        (lambda: signals.white_noise(10**15, 1.0), "samples"),
        (lambda: rp.TransferFunction([1.0], [1.0, 1.0]).free_responses(10**15, 0.1), "samples"),
    ):
        with pytest.raises(rp.InvalidArgumentError, match=named):
            act()


def test_times_that_no_plant_has_are_refused_by_name() -> None:
    for time in (1e308, 1e-320, 1e31):
        for act, named in (
            (lambda time=time: rp.Identifier(poles=1, dt=time), "dt"),
            (lambda time=time: rp.fit([0.0, 1.0], [0.0, 1.0], time, poles=1), "dt"),
            (lambda time=time: rp.TransferFunction([1.0], [1.0, 1.0], delay=time), "delay"),
            (lambda time=time: rp.Model(rp.Structure(1), [1.0, 1.0], dt=0.1).step(time), "duration"),
        ):
            with pytest.raises(rp.InvalidArgumentError, match=f"{named} must lie between 1e-30 and 1e"):
                act()


def test_one_number_of_a_grid_stands_for_itself() -> None:
    u, y = record(rp.TransferFunction([2.0], [1.0, 1.0]), 1, 200, 0.5, noise=0.01)
    one, listed = rp.search(u, y, 0.5, poles=1, zeros=0, delays=0.0), rp.search(u, y, 0.5, poles=[1], zeros=[0])
    assert one.best.parameters.tolist() == listed.best.parameters.tolist()
    for grid in ({"poles": range(1, 10**9)}, {"delays": np.linspace(0.0, 1.0, 10**4)}, {"poles": "12"}):
        with pytest.raises(rp.ReplantError, match=next(iter(grid))):
            rp.search(u, y, 0.5, **grid)


def test_a_pade_approximation_that_float64_holds() -> None:
    for delay, order in ((1e-30, 30), (0.1, 10**9), (1e30, 50)):
        with pytest.raises(rp.InvalidArgumentError, match="pade must be smaller"):
            rp.TransferFunction([1.0], [1.0, 1.0], delay).to_control(order)
