"""A bank of filters 1/D(s) in scaled companion states, exact over any interval.

One bank holds a denominator D(s), six channels of n states each, and its discretisations.  The states of a channel
driven by x are w_i = c^(n-i) s^i / D(s) x for i = n-1 .. 0 (see `replant.model.state_space`).  The channels:

    OUTPUT    the measured output, linear between samples
    INPUT     the input after the dead time, held or linear between samples
    MODEL     the signal for instruments, linear between samples: the predicted output, or with a reference the part of
              the output that it explains
    IMPULSE   an impulse at the beginning: the contribution of an unknown initial state
    CONSTANT  one: the contribution of an unknown offset
    REFERENCE_INPUT  the part of the input that the reference explains, as the input; idle without a reference

If D is the denominator A of a stable model B/A, the model's output is a weighted sum of the INPUT, CONSTANT and IMPULSE
states, without discretisation error.  For an unstable model D is A with its poles reflected in the imaginary axis.  Its
residual e = A/D y - B/D u is white if the model's own is, as abs(A/D) = 1.  Its predicted output is the y that makes e
zero.

Discretisations are stored by their interval.  The exponential is computed by scaling and squaring of a Taylor series:
scaling leaves a norm of 1, for which eighteen terms reach 1e-17.
"""

from replant.kernels.native import Reals, inlined, kernel

OUTPUT, INPUT, MODEL, IMPULSE, CONSTANT, REFERENCE_INPUT = range(6)
CHANNELS = 6  # channels of a bank [count]

# --- a bank's numbers
SCALE = 0  # place of c among a bank's numbers [index]
MODEL_OUTPUT = 1  # place of the auxiliary model's predicted output at the newest sample [index]
NEXT = 2  # place of the index of the discretisation to be replaced next [index]
REFLECTED = 3  # place of a flag: whether D is the auxiliary model's A with its poles reflected [index]
INSTRUMENT = 4  # place of the signal of the MODEL channel at the newest sample [index]
# after it follow: the characteristic d_i / c^(n-i), (n,); the gains from state to scaled regressor entry, (T,); the
# weights, which are the auxiliary model's scaled parameters, (T,); the states, (6 n,); KEPT discretisations: interval,
# Ad (n^2), constant (n), ramp (n)
DENOMINATOR = 5  # place of d_(n-1) .. d_0, (n,) [index]
# a regular clock needs one, a fractional dead time three, a clock with jitter a new one each time
KEPT = 4  # discretisations kept [count]
# far below a jitter that matters, far above the rounding of differences of stamps
SAME_INTERVAL = 1e-9  # difference of two intervals up to which they share a discretisation [part of the interval]


def at_gain(n):
    """Return where the gains begin."""
    return DENOMINATOR + 2 * n


def at_weights(n, T):
    """Return where the auxiliary model's parameters begin."""
    return DENOMINATOR + 2 * n + T


def at_states(n, T):
    """Return where the states begin."""
    return DENOMINATOR + 2 * n + 2 * T


def at_kept(n, T):
    """Return where the discretisations begin."""
    return DENOMINATOR + 2 * n + 2 * T + CHANNELS * n


def whole_power(base, exponent):
    """Return base^exponent for exponent 0, 1, 2 .. by repeated squaring, which gives the same bits everywhere."""
    result = 1.0
    while exponent != 0:
        if exponent % 2 == 1:
            result *= base
        exponent //= 2
        base *= base
    return result


def size(n: int, T: int) -> int:
    """Return how many numbers a bank has."""
    return DENOMINATOR + 2 * n + 2 * T + CHANNELS * n + KEPT * (1 + n * n + 2 * n)


