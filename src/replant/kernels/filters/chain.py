"""From a sample to its regressor: dead time, filters, auxiliary model, instruments.

`banks` holds three banks (see `bank`): 0 the fixed filter 1/Lambda, 1 and 2 the auxiliary model's, of which one
serves while the other warms up.  With the refined filter the serving bank makes the regressor itself.
"""

from replant.kernels import schema as at
from replant.kernels.filters import bank as bk
from replant.kernels.filters.reflection import reflect
from replant.kernels.filters.routh import all_left_of, bandwidth, slowest_decay
from replant.kernels.native import LAID_OUT, Ints, Matrix, Reals, kernel

WARM_TIME_CONSTANTS = 10.0
"""Time that a bank with a new model warms up before it takes over [slowest time constants of the model].
Derivation: what is left of a wrong initial state is then exp(-10), 5e-5.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

MISSING = 1.5
"""Interval beyond which a sample is taken to be missing [sampling times].
Derivation: half-way between none and one.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

MOVED = 0.5
"""How far a held input is taken to have moved, on the mean, while samples were missing [part of the way].
Derivation: rows are lost whatever the input does: it may have moved at any time on the way.
"""

ROUNDING = 1e-12
"""Room for rounding where a dead time is a whole number of intervals [part of the time].
Derivation: some thousand times the precision of float64.
"""

RETRY = 10.0
"""Samples until the estimate is looked at again when it could not serve as a model [samples]."""


def begin_filters(ints, banks):
    """Put the filters at rest, but for the impulse of the initial state, which comes in now."""
    for b in range(3):
        bk.begin(banks[b], ints[at.ORDER], ints[at.ENTRIES])


def begin(ints, reals, banks, u, y):
    """Take the first sample of a record, or the first after a gap: everything at rest, u as it always was.

    As long as the input that acts lies before the record, the refined filter learns nothing: what acts is not known.
    """
    for i in range(ints[at.RING_SIZE]):
        reals[ints[at.AT_INPUTS] + i] = u
        reals[ints[at.AT_HELD] + i] = u
        reals[ints[at.AT_INTERVALS] + i] = reals[at.INTERVAL]
    if ints[at.HAS_REFERENCE] == 1:
        for i in range(ints[at.RING_SIZE]):
            reals[ints[at.AT_REFERENCE_INPUTS] + i] = reals[at.INPUT_BY_REFERENCE]
            reals[ints[at.AT_REFERENCE_HELD] + i] = reals[at.INPUT_BY_REFERENCE]
        reals[at.REFERENCE_INPUT_NOW] = reals[at.INPUT_BY_REFERENCE]
    begin_filters(ints, banks)
    reals[at.LAST_OUTPUT] = y
    reals[at.INPUT_NOW] = u
    ints[at.RING_HEAD] = 0
    ints[at.STARTED] = 1
    reals[at.UNKNOWN_INPUT] = 0.0
    if ints[at.REFINED] == 1 and reals[at.DELAY] > 0.0:
        reals[at.UNKNOWN_INPUT] = reals[at.DELAY]
        reals[at.LEARN_FROM] = max(reals[at.LEARN_FROM], reals[at.ELAPSED] + reals[at.DELAY])


def moved_share(interval, before, earlier, dt):
    """Return how far a held input moves from one sample to the next, on the mean over the interval, as a part of it.

    For the first sampling time ``dt`` it stood.  For the rest, where samples are missing, it is half the way between
    the last value and the newest.  No sample is missing where the two intervals ``before`` and ``earlier`` were as
    long: the device samples more slowly.
    """
    usual = max(dt, min(before, earlier))
    known = usual / interval if interval > MISSING * usual else 1.0
    return (1.0 - known) * MOVED


