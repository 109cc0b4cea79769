"""A bank of filters 1/D(s) in scaled companion states, exact over any interval.

One bank holds a denominator D(s), five channels of n states each, and its discretisations.  The states of a channel
driven by x are w_i = c^(n-i) s^i / D(s) x for i = n-1 .. 0 (see `replant.realization`).  The channels:

    OUTPUT    the measured output, joined by straight lines
    INPUT     the input, held or joined by straight lines, after the dead time
    MODEL     the auxiliary model's output, joined as the measured one is: what instruments are made of
    IMPULSE   an impulse at the beginning: what an unknown initial state adds
    CONSTANT  one: what an unknown offset adds

With D = A, the denominator of a model B/A, its output is a weighted sum of the INPUT, CONSTANT and IMPULSE states,
without any error of discretisation.

Discretisations are kept by the interval they belong to, a few at a time: a regular clock needs one, a fractional dead
time three, and a clock that jitters makes a new one each time.
"""

from numba import njit

from replant.kernels.matrix_exponential import exponential

OUTPUT, INPUT, MODEL, IMPULSE, CONSTANT = range(5)
CHANNELS = 5

# --- a bank's numbers
SCALE = 0  # c, rad/s
MODEL_OUTPUT = 1  # the auxiliary model's output at the newest sample
NEXT = 2  # the discretisation to be replaced next
DENOMINATOR = 3  # (n,)  d_{n-1} .. d_0; then come, one after the other:
# characteristic (n,)   d_i / c^(n-i)
# gain (T,)             from state to scaled regressor entry
# weights (T,)          the auxiliary model: scaled parameters of a noise-free output
# states (5 n,)
# discretisations       KEPT times: interval, Ad (n^2), constant (n), ramp (n)
KEPT = 4


@njit(cache=True, nogil=True, inline="always")
def at_characteristic(n, T):
    """Return where the scaled characteristic polynomial begins."""
    return DENOMINATOR + n


@njit(cache=True, nogil=True, inline="always")
def at_gain(n, T):
    """Return where the gains begin."""
    return DENOMINATOR + 2 * n


@njit(cache=True, nogil=True, inline="always")
def at_weights(n, T):
    """Return where the auxiliary model's parameters begin."""
    return DENOMINATOR + 2 * n + T


@njit(cache=True, nogil=True, inline="always")
def at_states(n, T):
    """Return where the states begin."""
    return DENOMINATOR + 2 * n + 2 * T


@njit(cache=True, nogil=True, inline="always")
def at_kept(n, T):
    """Return where the discretisations begin."""
    return DENOMINATOR + 2 * n + 2 * T + CHANNELS * n


@njit(cache=True, nogil=True, inline="always")
def kept_size(n):
    """Return how many numbers a discretisation has."""
    return 1 + n * n + 2 * n


def size(n, T):
    """Return how many numbers a bank has."""
    return DENOMINATOR + 2 * n + 2 * T + CHANNELS * n + KEPT * (1 + n * n + 2 * n)


@njit(cache=True, nogil=True, error_model="numpy")
def set_denominator(bank, n, T, inputs, constant, nuisances, fixed, denominator, sigma):
    """Give the bank a denominator d_{n-1} .. d_0: time scale, characteristic, gains; forget the discretisations.

    ``fixed``: the constant of the regressor is one, as (24) has it, and not 1/D.
    """
    c = abs(denominator[n - 1]) ** (1.0 / n)
    if not c > 0.0:
        for i in range(n):
            c = max(c, abs(denominator[i]) ** (1.0 / (i + 1)))
    if not c > 0.0:
        c = 1.0
    bank[SCALE] = c
    scale = 1.0
    gain = at_gain(n, T)
    characteristic = at_characteristic(n, T)
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
        last = 1.0 if fixed else c**n
        bank[gain + n + inputs] = 1.0 / (last * sigma[n + inputs])
    kept, size = at_kept(n, T), kept_size(n)
    for slot in range(KEPT):
        bank[kept + slot * size] = -1.0