@kernel(
    "1 <= n < 1000 and 0 <= inputs <= n + 1 and 0 <= T < 1000000",
    "T >= n + inputs + (1 + n if nuisances else (1 if constant else 0))",
    "denominator.size >= n and sigma.size >= T and bank.size >= size(n, T)",
)
def set_denominator(
    bank: Reals, n: int, T: int, inputs: int, constant: bool, nuisances: bool, fixed: bool, denominator: Reals,
    sigma: Reals,
):  # fmt: skip
    """Set the bank's denominator d_{n-1} .. d_0; ``fixed``: the regressor's constant is one, as in (24)."""
    c = abs(denominator[n - 1]) ** (1.0 / n)
    if not c > 0.0:
        for i in range(n):
            c = max(c, abs(denominator[i]) ** (1.0 / (i + 1)))
    if not c > 0.0:
        c = 1.0
    bank[SCALE] = c
    scale = 1.0
    gain = DENOMINATOR + 2 * n
    characteristic = DENOMINATOR + n
    for i in range(n):  # entry i belongs to s^(n-1-i), scaled by c^(i+1)
        scale *= c
        bank[DENOMINATOR + i] = denominator[i]
        bank[characteristic + i] = denominator[i] / scale
        bank[gain + i] = -1.0 / (scale * sigma[i])
        j = i - (n - inputs)
        if j >= 0:
            bank[gain + n + j] = 1.0 / (scale * sigma[n + j])
        if nuisances:
            bank[gain + n + inputs + 1 + i] = 1.0 / (scale * sigma[n + inputs + 1 + i])
    if inputs == n + 1:  # as many zeros as poles: the first entry is s^n/D u
        bank[gain + n] = 1.0 / sigma[n]
    if constant:
        last = 1.0 if fixed else whole_power(c, n)
        bank[gain + n + inputs] = 1.0 / (last * sigma[n + inputs])
    kept, size = DENOMINATOR + 2 * n + 2 * T + CHANNELS * n, 1 + n * n + 2 * n
    for slot in range(KEPT):
        bank[kept + slot * size] = -1.0


def discretization(bank, n, T, interval, work):
    """Return the place in the bank of the exact solution over ``interval``; compute it if it is missing."""
    kept, size = at_kept(n, T), 1 + n * n + 2 * n
    intervals = bank[kept:]
    for slot in range(KEPT):
        if abs(intervals[slot * size] - interval) <= SAME_INTERVAL * interval:
            return kept + slot * size
    return new_discretization(bank, n, T, interval, work)


def new_discretization(bank, n, T, interval, work):
    """Compute the exact solution over ``interval`` in place of the oldest one; return its place."""
    size = 1 + n * n + 2 * n
    slot = int(bank[NEXT])
    bank[NEXT] = (slot + 1) % KEPT
    at = at_kept(n, T) + slot * size
    wide = n + 2
    power, spare = work[: wide * wide], work[wide * wide :]
    # one exponential gives Ad and the responses to a constant and to a ramp from 0 to 1 (Van Loan, 1978)
    exponential(n, bank[SCALE] * interval, bank[DENOMINATOR + n : DENOMINATOR + 2 * n], power, spare)
    bank[at] = interval
    for i in range(n):
        for j in range(n):
            bank[at + 1 + i * n + j] = power[i * wide + j]
        bank[at + 1 + n * n + i] = power[i * wide + n]
        bank[at + 1 + n * n + n + i] = power[i * wide + n + 1]
    return at


def advance_states(n, solution, start, rise, x, new):
    """Advance the states x by one interval of a ``solution``; the signal begins at ``start`` and rises linearly."""
    A, constant, ramp = solution, n * n, n * n + n
    for i in range(n):
        total = solution[constant + i] * start + solution[ramp + i] * rise
        for j in range(n):
            total += A[i * n + j] * x[j]
        new[i] = total
    for i in range(n):
        x[i] = new[i]


@inlined
def follow_two(A, constant, ramp, states, new, start, rise, other_start, other_rise):
    """Compute the ``new`` states (2 n,) of two channels after one interval, as `advance_states` does, to the same bits.

    Ad is loaded once for both; their signals begin at ``start`` and ``other_start``.
    """
    n = constant.size
    x, z, new_x, new_z = states, states[n:], new, new[n:]
    for i in range(n):
        row = A[i * n :]
        total = constant[i] * start + ramp[i] * rise
        other = constant[i] * other_start + ramp[i] * other_rise
        for j in range(n):
            total += row[j] * x[j]
            other += row[j] * z[j]
        new_x[i] = total
        new_z[i] = other