def remember_input(ints, reals, u, interval):
    """Put the newest input, and the part that a reference explains of it, into the rings for the dead time."""
    inputs, held = reals[ints[at.AT_INPUTS] :], reals[ints[at.AT_HELD] :]
    intervals, last = reals[ints[at.AT_INTERVALS] :], inputs[ints[at.RING_HEAD]]
    before = ints[at.RING_HEAD] - 1 if ints[at.RING_HEAD] > 0 else ints[at.RING_SIZE] - 1
    share = moved_share(interval, intervals[ints[at.RING_HEAD]], intervals[before], reals[at.INTERVAL])
    newest = ints[at.RING_HEAD] + 1
    if newest == ints[at.RING_SIZE]:
        newest = 0
    ints[at.RING_HEAD] = newest
    inputs[newest], intervals[newest] = u, interval
    held[newest] = last + share * (u - last)
    if ints[at.HAS_REFERENCE] == 1:
        parts, means = reals[ints[at.AT_REFERENCE_INPUTS] :], reals[ints[at.AT_REFERENCE_HELD] :]
        last, part = parts[newest - 1 if newest > 0 else ints[at.RING_SIZE] - 1], reals[at.INPUT_BY_REFERENCE]
        parts[newest] = part
        means[newest] = last + share * (part - last)


def advance_delayed_input(ints, reals, bank, interval, slot, work, channel):
    """Carry INPUT or REFERENCE_INPUT over the newest interval, piece by piece where the dead time breaks it.

    Looks back from now: the input u_j, sampled at the age a_j, acts from the age a_j - delay down to a_{j+1} - delay.
    """
    n, T, ring, straight = ints[at.ORDER], ints[at.ENTRIES], ints[at.RING_SIZE], ints[at.STRAIGHT_INPUT] == 1
    of_input = channel == bk.INPUT
    now = at.INPUT_NOW if of_input else at.REFERENCE_INPUT_NOW
    begin_inputs = ints[at.AT_INPUTS] if of_input else ints[at.AT_REFERENCE_INPUTS]
    begin_held = ints[at.AT_HELD] if of_input else ints[at.AT_REFERENCE_HELD]
    inputs, held = reals[begin_inputs : begin_inputs + ring], reals[begin_held : begin_held + ring]
    intervals = reals[ints[at.AT_INTERVALS] : ints[at.AT_INTERVALS] + ring]
    delay = reals[at.DELAY]
    newer = ints[at.RING_HEAD]
    older = newer - 1 if newer > 0 else ring - 1
    # go back to the piece of the input that acts when the newest interval begins
    age = 0.0  # of the sample `newer`
    pieces = 1
    while pieces < ring - 1 and age + intervals[newer] < (interval + delay) * (1.0 - ROUNDING):
        age += intervals[newer]
        newer = older
        older = newer - 1 if newer > 0 else ring - 1
        pieces += 1
    if ints[at.BILINEAR] == 1:  # one sample late by construction: the delayed input at the sample before
        share = 1.0 - (interval + delay - age) / intervals[newer]
        start = inputs[older] + share * (inputs[newer] - inputs[older])
        bk.advance_channel(bank, n, T, channel, slot, start, start, work)
        return
    left = interval  # what of the newest interval is still to come
    while True:
        until = max(age - delay, 0.0)  # this piece acts until so long before now
        piece = left - until
        if piece > bk.SAME_INTERVAL * interval:
            start = end = held[newer]
            if straight:
                slope = (inputs[newer] - inputs[older]) / intervals[newer]
                start = inputs[newer] - slope * (left + delay - age)
                end = inputs[newer] - slope * (until + delay - age)
            part_slot = bk.discretization(bank, n, T, piece, work)
            bk.advance_channel(bank, n, T, channel, part_slot, start, end, work)
            left = until
            reals[now] = end
        if left <= bk.SAME_INTERVAL * interval or newer == ints[at.RING_HEAD]:
            break
        older = newer
        newer = newer + 1 if newer + 1 < ring else 0
        age -= intervals[newer]
    if not straight and abs(age - delay) <= bk.SAME_INTERVAL * interval:
        # the next sample begins to act just now
        reals[now] = inputs[newer]


