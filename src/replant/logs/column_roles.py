r"""Which columns of a log look like input, output and reference: by their names, their shapes and who follows whom.

Who follows whom is Geweke's measure of what the past of a adds to the past of b,

.. math:: F_{a \to b} = \ln \frac{\text{residual power of } b \text{ from its own past}}
          {\text{residual power of } b \text{ from its own past and that of } a},

large for an input a of the output b, and near zero the other way round, unless a controller closes the loop.

Source: Geweke (1982), "Measurement of linear dependence and feedback between multiple time series".
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import product

import numpy as np

from replant.logs.columns import Column
from replant.numerics.arguments import FloatArray

MOST_SAMPLES = 1 << 16  # samples that the measures are taken from [samples]
ORDER = 3  # past stretches of each signal [count]
STRETCHES_OF_MEMORY = 5  # stretches in the time over which the output's correlation with itself falls to 1/e [count]
FEWEST_STRETCHES = 200  # stretches that a record is cut into, if it has as many samples [count]
SPREAD = 20.0  # distance from the median beyond which a value is cut off [ranges of the middle 90 %]
CEILING = 10.0  # largest measure: a residual of 1/150 of the other is a rounding error [number]
CHANCE = 4.5  # correlation that is no chance at any of thousands of lags [standard deviations]
WHITENING = 8  # order of the autoregression that whitens the input [count]
ROUNDING = 1e-9  # change of a prepared input that is rounding [its standard deviation]


def prepared(values: FloatArray) -> FloatArray:
    """Return a signal (K,) for the measures: at most `MOST_SAMPLES`, gaps interpolated, scaled to unit power."""
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
    """Return Geweke's measure from ``a`` (K,) to ``b`` (K,), both prepared, less what chance would give."""
    # the largest of three: one sample ahead, a fifth of the memory ahead, and over the geometric mean of both; where
    # the sampling rate is high nothing can be foretold from one sample to the next but noise
    widest = min(max(1, memory(b) // STRETCHES_OF_MEMORY), max(1, b.size // FEWEST_STRETCHES))
    return max(_influence(a, b, width) for width in {1, round(widest**0.5), widest})


def _influence(a: FloatArray, b: FloatArray, width: int) -> float:
    """Return the measure for stretches of ``width`` samples: of each the last value and the mean are the past."""
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
    """What the cross-correlation of an input and an output shows; lags in samples."""

    # lag at which the response seems to begin, behind the first sample after a change of the input: a dead time, or the
    # slow beginning of a plant with several poles
    delay: float
    half: int  # lag of half the response at ``peak``
    peak: int  # lag of the largest correlation
    correlation: float  # that of the changes of the input with the changes of the output up to that lag


def response(u: FloatArray, y: FloatArray) -> Response | None:
    """Return the response of ``y`` (K,) to the changes of ``u`` (K,) beyond its own past; None if by chance."""
    changes = _whitened(u)
    if not np.abs(changes).max(initial=0.0) > ROUNDING:  # all moves lie within the samples that foretell the others
        return None
    longest = min(u.size // 4, 50 + 5 * memory(y))
    now = changes[1:]
    before = float(now @ y[:-1])
    sums = _correlation(now, y[1:])[:longest] - before
    if not sums.size:
        return None
    # the root mean square, as with it the correlation is at most one
    spread = np.array([np.sqrt(np.mean((y[1 + lag :] - y[: y.size - 1 - lag]) ** 2)) for lag in _few(longest)])
    spread = np.interp(np.arange(longest), _few(longest), spread)
    correlation = sums / np.maximum(float(np.sqrt(now @ now)) * spread * np.sqrt(now.size), np.finfo(float).tiny)
    significant = np.abs(correlation) > CHANCE / np.sqrt(now.size)
    if not significant.any():
        return None
    best = int(np.argmax(np.where(significant, np.abs(correlation), 0.0)))
    rising = np.sign(sums[best]) * sums[: best + 1] / abs(sums[best])
    fifth, half = _crossing(rising, 0.2), _crossing(rising, 0.5)
    onset = fifth - (half - fifth) * 0.2 / 0.3
    return Response(max(0.0, onset - 1.0), round(half), best, float(np.clip(correlation[best], -1.0, 1.0)))


def _few(longest: int) -> FloatArray:
    """Return some lags, evenly spaced in their logarithm."""
    return np.unique(np.geomspace(1, max(longest, 2), 40).astype(int) - 1)


def _crossing(rising: FloatArray, level: float) -> float:
    """Return the position at which a curve that ends at 1 last rises through ``level``, between two samples."""
    below = np.flatnonzero(rising < level)
    if not below.size:
        return 0.0
    at = int(below[-1])
    return float(at + (level - rising[at]) / (rising[at + 1] - rising[at]))


def _whitened(u: FloatArray) -> FloatArray:
    """Return what the past of ``u`` (K,) does not foretell of it; zero over the first samples."""
    order = min(WHITENING, u.size // 10)
    if order < 1:
        return np.zeros(u.size)
    past = np.column_stack([u[order - lag : u.size - lag] for lag in range(1, order + 1)])
    model = np.linalg.lstsq(past, u[order:], rcond=1e-10)[0]
    return np.concatenate([np.zeros(order), u[order:] - past @ model])


MOST_SIGNALS = 16  # columns among which input and output are looked for; all pairs of them are compared [count]
FEWEST_ROWS = 20  # rows from which on who follows whom is asked [rows]
BY_INFLUENCE, BY_SHAPE = 2.0, 1.0
"""Weights of who follows whom, and of moving in steps and quickly [number].
Origin: input and output come out right for the recorded logs of open loops, with their names and without.
Sensitivity: halved or doubled, nothing changes on these records.
"""
BY_NAME = 2.0
"""Weight of a name that tells a role: for it, and against another one [number].
Origin: a pump's "speed" is its input where it moves in steps and the flow follows it; under a controller names decide.
Sensitivity: halved, nothing changes on the recorded logs; doubled, the pump's speed is taken for its output.
"""
CLOSE = 0.25 * BY_INFLUENCE  # difference of both directions' scores below which either may be the right one [number]
NOTABLE = 0.02
"""Measure of influence below which nothing is said [number].
Origin: 2 % less residual power; chance is subtracted before.
Sensitivity: halved or doubled, nothing changes on these records.
"""
FEEDBACK, ANSWERS = 0.1, 0.1
"""Influence of the output on the input from which on a controller is suspected: by itself, and as a part of that the
other way [number].
Origin: above the recorded logs of open loops, which reach 0.07, and below those of the motor under a controller.
Sensitivity: halved or doubled, nothing changes on these records.
"""
SAME_RANGE = 0.25
"""Difference of mean and of spread up to which an output takes the values of a set-point [part of the larger spread].
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
    """A column, what it looks like, and why."""

    column: Column
    why: str


@dataclass(frozen=True)
class Roles:
    """What the columns of a log look like."""

    input: Role | None = None
    output: Role | None = None
    reference: Role | None = None
    answers: bool = False  # whether the input also follows the output, as under a controller
    either: bool = False  # whether input and output may as well be the other way round


def role_by_name(name: str) -> str | None:
    """Return the role that a column's name tells, or None."""
    core = re.sub(r"[\[(].*$", "", name.rpartition(".")[2])
    words = [word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+", core)]
    if "set" in words and "point" in words:
        return REFERENCE
    roles = [_ROLE_OF[word] for word in words if word in _ROLE_OF]
    return REFERENCE if REFERENCE in roles else roles[-1] if roles else None


def find_roles(columns: list[Column], values: dict[int, FloatArray], given: dict[str, int] | None = None) -> Roles:
    """Return what ``columns`` look like."""
    known = given or {}
    telling = sorted(
        columns, key=lambda column: (column.number not in known.values(), role_by_name(column.name) is None)
    )
    signals = {column.number: column for column in telling[:MOST_SIGNALS]}
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


class _Forces:
    """The measure of influence for each pair of signals, and the memory of each signal, computed once."""

    def __init__(self, ready: dict[int, FloatArray]) -> None:
        self._ready, self._found = ready, dict[tuple[int, int], float]()
        self.memory = {number: memory(signal) for number, signal in ready.items()}

    def of(self, a: int, b: int) -> float:
        if (a, b) not in self._found:
            short = self._ready[a].size < FEWEST_ROWS
            self._found[a, b] = 0.0 if short else influence(self._ready[a], self._ready[b])
        return self._found[a, b]


def _candidates(signals: dict[int, Column], role: str, known: dict[str, int]) -> list[int]:
    """Return the columns for a role: the one given, else all but references; these, too, where one or none is left."""
    if role in known:
        return [number for number in (known[role],) if number in signals]
    others = [column for number, column in signals.items() if number not in known.values()]
    # beside a column that is given a reference may be the other
    rest = [column.number for column in others if known or role_by_name(column.name) != REFERENCE]
    return rest if len(rest) > 1 or known else [column.number for column in others]


def _fits(column: Column, role: str) -> float:
    """Return whether a column's name tells a role, 1, or another one, -1; 0 where it tells none."""
    told = role_by_name(column.name)
    return 0.0 if told is None else 1.0 if told == role else -1.0


def _score(a: Column, b: Column, forces: _Forces) -> float:
    """Return how well ``a`` and ``b`` fit as input and output."""
    there, back = forces.of(a.number, b.number), forces.of(b.number, a.number)
    direction = (there - back) / (there + back + NOTABLE)
    strength = there / (there + 0.1)
    quick, slow = forces.memory[a.number], forces.memory[b.number]
    smoother = (slow - quick) / max(1, slow + quick)  # a plant smooths: its output has the longer memory
    names = _fits(a, INPUT) + _fits(b, OUTPUT)
    return BY_INFLUENCE * (0.5 * direction + 0.5 * strength) + BY_SHAPE * (a.held - b.held + smoother) + BY_NAME * names


def _input_beside(
    a: int, y: int, signals: dict[int, Column], values: dict[int, FloatArray], forces: _Forces
) -> int | None:
    """Return the input, where ``a`` is a set-point that ``y`` follows and a third signal lies between the two."""
    if role_by_name(signals[a].name) == INPUT or not _follows(values[a], values[y]):
        return None
    others = [n for n in signals if n not in (a, y) and role_by_name(signals[n].name) in (None, INPUT)]
    others = [n for n in others if forces.of(n, y) > NOTABLE]
    return max(others, key=lambda n: _score(signals[n], signals[y], forces), default=None)


def _follows(r: FloatArray, y: FloatArray) -> bool:
    """Return whether ``y`` lies in the range of ``r``, about its mean, and with its spread."""
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
    return ", ".join(reasons) or "nothing speaks against it"
