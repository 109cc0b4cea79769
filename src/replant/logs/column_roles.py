r"""Guess the input, output and reference among the columns of a log, from names, shapes and directed influence.

The influence of a on b is Geweke's measure: how much the past of a improves the prediction of b,

.. math:: F_{a \to b} = \ln \frac{\text{residual power of } b \text{ from its own past}}
          {\text{residual power of } b \text{ from its own past and that of } a},

It is large from the input to the output, and near zero from the output to the input unless a controller closes the
loop.

Source: Geweke (1982), "Measurement of linear dependence and feedback between multiple time series".
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import product

import numpy as np

from replant.logs.columns import Column, describe, is_computed
from replant.numerics.arguments import FloatArray

MOST_SAMPLES = 1 << 16  # samples used for the measures [samples]
ORDER = 3  # past stretches of each signal in the regression [count]
STRETCHES_OF_MEMORY = 5  # stretches in the lag at which the output's autocorrelation falls to 1/e [count]
FEWEST_STRETCHES = 200  # stretches per record, if it has that many samples [count]
SPREAD = 20.0  # distance from the median at which a value is clipped [ranges of the middle 90 %]
CEILING = 10.0  # largest measure: a residual 1/150 of the other is a rounding error [number]
CHANCE = 4.5  # correlation that is significant although thousands of lags are tested [standard deviations]
WHITENING = 8  # order of the autoregression that whitens the input [count]
ROUNDING = 1e-9  # change of a prepared input that is a rounding error [its standard deviation]


def prepared(values: FloatArray) -> FloatArray:
    """Return a signal (K,) for the measures: at most `MOST_SAMPLES`, clipped, gaps interpolated, of unit variance."""
    head = values[:MOST_SAMPLES]
    known = np.isfinite(head)
    if not known.any():
        return np.zeros(head.size)
    head = head / (float(np.abs(head[known]).max()) or 1.0)
    low, middle, high = np.quantile(head[known], [0.05, 0.5, 0.95])
    if high > low:
        head = np.clip(head, middle - SPREAD * (high - low), middle + SPREAD * (high - low))
    at = np.arange(head.size)
    filled = np.interp(at, at[known], head[known])
    centred = filled - filled.mean()
    power = float(centred.std())
    return np.asarray(centred / power if power > 0.0 else centred)


def influence(a: FloatArray, b: FloatArray) -> float:
    """Return Geweke's measure from ``a`` (K,) to ``b`` (K,), both prepared, minus its expectation by chance."""
    # the largest over three horizons: one sample, a fifth of the memory, and their geometric mean; at a high sampling
    # rate one sample ahead shows noise alone
    widest = min(max(1, memory(b) // STRETCHES_OF_MEMORY), max(1, b.size // FEWEST_STRETCHES))
    return max(_influence(a, b, width) for width in {1, round(widest**0.5), widest})


def _influence(a: FloatArray, b: FloatArray, width: int) -> float:
    """Return the measure for stretches of ``width`` samples; the regressors are their last values and means."""
    count = b.size // width
    order = min(ORDER, count // 16)
    if order < 1:
        return 0.0
    now = _stretches(b, width)[0][order:]
    own, others = [np.ones(now.size)], list[FloatArray]()
    for signal, columns in ((b, own), (a, others)):
        for past in _stretches(signal, width):
            columns += [past[order - lag : count - lag] for lag in range(1, order + 1)]
    alone, both = _residual(own, now), _residual([*own, *others], now)
    floor = np.exp(-CEILING) * float(now @ now) + np.finfo(float).tiny
    by_chance = 2 * order / max(1, now.size - 4 * order - 1)
    return max(0.0, float(np.log((alone + floor) / (both + floor))) - 2.0 * by_chance)


def _stretches(signal: FloatArray, width: int) -> tuple[FloatArray, FloatArray]:
    """Return the last value and the mean of each stretch of a signal."""
    stretches = signal[: signal.size // width * width].reshape(-1, width)
    return stretches[:, -1], stretches.mean(axis=1)


def _residual(columns: list[FloatArray], target: FloatArray) -> float:
    regressors = np.column_stack(columns)
    solution = np.linalg.lstsq(regressors, target, rcond=1e-10)[0]
    residual = target - regressors @ solution
    return float(residual @ residual)


def memory(b: FloatArray) -> int:
    """Return the lag at which the autocorrelation of a prepared signal falls to 1/e, in samples."""
    sums = _correlation(b, b)
    low = np.flatnonzero(sums <= sums[0] / np.e)
    return int(low[0]) if low.size else b.size


def _correlation(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the sums of a[k] b[k + lag] for the lags 0 .. K - 1."""
    size = 1 << (2 * a.size - 1).bit_length()
    product = np.conj(np.fft.rfft(a, size)) * np.fft.rfft(b, size)
    return np.asarray(np.fft.irfft(product, size)[: a.size])


@dataclass(frozen=True)
class Response:
    """The response that the cross-correlation of an input and an output shows; lags in samples."""

    # lag at which the response seems to begin, counted from the first sample after a change of the input: a dead time,
    # or the slow start of a plant with several poles
    delay: float
    half: int  # lag at which the response reaches half its value at ``peak``
    peak: int  # lag of the largest correlation
    correlation: float  # correlation of input changes with output changes over the lag ``peak``


def response(u: FloatArray, y: FloatArray) -> Response | None:
    """Return the response of ``y`` (K,) to the whitened ``u`` (K,); None if it is not significant."""
    changes = _whitened(u)
    if not np.abs(changes).max(initial=0.0) > ROUNDING:  # the input moves only within the first samples
        return None
    longest = min(u.size // 4, 50 + 5 * memory(y))
    now = changes[1:]
    before = float(now @ y[:-1])
    sums = _correlation(now, y[1:])[:longest] - before
    if not sums.size:
        return None
    # the root mean square, at 40 lags and between them by interpolation, bounds the correlation by one
    lags = np.unique(np.geomspace(1, max(longest, 2), 40).astype(int) - 1)
    spread = np.array([np.sqrt(np.mean((y[1 + lag :] - y[: y.size - 1 - lag]) ** 2)) for lag in lags])
    spread = np.interp(np.arange(longest), lags, spread)
    correlation = sums / np.maximum(float(np.sqrt(now @ now)) * spread * np.sqrt(now.size), np.finfo(float).tiny)
    significant = np.abs(correlation) > CHANCE / np.sqrt(now.size)
    if not significant.any():
        return None
    best = int(np.argmax(np.where(significant, np.abs(correlation), 0.0)))
    rising = np.sign(sums[best]) * sums[: best + 1] / abs(sums[best])
    fifth, half = _crossing(rising, 0.2), _crossing(rising, 0.5)
    onset = fifth - (half - fifth) * 0.2 / 0.3
    return Response(max(0.0, onset - 1.0), round(half), best, float(np.clip(correlation[best], -1.0, 1.0)))


def _crossing(rising: FloatArray, level: float) -> float:
    """Return the position at which a curve that ends at 1 last rises through ``level``, between two samples."""
    below = np.flatnonzero(rising < level)
    if not below.size:
        return 0.0
    at = int(below[-1])
    return float(at + (level - rising[at]) / (rising[at + 1] - rising[at]))


def _whitened(u: FloatArray) -> FloatArray:
    """Return the residual of an autoregression of ``u`` (K,); zero over the first samples."""
    order = min(WHITENING, u.size // 10)
    if order < 1:
        return np.zeros(u.size)
    past = np.column_stack([u[order - lag : u.size - lag] for lag in range(1, order + 1)])
    model = np.linalg.lstsq(past, u[order:], rcond=1e-10)[0]
    return np.concatenate([np.zeros(order), u[order:] - past @ model])


MOST_SIGNALS = 16  # columns that are compared in pairs as input and output [count]
FEWEST_ROWS = 20  # fewest rows for the measure of influence [rows]
BY_INFLUENCE, BY_SHAPE = 2.0, 1.0
"""Weights of the influence, and of the shape: an input moves in steps and has the shorter memory [number].
Origin: input and output are found in all recorded open-loop logs, with their names and without.
Sensitivity: halved or doubled, nothing changes on these records.
"""
BY_NAME = 2.0
"""Weight of a column's name: added if it indicates the role, subtracted if it indicates another role [number].
Origin: a pump's "speed" is its input if it moves in steps and the flow follows it; under a controller the names decide.
Sensitivity: halved, nothing changes on the recorded logs; doubled, the pump's speed is taken for its output.
"""
CLOSE = 0.25 * BY_INFLUENCE  # difference of both directions' scores below which the direction is uncertain [number]
NOTABLE = 0.02
"""Smallest influence that counts [number].
Origin: 2 % less residual power, beyond the expectation by chance.
Sensitivity: halved or doubled, nothing changes on these records.
"""
FEEDBACK, ANSWERS = 0.1, 0.1
"""Influence of the output on the input from which a controller is suspected: by itself, and as a part of the influence
of the input on the output [number].
Origin: above the recorded open-loop logs, which reach 0.07, and below those of the motor under a controller.
Sensitivity: halved or doubled, nothing changes on these records.
"""
SAME_RANGE = 0.25
"""Largest difference in mean and in spread at which an output follows a set-point [part of the larger spread].
Origin: a usual tolerance.
Sensitivity: halved or doubled, nothing changes on these records.
"""

INPUT, OUTPUT, REFERENCE = "input", "output", "reference"
_WORDS = {
    INPUT: "u in input inputs udat cmd command voltage volt volts pwm duty heater heat valve throttle drive actuator "
    "control mv co power uin q",
    OUTPUT: "y out output outputs ydat speed velocity vel position pos angle temperature temp level pressure "
    "displacement measured measurement sensor pv omega rpm yout",
    REFERENCE: "r ref yref reference setpoint sp set target desired demand w rref",
}
_ROLE_OF = {word: role for role, words in _WORDS.items() for word in words.split()}


@dataclass(frozen=True)
class Role:
    """A column for a role, and why it was chosen."""

    column: Column
    why: str


@dataclass(frozen=True)
class Roles:
    """The probable roles of a log's columns."""

    input: Role | None = None
    output: Role | None = None
    reference: Role | None = None
    answers: bool = False  # whether the input also follows the output, as under a controller
    either: bool = False  # whether input and output could equally be exchanged


def role_by_name(name: str) -> str | None:
    """Return the role that a column's name indicates; None if it indicates none."""
    core = re.sub(r"[\[(].*$", "", name.rpartition(".")[2])
    words = [word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+", core)]
    if "set" in words and "point" in words:
        return REFERENCE
    roles = [_ROLE_OF[word] for word in words if word in _ROLE_OF]
    return REFERENCE if REFERENCE in roles else roles[-1] if roles else None


def find_roles(columns: list[Column], values: dict[int, FloatArray], given: dict[str, int] | None = None) -> Roles:
    """Return the probable roles of ``columns``; ``given`` holds the columns of known roles."""
    known = given or {}
    # if there are too many columns, the given ones and those with an indicative name are kept
    preferred = sorted(
        columns, key=lambda column: (column.number not in known.values(), role_by_name(column.name) is None)
    )
    signals = {column.number: column for column in preferred[:MOST_SIGNALS]}
    ready = {number: prepared(values[number]) for number in signals}
    forces = _Forces(ready)
    inputs, outputs = (_candidates(signals, role, known) for role in (INPUT, OUTPUT))
    pairs = [(u, y) for u, y in product(inputs, outputs) if u != y]
    if not pairs:
        given_roles = {role: Role(signals[number], "as given") for role, number in known.items() if number in signals}
        return Roles(given_roles.get(INPUT), given_roles.get(OUTPUT))
    u, y = max(pairs, key=lambda pair: _score(signals[pair[0]], signals[pair[1]], forces))
    r = next((n for n in signals if n not in (u, y) and role_by_name(signals[n].name) == REFERENCE), None)
    why_r = "its name"
    if r is None and not known and (third := _input_beside(u, y, signals, values, forces)) is not None:
        u, r, why_r = third, u, f"{signals[y].name!r} takes its values"
    there, back = forces.of(u, y), forces.of(y, u)
    free = not known and u in outputs and y in inputs
    return Roles(
        Role(signals[u], "as given" if INPUT in known else _why(signals[u], signals[y], INPUT, there, back)),
        Role(signals[y], "as given" if OUTPUT in known else _why(signals[y], signals[u], OUTPUT, there, back)),
        None if r is None else Role(signals[r], why_r),
        back > FEEDBACK and back > ANSWERS * there,
        free and abs(_score(signals[u], signals[y], forces) - _score(signals[y], signals[u], forces)) < CLOSE,
    )


def seem_swapped(u: FloatArray, y: FloatArray) -> bool:
    """Return whether ``y`` (K,) acts on ``u`` (K,) and not ``u`` on ``y``, as if output and input were exchanged.

    A controller that only disturbances move looks alike, but its input follows from the output without noise.  The
    evidence must outweigh a name, as the roles were stated.
    """
    heads = u[:MOST_SAMPLES], y[:MOST_SAMPLES]
    forces = _Forces(dict(enumerate(map(prepared, heads))))
    a, b = (describe(number, "", head) for number, head in enumerate(heads))
    there, back = forces.of(0, 1), forces.of(1, 0)
    one_sided = back > FEEDBACK and there <= ANSWERS * back
    return one_sided and _score(b, a, forces) - _score(a, b, forces) > BY_NAME and not is_computed(*heads)


class _Forces:
    """The influence for each pair of signals, and the memory of each signal; each is computed once."""

    def __init__(self, ready: dict[int, FloatArray]) -> None:
        self._ready, self._found = ready, dict[tuple[int, int], float]()
        self.memory = {number: memory(signal) for number, signal in ready.items()}

    def of(self, a: int, b: int) -> float:
        if (a, b) not in self._found:
            short = self._ready[a].size < FEWEST_ROWS
            self._found[a, b] = 0.0 if short else influence(self._ready[a], self._ready[b])
        return self._found[a, b]


def _candidates(signals: dict[int, Column], role: str, known: dict[str, int]) -> list[int]:
    """Return the candidates for a role: the given column, else all but references unless fewer than two remain."""
    if role in known:
        return [number for number in (known[role],) if number in signals]
    others = [column for number, column in signals.items() if number not in known.values()]
    # if one column is given, a reference may be its partner
    rest = [column.number for column in others if known or role_by_name(column.name) != REFERENCE]
    return rest if len(rest) > 1 or known else [column.number for column in others]


def _name_score(column: Column, role: str) -> float:
    """Return 1 if a column's name indicates this role, -1 if it indicates another, 0 if it indicates none."""
    indicated = role_by_name(column.name)
    return 0.0 if indicated is None else 1.0 if indicated == role else -1.0


def _score(a: Column, b: Column, forces: _Forces) -> float:
    """Return a score for ``a`` as the input and ``b`` as the output."""
    there, back = forces.of(a.number, b.number), forces.of(b.number, a.number)
    direction = (there - back) / (there + back + NOTABLE)
    strength = there / (there + 0.1)
    quick, slow = forces.memory[a.number], forces.memory[b.number]
    smoother = (slow - quick) / max(1, slow + quick)  # a plant smooths: its output has the longer memory
    names = _name_score(a, INPUT) + _name_score(b, OUTPUT)
    return BY_INFLUENCE * (0.5 * direction + 0.5 * strength) + BY_SHAPE * (a.held - b.held + smoother) + BY_NAME * names


def _input_beside(
    a: int, y: int, signals: dict[int, Column], values: dict[int, FloatArray], forces: _Forces
) -> int | None:
    """Return the input if ``a`` is a set-point that ``y`` follows and a third signal drives ``y``; else None."""
    if role_by_name(signals[a].name) == INPUT or not _follows(values[a], values[y]):
        return None
    others = [n for n in signals if n not in (a, y) and role_by_name(signals[n].name) in (None, INPUT)]
    others = [n for n in others if forces.of(n, y) > NOTABLE]
    return max(others, key=lambda n: _score(signals[n], signals[y], forces), default=None)


def _follows(r: FloatArray, y: FloatArray) -> bool:
    """Return whether ``y`` has nearly the mean and the spread of ``r``, and is correlated with it."""
    both = np.isfinite(r) & np.isfinite(y)
    if not both.any():
        return False
    spread = max(float(r[both].std()), float(y[both].std()))
    apart = abs(float(r[both].mean() - y[both].mean())), abs(float(r[both].std() - y[both].std()))
    correlation = float(np.corrcoef(r[both], y[both])[0, 1]) if spread > 0.0 else 0.0
    return spread > 0.0 and max(apart) <= SAME_RANGE * spread and correlation > 0.5


def _why(column: Column, other: Column, role: str, there: float, back: float) -> str:
    reasons = ["its name"] if role_by_name(column.name) == role else []
    if there > NOTABLE and there > back:
        reasons.append(f"{other.name!r} follows it" if role == INPUT else f"it follows {other.name!r}")
    if role == INPUT and column.held > 0.5 and column.held > other.held:
        reasons.append("it moves in steps")
    return ", ".join(reasons) or "no column fits better"