def advance_reference_input(ints, reals, bank, interval, slot, work):
    """Carry the REFERENCE_INPUT channel over the newest interval, as the input's is."""
    n, T, newest = ints[at.ORDER], ints[at.ENTRIES], ints[at.RING_HEAD]
    if reals[at.DELAY] > 0.0:
        advance_delayed_input(ints, reals, bank, interval, slot, work, bk.REFERENCE_INPUT)
        return
    parts, means = reals[ints[at.AT_REFERENCE_INPUTS] :], reals[ints[at.AT_REFERENCE_HELD] :]
    start = end = means[newest]
    if ints[at.STRAIGHT_INPUT] == 1:
        start, end = parts[newest - 1 if newest > 0 else ints[at.RING_SIZE] - 1], parts[newest]
    bk.advance_channel(bank, n, T, bk.REFERENCE_INPUT, slot, start, end, work)
    reals[at.REFERENCE_INPUT_NOW] = parts[newest]


def follow_input(ints, reals, banks, interval):
    """Find the delayed input at the newest sample, and what a reference explains of it, before the filters begin."""
    n, T, bank, work = ints[at.ORDER], ints[at.ENTRIES], banks[ints[at.SERVING_BANK]], reals[ints[at.AT_WORK] :]
    slot = bk.discretization(bank, n, T, interval, work)
    advance_delayed_input(ints, reals, bank, interval, slot, work, bk.INPUT)
    if ints[at.HAS_REFERENCE] == 1:
        advance_delayed_input(ints, reals, bank, interval, slot, work, bk.REFERENCE_INPUT)


def advance_bank(ints, reals, bank, interval, y, channels):
    """Carry the channels of a bank but MODEL, whose newest value is not known yet, over the newest interval.

    Returns the discretisation of that interval.
    """
    n, T, newest = ints[at.ORDER], ints[at.ENTRIES], ints[at.RING_HEAD]
    work = reals[ints[at.AT_WORK] :]
    slot = bk.discretization(bank, n, T, interval, work)
    last_y = reals[at.LAST_OUTPUT]
    if reals[at.DELAY] > 0.0:
        advance_delayed_input(ints, reals, bank, interval, slot, work, bk.INPUT)
        if channels > bk.INPUT + 1 and ints[at.HAS_REFERENCE] == 1:
            advance_reference_input(ints, reals, bank, interval, slot, work)
        # once more: the discretisations of the pieces may have taken the place of that of the whole interval
        slot = bk.discretization(bank, n, T, interval, work)
        bk.advance_channel(bank, n, T, bk.OUTPUT, slot, last_y, y, work)
    else:
        inputs, held = reals[ints[at.AT_INPUTS] :], reals[ints[at.AT_HELD] :]
        now = inputs[newest]
        start = end = held[newest]
        if ints[at.STRAIGHT_INPUT] == 1:
            start, end = inputs[newest - 1 if newest > 0 else ints[at.RING_SIZE] - 1], now
        bk.advance_two(bank, n, T, slot, bk.OUTPUT, last_y, y, bk.INPUT, start, end, work)
        reals[at.INPUT_NOW] = now
    if channels > bk.INPUT + 1:
        bk.advance_two(bank, n, T, slot, bk.IMPULSE, 0.0, 0.0, bk.CONSTANT, 1.0, 1.0, work)
        if ints[at.HAS_REFERENCE] == 1 and not reals[at.DELAY] > 0.0:
            advance_reference_input(ints, reals, bank, interval, slot, work)
    return slot