@inlined
def settle(states, new):
    """Replace the states by the new ones."""
    for i in range(states.size):
        states[i] = new[i]


def advance_channel(bank, n, T, channel, at, start, end, work):
    """Advance one channel by the interval of the discretisation ``at``; its signal is linear from start to end."""
    states = at_states(n, T) + channel * n
    advance_states(n, bank[at + 1 :], start, end - start, bank[states:], work)


def advance_two(bank, n, T, at, first, start, end, other_start, other_end, work):
    """Advance the ``first`` of two channels and the next one as `advance_channel` does."""
    begin, constant = at_states(n, T) + first * n, at + 1 + n * n
    ramp, states, new = constant + n, bank[begin : begin + 2 * n], work[: 2 * n]
    rise, other_rise = end - start, other_end - other_start
    A, c, r = bank[at + 1 : constant], bank[constant:ramp], bank[ramp : ramp + n]
    follow_two(A, c, r, states, new, start, rise, other_start, other_rise)
    settle(states, new)


def take_states(bank, other, n, T):
    """Copy the states of another bank, converted to this bank's time scale."""
    ratio = bank[SCALE] / other[SCALE]
    states = DENOMINATOR + 2 * n + 2 * T
    for channel in range(CHANNELS):
        factor = 1.0
        for i in range(n):
            factor *= ratio
            bank[states + channel * n + i] = other[states + channel * n + i] * factor
    bank[MODEL_OUTPUT] = other[MODEL_OUTPUT]
    bank[INSTRUMENT] = other[INSTRUMENT]


def begin(bank, n, T):
    """Set every channel to rest, except for the impulse, which acts now."""
    states = DENOMINATOR + 2 * n + 2 * T
    for i in range(CHANNELS * n):
        bank[states + i] = 0.0
    bank[states + IMPULSE * n] = bank[SCALE]
    bank[MODEL_OUTPUT] = 0.0
    bank[INSTRUMENT] = 0.0


def fill_known_entries(s, bank, channel, u, constant, fixed, phi):
    """Fill the regressor's entries of input, constant and initial state; return the auxiliary model's output from them.

    The entries of the input are s^m/D u .. s^0/D u; its filter is ``channel``, and ``u`` is its delayed value now.
    """
    n, T, inputs, nuisances = s.order, s.entries, s.input_entries, s.refined
    characteristic, gain, weights, states = DENOMINATOR + n, at_gain(n), at_weights(n, T), at_states(n, T)
    proper, last = min(inputs, n), n + inputs
    w, first = states + channel * n + n - proper, n + inputs - proper
    for i in range(proper):
        phi[first + i] = bank[gain + first + i] * bank[w + i]
    if inputs == n + 1:  # as many zeros as poles: the first entry is s^n/D u
        highest = u
        for i in range(n):
            highest -= bank[characteristic + i] * bank[w + i]
        phi[n] = bank[gain + n] * highest
    if constant:
        phi[last] = bank[gain + last] * (1.0 if fixed else bank[states + CONSTANT * n + n - 1])
    if nuisances:
        for i in range(n):
            phi[last + 1 + i] = bank[gain + last + 1 + i] * bank[states + IMPULSE * n + i]
    output = 0.0
    for i in range(n, T):
        output += bank[weights + i] * phi[i]
    return output


def fill_output_entries(bank, n, T, channel, y, phi):
    """Fill -s^(n-1)/D y .. -s^0/D y for the signal of this channel, whose present value is ``y``; return s^n/D y."""
    characteristic, gain, w = DENOMINATOR + n, at_gain(n), at_states(n, T) + channel * n
    highest = y
    for i in range(n):
        phi[i] = bank[gain + i] * bank[w + i]
        highest -= bank[characteristic + i] * bank[w + i]
    return highest


