"""From a sample to its regressor: dead time, filters, auxiliary model, instruments.

`banks` holds three banks (see `bank`): 0 is the fixed filter 1/Lambda; 1 and 2 are the auxiliary model's, one in use
while the other warms up.  With the refined filter the bank in use also makes the regressor.
"""

from replant.kernels.filters import bank as bk
from replant.kernels.filters.polynomials import all_left_of, bandwidth, reflect, slowest_decay
from replant.kernels.native import LAID_OUT, Reals, inlined, kernel
from replant.kernels.schema import StateSlots

# exp(-10), 5e-5, of a wrong initial state then remains
WARM_TIME_CONSTANTS = 10.0  # time that a bank with a new model warms up [slowest time constants of the model]
# half-way between no and one missing sample
MISSING = 1.5  # interval beyond which a sample is assumed to be missing [sampling times]
# samples are lost independently of the input, which may have moved at any time
MOVED = 0.5  # mean move of a held input while samples were missing [part of the move]
# some thousand times the precision of float64
ROUNDING = 1e-12  # tolerance for rounding if a dead time is a whole number of intervals [part of the time]
RETRY = 10.0  # samples until an estimate that was unfit as auxiliary model is tried again [samples]


def begin_filters(s):
    """Set the filters to rest, except for the impulse of the initial state, which acts now."""
    for b in range(3):
        bk.begin(s.banks[b], s.order, s.entries)


def begin(s, u, y):
    """Take the first sample of a record, or the first after a gap: at rest, with u constant before it."""
    for i in range(s.ring_size):
        s.inputs[i] = u
        s.held[i] = u
        s.intervals[i] = s.interval
    if s.has_reference:
        for i in range(s.ring_size):
            s.reference_inputs[i] = s.input_by_reference
            s.reference_held[i] = s.input_by_reference
        s.reference_input_now = s.input_by_reference
    begin_filters(s)
    s.last_output = y
    s.input_now = u
    s.ring_head = 0
    s.started = True
    s.unknown_input = 0.0
    # nothing is learned while the delayed input lies before the record, as it is unknown
    if s.refined and s.delay > 0.0:
        s.unknown_input = s.delay
        s.learn_from = max(s.learn_from, s.elapsed + s.delay)


@inlined
def one_before(s, place):
    """Return the previous place in the rings."""
    return place - 1 if place > 0 else s.ring_size - 1


def moved_share(interval, before, earlier, dt):
    """Return the mean position of a held input over an interval: 0 is its last value, 1 the newest.

    In the first sampling time ``dt`` the input is the last value; during missing samples it is assumed half-way on
    average.  If the two previous intervals are as long, no sample is missing: the device samples more slowly.
    """
    usual = max(dt, min(before, earlier))
    known = usual / interval if interval > MISSING * usual else 1.0
    return (1.0 - known) * MOVED


def remember_input(s, u, interval):
    """Add the newest input, and the part of it that a reference explains, to the rings for the dead time."""
    before, last = s.ring_head, s.inputs[s.ring_head]
    share = moved_share(interval, s.intervals[before], s.intervals[one_before(s, before)], s.interval)
    newest = before + 1 if before + 1 < s.ring_size else 0
    s.ring_head = newest
    s.inputs[newest], s.intervals[newest] = u, interval
    s.held[newest] = last + share * (u - last)
    if s.has_reference:
        last, part = s.reference_inputs[before], s.input_by_reference
        s.reference_inputs[newest] = part
        s.reference_held[newest] = last + share * (part - last)


@inlined
def undelayed_ends(s, inputs, held):
    """Return where a signal without dead time begins and ends in the newest interval."""
    newest = s.ring_head
    if s.straight_input:
        return inputs[one_before(s, newest)], inputs[newest]
    return held[newest], held[newest]


def advance_input(s, bank, interval, slot, work, channel):
    """Advance INPUT or REFERENCE_INPUT by the newest interval; return the signal after the dead time now."""
    of_input = channel == bk.INPUT
    now = s.input_now if of_input else s.reference_input_now
    inputs = s.inputs if of_input else s.reference_inputs
    held = s.held if of_input else s.reference_held
    if s.delay > 0.0:
        return advance_delayed_input(s, bank, interval, slot, work, channel, now, inputs, held)
    start, end = undelayed_ends(s, inputs, held)
    bk.advance_channel(bank, s.order, s.entries, channel, slot, start, end, work)
    return inputs[s.ring_head]