@kernel(
    LAID_OUT,
    "0 <= which < 3 and theta.size >= ints[at.ENTRIES]",
)
def install_model(ints: Ints, reals: Reals, banks: Matrix, which: int, theta: Reals):
    """Make the scaled estimate ``theta`` the auxiliary model of a bank.

    Its denominator is the bank's; if that is not stable, with the roots reflected.
    """
    n, T, inputs = ints[at.ORDER], ints[at.ENTRIES], ints[at.INPUT_ENTRIES]
    bank = banks[which]
    sigma = reals[ints[at.AT_SIGMA] : ints[at.AT_SIGMA] + T]
    work = reals[ints[at.AT_WORK] :]
    for i in range(n):
        work[i] = theta[i] * reals[ints[at.AT_UNIT] + i]
    margin = reals[at.STABILITY_MARGIN]
    stable = all_left_of(work[:n], margin, work[n:])
    if not stable:
        reflect(work[:n], margin, work[n:])
    bank[bk.REFLECTED] = 0.0 if stable else 1.0
    bk.set_denominator(
        bank, n, T, inputs, ints[at.HAS_CONSTANT] == 1, ints[at.REFINED] == 1, which == 0, work[:n], sigma
    )
    weights = bk.at_weights(n, T)
    for i in range(T):
        bank[weights + i] = theta[i] * reals[at.OUTPUT_SCALE]
    if ints[at.HAS_CONSTANT] == 1 and ints[at.REFINED] == 0:
        # what is one behind the fixed filter is lambda_0 in front of it
        bank[weights + n + inputs] *= banks[0, bk.DENOMINATOR + n - 1]


def renew_model(ints, reals, banks):
    """Make before break: a bank with the newest estimate warms up beside the serving one, then takes over.

    To change the filter under its states at once would feed its transients back into the estimate, which in
    ill-conditioned problems runs away even without noise.
    """
    if reals[at.ELAPSED] < reals[at.READY_AT]:
        return False
    n, T = ints[at.ORDER], ints[at.ENTRIES]
    taken_over = False
    if ints[at.WARMING] == 1:
        ints[at.SERVING_BANK] = 3 - ints[at.SERVING_BANK]
        ints[at.WARMING] = 0
        taken_over = True
    theta = reals[ints[at.AT_THETA] : ints[at.AT_THETA] + T]
    which = 3 - ints[at.SERVING_BANK]
    work = reals[ints[at.AT_WORK] :]
    a = work[3 * (n + 2) : 3 * (n + 2) + n]
    for i in range(n):
        a[i] = theta[i] * reals[ints[at.AT_UNIT] + i]
    if bandwidth(a) < reals[at.LARGEST_BANDWIDTH]:
        install_model(ints, reals, banks, which, theta)
        bk.take_states(banks[which], banks[ints[at.SERVING_BANK]], n, T)
        ints[at.WARMING] = 1
        denominator = banks[which, bk.DENOMINATOR : bk.DENOMINATOR + n]
        wait = WARM_TIME_CONSTANTS / max(slowest_decay(denominator, work), reals[at.STABILITY_MARGIN])
        reals[at.READY_AT] = reals[at.ELAPSED] + min(wait, reals[at.ELAPSED])
    else:
        reals[at.READY_AT] = reals[at.ELAPSED] + RETRY * reals[at.INTERVAL]
    return taken_over


def fill_regressor(ints, reals, bank, y, fixed):
    """Fill phi and zeta from a bank and return the scaled target s^n/D y.

    The linear form is (4) with lambda moved to the left: s^n/Lambda y = phi' [a, b], so that the estimate is in the
    plant's parameters whatever the filter is, and the error is that of (8).
    """
    n, T, inputs, constant = ints[at.ORDER], ints[at.ENTRIES], ints[at.INPUT_ENTRIES], ints[at.HAS_CONSTANT] == 1
    filters, phi, refined = bank, reals[ints[at.AT_PHI] :], ints[at.REFINED] == 1
    target = bk.fill_output_entries(filters, n, T, bk.OUTPUT, y, phi)
    bk.fill_known_entries(filters, n, T, inputs, bk.INPUT, reals[at.INPUT_NOW], constant, refined, fixed, phi)
    if ints[at.INSTRUMENTS] == 1:
        zeta = reals[ints[at.AT_ZETA] :]
        if ints[at.HAS_REFERENCE] == 1:
            now = reals[at.REFERENCE_INPUT_NOW]
            bk.fill_known_entries(filters, n, T, inputs, bk.REFERENCE_INPUT, now, constant, refined, fixed, zeta)
        else:
            for i in range(n, T):
                zeta[i] = phi[i]
        bk.fill_output_entries(filters, n, T, bk.MODEL, bank[bk.INSTRUMENT], zeta)
    return target / reals[at.OUTPUT_SCALE]