@njit(cache=True, nogil=True, error_model="numpy")
def discretization(bank, n, T, interval, work):
    """Return where the exact solution over ``interval`` lies in the bank, computing it if it is not there.

    One exponential gives Ad, the response to a constant and that to a ramp from 0 to 1 (Van Loan, 1978).
    """
    kept, size = at_kept(n, T), kept_size(n)
    for slot in range(KEPT):
        if abs(bank[kept + slot * size] - interval) <= 1e-9 * interval:
            return kept + slot * size
    slot = int(bank[NEXT])
    bank[NEXT] = (slot + 1) % KEPT
    at = kept + slot * size
    wide = n + 2
    matrix, power, spare = work[: wide * wide], work[wide * wide : 2 * wide * wide], work[2 * wide * wide :]
    for i in range(wide * wide):
        matrix[i] = 0.0
    rate = bank[SCALE] * interval
    characteristic = at_characteristic(n, T)
    for i in range(n):
        matrix[i] = -rate * bank[characteristic + i]
    for i in range(1, n):
        matrix[i * wide + i - 1] = rate
    matrix[n] = rate
    matrix[n * wide + n + 1] = 1.0
    exponential(matrix, power, spare, wide)
    bank[at] = interval
    for i in range(n):
        for j in range(n):
            bank[at + 1 + i * n + j] = power[i * wide + j]
        bank[at + 1 + n * n + i] = power[i * wide + n]
        bank[at + 1 + n * n + n + i] = power[i * wide + n + 1]
    return at


@njit(cache=True, nogil=True, error_model="numpy")
def advance_channel(bank, n, T, channel, at, start, end, work):
    """Carry one channel over the interval of the discretisation ``at``; its signal runs straight, start to end."""
    x = at_states(n, T) + channel * n
    constant, ramp = at + 1 + n * n, at + 1 + n * n + n
    rise = end - start
    for i in range(n):
        total = bank[constant + i] * start + bank[ramp + i] * rise
        for j in range(n):
            total += bank[at + 1 + i * n + j] * bank[x + j]
        work[i] = total
    for i in range(n):
        bank[x + i] = work[i]


@njit(cache=True, nogil=True, error_model="numpy")
def take_states(bank, other, n, T):
    """Copy the states of another bank, in this bank's own time scale."""
    ratio = bank[SCALE] / other[SCALE]
    states = at_states(n, T)
    for channel in range(CHANNELS):
        factor = 1.0
        for i in range(n):
            factor *= ratio
            bank[states + channel * n + i] = other[states + channel * n + i] * factor
    bank[MODEL_OUTPUT] = other[MODEL_OUTPUT]


@njit(cache=True, nogil=True, error_model="numpy")
def begin(bank, n, T):
    """Put every channel at rest, but for the impulse that has just come in."""
    states = at_states(n, T)
    for i in range(CHANNELS * n):
        bank[states + i] = 0.0
    bank[states + IMPULSE * n] = bank[SCALE]
    bank[MODEL_OUTPUT] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def input_entries(bank, n, T, inputs, u, phi):
    """Fill the regressor's entries of the input, s^m/D u .. s^0/D u, u being its delayed value now."""
    gain, w = at_gain(n, T), at_states(n, T) + INPUT * n
    if inputs == n + 1:
        characteristic = at_characteristic(n, T)
        highest = u
        for i in range(n):
            highest -= bank[characteristic + i] * bank[w + i]
        phi[n] = bank[gain + n] * highest
        for i in range(n):
            phi[n + 1 + i] = bank[gain + n + 1 + i] * bank[w + i]
    else:
        for j in range(inputs):
            phi[n + j] = bank[gain + n + j] * bank[w + n - inputs + j]


@njit(cache=True, nogil=True, error_model="numpy")
def nuisance_entries(bank, n, T, inputs, constant, nuisances, fixed, phi):
    """Fill the regressor's entries of the constant and of the initial state."""
    gain, states = at_gain(n, T), at_states(n, T)
    if constant:
        value = 1.0 if fixed else bank[states + CONSTANT * n + n - 1]
        phi[n + inputs] = bank[gain + n + inputs] * value
    if nuisances:
        for i in range(n):
            phi[n + inputs + 1 + i] = bank[gain + n + inputs + 1 + i] * bank[states + IMPULSE * n + i]


@njit(cache=True, nogil=True, error_model="numpy")
def output_entries(bank, n, T, channel, entries):
    """Fill the entries -s^(n-1)/D y .. -s^0/D y of the measured output or, for instruments, of the model's."""
    gain, w = at_gain(n, T), at_states(n, T) + channel * n
    for i in range(n):
        entries[i] = bank[gain + i] * bank[w + i]


@njit(cache=True, nogil=True, error_model="numpy")
def highest_derivative(bank, n, T, y):
    """Return s^n/D y, from y and its filtered derivatives."""
    characteristic, w = at_characteristic(n, T), at_states(n, T) + OUTPUT * n
    total = y
    for i in range(n):
        total -= bank[characteristic + i] * bank[w + i]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def model_output(bank, n, T, phi):
    """Return the auxiliary model's output: its weights on the regressor's entries that the output does not enter."""
    weights = at_weights(n, T)
    total = 0.0
    for i in range(n, T):
        total += bank[weights + i] * phi[i]
    return total