def advance_delayed_input(s, bank, interval, slot, work, channel, now, inputs, held):
    """Advance a channel by the newest interval, piece by piece; return the delayed signal now.

    Ages count back from now: the input u_j, sampled at age a_j, acts from age a_j - delay down to a_{j+1} - delay.
    """
    n, T, ring, straight = s.order, s.entries, s.ring_size, s.straight_input
    intervals, delay = s.intervals, s.delay
    newer = s.ring_head
    older = one_before(s, newer)
    # go back to the piece of the input that acts at the begin of the newest interval
    age = 0.0  # age of the sample `newer`
    pieces = 1
    while pieces < ring - 1 and age + intervals[newer] < (interval + delay) * (1.0 - ROUNDING):
        age += intervals[newer]
        newer = older
        older = one_before(s, newer)
        pieces += 1
    if s.bilinear:  # one sample late by construction: the delayed input at the sample before
        share = 1.0 - (interval + delay - age) / intervals[newer]
        start = inputs[older] + share * (inputs[newer] - inputs[older])
        bk.advance_channel(bank, n, T, channel, slot, start, start, work)
        return now
    left = interval  # remaining part of the newest interval
    while True:
        until = max(age - delay, 0.0)  # age at which this piece ends
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
            now = end
        if left <= bk.SAME_INTERVAL * interval or newer == s.ring_head:
            break
        older = newer
        newer = newer + 1 if newer + 1 < ring else 0
        age -= intervals[newer]
    if not straight and abs(age - delay) <= bk.SAME_INTERVAL * interval:
        # the next input begins to act exactly now
        now = inputs[newer]
    return now


def advance_bank(s, bank, interval, y, channels):
    """Advance all channels but MODEL, whose newest value is unknown, by the newest interval; return its solution."""
    n, T, newest, work = s.order, s.entries, s.ring_head, s.work
    slot, last_y, all_channels = bk.discretization(bank, n, T, interval, work), s.last_output, channels > bk.INPUT + 1
    if s.delay > 0.0:
        s.input_now = advance_input(s, bank, interval, slot, work, bk.INPUT)
    if all_channels and s.has_reference:
        s.reference_input_now = advance_input(s, bank, interval, slot, work, bk.REFERENCE_INPUT)
    if s.delay > 0.0:
        # again: the discretisations of the pieces may have replaced that of the whole interval
        slot = bk.discretization(bank, n, T, interval, work)
        bk.advance_channel(bank, n, T, bk.OUTPUT, slot, last_y, y, work)
    else:
        start, end = undelayed_ends(s, s.inputs, s.held)
        bk.advance_two(bank, n, T, slot, bk.OUTPUT, last_y, y, start, end, work)
        s.input_now = s.inputs[newest]
    if all_channels:
        bk.advance_two(bank, n, T, slot, bk.IMPULSE, 0.0, 0.0, 1.0, 1.0, work)
    return slot


@kernel(
    LAID_OUT,
    "0 <= which < 3 and theta.size >= s.entries",
)
def install_model(s: StateSlots, which: int, theta: Reals):
    """Make the scaled estimate ``theta`` the auxiliary model of a bank; its unstable poles are reflected in D."""
    n, T, inputs = s.order, s.entries, s.input_entries
    bank = s.banks[which]
    work = s.work
    for i in range(n):
        work[i] = theta[i] * s.unit[i]
    margin = s.stability_margin
    stable = all_left_of(work[:n], margin, work[n:])
    if not stable:
        reflect(work[:n], margin, work[n:])
    bank[bk.REFLECTED] = 0.0 if stable else 1.0
    bk.set_denominator(bank, n, T, inputs, s.has_constant, s.refined, which == 0, work[:n], s.sigma)
    weights = bk.at_weights(n, T)
    for i in range(T):
        bank[weights + i] = theta[i] * s.output_scale
    if s.has_constant and not s.refined:
        # a constant of one after the fixed filter is lambda_0 before it
        bank[weights + n + inputs] *= s.banks[0, bk.DENOMINATOR + n - 1]


def renew_model(s):
    """Warm up a bank with the newest estimate beside the one in use, then switch; return whether it has switched.

    If the filter changed under its states, the transient would feed back into the estimate, which diverges in
    ill-conditioned problems even without noise.
    """
    if s.elapsed < s.ready_at:
        return False
    n, T = s.order, s.entries
    taken_over = False
    if s.warming:
        s.serving_bank = 3 - s.serving_bank
        s.warming = False
        taken_over = True
    which = 3 - s.serving_bank
    a = s.work[3 * (n + 2) : 3 * (n + 2) + n]
    for i in range(n):
        a[i] = s.theta[i] * s.unit[i]
    if bandwidth(a) < s.largest_bandwidth:
        install_model(s, which, s.theta)
        bk.take_states(s.banks[which], s.banks[s.serving_bank], n, T)
        s.warming = True
        denominator = s.banks[which, bk.DENOMINATOR : bk.DENOMINATOR + n]
        wait = WARM_TIME_CONSTANTS / max(slowest_decay(denominator, s.work), s.stability_margin)
        s.ready_at = s.elapsed + min(wait, s.elapsed)
    else:
        s.ready_at = s.elapsed + RETRY * s.interval
    return taken_over