def model_output(ints, reals, bank, slot, before, fixed):
    """Return the predicted output of a bank's model, known before the newest output is.

    ``slot``: the discretisation of the newest interval; ``before`` (n,): the OUTPUT states at the sample before, which
    are overwritten.  The bank's other channels but MODEL are those of now.
    """
    n, T, filters = ints[at.ORDER], ints[at.ENTRIES], bank
    known = bk.fill_known_entries(
        filters, n, T, ints[at.INPUT_ENTRIES], bk.INPUT, reals[at.INPUT_NOW], ints[at.HAS_CONSTANT] == 1,
        ints[at.REFINED] == 1, fixed, reals[ints[at.AT_ZETA]:],
    )  # fmt: skip
    if bank[bk.REFLECTED] == 0.0 or slot == 0:
        return known
    work = reals[ints[at.AT_WORK] :]
    return bk.predicted_output(filters, n, T, bank[slot + 1 :], reals[at.LAST_OUTPUT], known, before, work)


def observe(ints, reals, banks, u, y, interval):
    """Take an accepted sample through dead time, filters and auxiliary model; return the scaled target.

    Fills phi, and zeta if there are instruments.  The newest sample's parts that a reference explains are in
    INPUT_BY_REFERENCE and OUTPUT_BY_REFERENCE.
    """
    if ints[at.SAMPLES] > 0:
        reals[at.ELAPSED] += interval
    n, T = ints[at.ORDER], ints[at.ENTRIES]
    first, refined, modelled = ints[at.STARTED] == 0, ints[at.REFINED] == 1, ints[at.INSTRUMENTS] == 1
    if first:
        begin(ints, reals, banks, u, y)
    else:
        remember_input(ints, reals, u, interval)
        if reals[at.UNKNOWN_INPUT] > 0.0:  # the state that this input leaves is free, so that the filters begin there
            first = True
            follow_input(ints, reals, banks, interval)
            begin_filters(ints, banks)
            left = reals[at.UNKNOWN_INPUT] - interval
            reals[at.UNKNOWN_INPUT] = left if left > bk.SAME_INTERVAL * interval else 0.0
    before = reals[ints[at.AT_OUTPUT_BEFORE] :]
    serving, slot = 0.0, 0
    for b in range(2 if modelled else 0, -1, -1):  # the models first: the fixed filter needs the serving one's output
        idle = b == 3 - ints[at.SERVING_BANK] and ints[at.WARMING] == 0
        if idle or (b == 0 and refined):
            continue
        bank = banks[b]
        if not first:
            if bank[bk.REFLECTED] == 1.0:
                states = bk.at_states(n, T) + bk.OUTPUT * n
                for i in range(n):
                    before[i] = bank[states + i]
            slot = advance_bank(ints, reals, bank, interval, y, bk.CHANNELS if b > 0 else bk.INPUT + 1)
        if not modelled:
            continue
        output = serving
        if b > 0:
            output = model_output(ints, reals, bank, slot, before, b == 0)
            if b == ints[at.SERVING_BANK]:
                serving = output
        if refined or b == 0:
            signal = reals[at.OUTPUT_BY_REFERENCE] if ints[at.HAS_REFERENCE] == 1 else output
            if not first:
                work = reals[ints[at.AT_WORK] :]
                bk.advance_channel(bank, n, T, bk.MODEL, slot, bank[bk.INSTRUMENT], signal, work)
            bank[bk.INSTRUMENT] = signal
            bank[bk.MODEL_OUTPUT] = output
    reals[at.LAST_OUTPUT] = y
    target = fill_regressor(ints, reals, banks[ints[at.SERVING_BANK] if refined else 0], y, not refined)
    if reals[at.UNKNOWN_INPUT] > 0.0:  # such a sample says nothing
        for i in range(T):
            reals[ints[at.AT_PHI] + i] = reals[ints[at.AT_ZETA] + i] = 0.0
        return 0.0
    return target