def predicted_output(bank, n, T, solution, last, known, states, new):
    """Return the output y that makes the residual y - s' w - ``known`` zero: the prediction of an unstable model.

    w are the OUTPUT states; s = characteristic + gain * weights is zero if D = A.  As the output is linear from
    ``last`` to y, w depends on y: w = w_0 + r y.

    ``states`` (n,): those at the previous sample, overwritten by w_0; ``solution``: the discretisation; ``known``: the
    part of the model's output that comes from inputs, constant and initial state; ``new`` (n,) is work.
    """
    characteristic, gain, weights, ramp = DENOMINATOR + n, at_gain(n), at_weights(n, T), n * n + n
    advance_states(n, solution, last, -last, states, new)
    total, left = known, 1.0
    for i in range(n):
        share = bank[characteristic + i] + bank[gain + i] * bank[weights + i]
        total += share * states[i]
        left -= share * solution[ramp + i]
    return total / left


# 1 / 19! is 8e-18, below the precision of float64
_TERMS = 18  # terms of the Taylor series [count]
_LARGEST_NORM = 1.0  # largest norm for the series; a larger matrix is halved [norm]
_MOST_SQUARINGS = 1000  # most halvings, reached only if the norm is not finite [count]
_LEAST_RATE = 1e-300  # least rate that is divided by: over no time the ramp moves no state [rate]


def exponential(n, rate, characteristic, result, work):
    """Write the exponential E of a companion matrix M extended by a constant and a ramp, (n + 2)^2 numbers.

    The first row of M is -rate d_(n-1) .. -rate d_0, rate, 0; below the diagonal are rates; row n ends with a one, the
    slope of the ramp.  As M E = E M, each row of the states in E is the next row times M / rate: the series is that of
    the last of them alone.
    """
    size = 0.0
    for i in range(n):
        size += abs(rate * characteristic[i])
    norm = max(1.0, size + abs(rate))
    squarings = 0
    factor = 1.0
    while norm * factor > _LARGEST_NORM and squarings < _MOST_SQUARINGS:
        factor *= 0.5
        squarings += 1
    wide = n + 2
    total, row = work[:wide], work[wide:]
    for j in range(wide):
        total[j] = row[j] = 1.0 if j == n - 1 else 0.0
    for term in range(1, _TERMS + 1):
        _times(n, rate * factor / term, characteristic, factor / term, row)
        for j in range(wide):
            total[j] += row[j]
    for i in range(n - 1, -1, -1):
        for j in range(wide):
            result[i * wide + j] = total[j]
        _times(n, 1.0, characteristic, 1.0 / max(rate, _LEAST_RATE), total)
    for i in range(n * wide, wide * wide):
        result[i] = 0.0
    result[n * wide + n] = result[wide * wide - 1] = 1.0
    result[n * wide + n + 1] = factor
    for _ in range(squarings):
        _square(n, result, work)


def _times(n, rate, characteristic, slope, row):
    """Multiply a row (n + 2,) by the matrix of `exponential` with this rate and slope, in place."""
    first, constant = row[0], row[n]
    for j in range(n - 1):
        row[j] = rate * (row[j + 1] - characteristic[j] * first)
    row[n - 1] = -rate * characteristic[n - 1] * first
    row[n] = rate * first
    row[n + 1] = slope * constant


def _square(n, power, work):
    """Square an exponential in place; its last two rows are those of constant and ramp."""
    wide = n + 2
    for i in range(n):
        for j in range(wide):
            work[i * wide + j] = 0.0
        for k in range(n):
            for j in range(wide):
                work[i * wide + j] += power[i * wide + k] * power[k * wide + j]
        work[i * wide + n] += power[i * wide + n]
        work[i * wide + n + 1] += power[i * wide + n] * power[n * wide + n + 1]
        work[i * wide + n + 1] += power[i * wide + n + 1]
    for i in range(n * wide):
        power[i] = work[i]
    power[n * wide + n + 1] *= 2.0