def fill_regressor(s, bank, y):
    """Fill phi and zeta from a bank and return the scaled target s^n/D y.

    The linear form is (4) with lambda on the left: s^n/Lambda y = phi' [a, b].  So the estimate has the plant's
    parameters for any filter, and the error is that of (8).
    """
    n, T, constant, fixed = s.order, s.entries, s.has_constant, not s.refined
    target = bk.fill_output_entries(bank, n, T, bk.OUTPUT, y, s.phi)
    bk.fill_known_entries(s, bank, bk.INPUT, s.input_now, constant, fixed, s.phi)
    if s.instruments:
        if s.has_reference:
            bk.fill_known_entries(s, bank, bk.REFERENCE_INPUT, s.reference_input_now, constant, fixed, s.zeta)
        else:
            for i in range(n, T):
                s.zeta[i] = s.phi[i]
        bk.fill_output_entries(bank, n, T, bk.MODEL, bank[bk.INSTRUMENT], s.zeta)
    return target / s.output_scale


def model_output(s, bank, slot, before):
    """Return the output predicted by a bank's model, before the newest output is used.

    ``slot``: the discretisation of the newest interval; ``before`` (n,): the OUTPUT states before it, overwritten.
    """
    known = bk.fill_known_entries(s, bank, bk.INPUT, s.input_now, s.has_constant, False, s.zeta)
    if bank[bk.REFLECTED] == 0.0 or slot == 0:
        return known
    return bk.predicted_output(bank, s.order, s.entries, bank[slot + 1 :], s.last_output, known, before, s.work)


def filters_begin(s, u, y, interval):
    """Add an input to the rings; return whether the filters begin with this sample."""
    if not s.started:
        begin(s, u, y)
        return True
    remember_input(s, u, interval)
    if not s.unknown_input > 0.0:
        return False
    # the input is delayed as ever
    bank, work = s.banks[s.serving_bank], s.work
    slot = bk.discretization(bank, s.order, s.entries, interval, work)
    s.input_now = advance_input(s, bank, interval, slot, work, bk.INPUT)
    if s.has_reference:
        s.reference_input_now = advance_input(s, bank, interval, slot, work, bk.REFERENCE_INPUT)
    begin_filters(s)  # the state after an unknown input is free
    left = s.unknown_input - interval
    s.unknown_input = left if left > bk.SAME_INTERVAL * interval else 0.0
    return True


def observe(s, u, y, interval):
    """Pass an accepted sample through dead time, filters and model; fill phi and zeta; return the scaled target."""
    if s.samples > 0:
        s.elapsed += interval
    n, T, refined, modelled = s.order, s.entries, s.refined, s.instruments
    first = filters_begin(s, u, y, interval)
    before = s.output_before
    serving, slot = 0.0, 0
    for b in range(2 if modelled else 0, -1, -1):  # the models first: the fixed filter needs the serving one's output
        idle = b == 3 - s.serving_bank and not s.warming
        if idle or (b == 0 and refined):
            continue
        bank = s.banks[b]
        if not first:
            if bank[bk.REFLECTED] == 1.0:
                states = bk.at_states(n, T) + bk.OUTPUT * n
                for i in range(n):
                    before[i] = bank[states + i]
            slot = advance_bank(s, bank, interval, y, bk.CHANNELS if b > 0 else bk.INPUT + 1)
        if not modelled:
            continue
        output = serving
        if b > 0:
            output = model_output(s, bank, slot, before)
            if b == s.serving_bank:
                serving = output
        if refined or b == 0:
            signal = s.output_by_reference if s.has_reference else output
            if not first:
                bk.advance_channel(bank, n, T, bk.MODEL, slot, bank[bk.INSTRUMENT], signal, s.work)
            bank[bk.INSTRUMENT] = signal
            bank[bk.MODEL_OUTPUT] = output
    s.last_output = y
    target = fill_regressor(s, s.banks[s.serving_bank if refined else 0], y)
    if s.unknown_input > 0.0:  # the delayed input is unknown: the sample carries no information
        for i in range(T):
            s.phi[i] = s.zeta[i] = 0.0
        return 0.0
    return target
