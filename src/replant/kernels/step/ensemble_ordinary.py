"""An ordinary sample of `LANES` identifiers at once, with a refined filter and an optimizer that keeps a covariance.

A sample is ordinary if `single.take_covariance` does nothing but arithmetic with it: it is accepted, neither at rest
nor in doubt, and no action is due.  The stages below are those of `take_covariance` for vectors, with sums in the same
order, so that a member gets the same bits.  A test that a member fails marks its lane in ODD; the lane is invalid from
then on.

Arguments: ``s`` the fields of all members; ``models`` (2, size), the banks of the serving auxiliary model and of the
warming one, each with the one discretisation of a regular clock; ``beside`` the vectors listed below; ``places`` the
rows of the newest sample in the rings of the noise model and of the residual's colour.
"""

from replant.kernels import schema as at
from replant.kernels.filters import autoregressions, chain
from replant.kernels.filters import bank as bk
from replant.kernels.lanes import if_at_most, if_less
from replant.kernels.monitoring import interruptions, outliers, scatter
from replant.kernels.native import inlined
from replant.kernels.optimizers import covariance as second
from replant.kernels.optimizers.memory import block
from replant.kernels.schema import LAGS

# Vectors beside the fields: a flag, integers of each member, and numbers derived from its fields.
ODD, TIES, STILL, BEGAN, COUNT, REST_AFTER, ANEW, WEIGHT = range(8)
MODEL = 8  # place of the LAGS coefficients of the noise model in use [index]
BESIDE = MODEL + LAGS  # vectors beside the fields [count]
# three are enough if ties are as rare as `outliers.LEAST_TIE_SHARE`: 3 ln 1e-3 lies below `outliers.CHANCE`
FEW_TIES = 2.0  # ties in a row that prove no sensor stuck, however fine its scale [samples]


@inlined
def unless_at_most(beside, number, limit):
    """Mark the lanes with a number that is not at most its limit."""
    beside[ODD] = if_at_most(number, limit, beside[ODD], 1.0)


@inlined
def follow_input(s, beside, u):
    """Mark inputs that are far away or at rest, and update their moving variance: `is_far` and `input_rests`."""
    away = u - s.input_mean
    leap = interruptions.INPUT_LEAP * interruptions.INPUT_LEAP
    unless_at_most(beside, away * away, leap * s.largest_power)
    if not s.rests_with_input:
        return
    share = s.forget_input
    s.input_mean += share * away
    s.input_power += share * (away * away - s.input_power)
    s.largest_power = max(s.largest_power, s.input_power)
    least = interruptions.AT_REST * s.largest_power
    if s.rest_after > 0:
        step = u - s.input_anchor
        square = step * step
        s.input_anchor = if_less(least, square, u, s.input_anchor)
        still = if_less(least, square, 0.0, beside[STILL] + 1.0)
        beside[STILL] = still
        unless_at_most(beside, still, beside[REST_AFTER])
    unless_at_most(beside, least, s.input_power)


@inlined
def advance(s, bank, y, start, end):
    """Advance a bank by one interval, and predict its output: `chain.observe`."""
    n, T, work = s.order, s.entries, s.work
    slot = bk.at_kept(n, T)
    bk.advance_two(bank, n, T, slot, bk.OUTPUT, s.last_output, y, start, end, work)
    bk.advance_two(bank, n, T, slot, bk.IMPULSE, 0.0, 0.0, 1.0, 1.0, work)
    output = bk.fill_known_entries(s, bank, bk.INPUT, s.input_now, s.has_constant, False, s.zeta)
    bk.advance_channel(bank, n, T, bk.MODEL, slot, bank[bk.INSTRUMENT], output, work)
    bank[bk.INSTRUMENT] = output
    bank[bk.MODEL_OUTPUT] = output


@inlined
def examine(s, beside, modelled, error, y):
    """Mark outputs that are in doubt or not calm, and update ties and size: `outliers.observe` and `is_calm`."""
    step, ties, share = abs(y - s.last_raw), beside[TIES], s.tie_share
    s.last_raw = y
    tie = if_at_most(step, 0.0, 1.0, 0.0)
    s.tie_share = if_at_most(ties, 0.0, share + outliers.TIE_SHARE * (tie - share), share)
    beside[TIES] = if_at_most(step, 0.0, ties + 1.0, 0.0)
    s.tie_model = if_at_most(step, 0.0, s.tie_model, modelled)
    newest = if_less(step, s.sensor_step, step, if_less(0.0, s.sensor_step, s.sensor_step, step))
    s.sensor_step = if_at_most(step, 0.0, s.sensor_step, newest)
    most = if_less(s.tie_share, outliers.COARSE, FEW_TIES, float(outliers.MANY - 1))
    unless_at_most(beside, beside[TIES], if_less(s.tie_share, outliers.RESOLVED, 0.0, most))
    unless_at_most(beside, error * error, outliers.GATE * max(s.late_variance, s.usual_variance))
    s.error = error
    s.used_output = y
    size = modelled / s.output_scale
    s.largest_output = max(size * size, s.largest_output - s.forget_input * s.largest_output)


@inlined
def whiten(s, beside, place, target, filters):
    """Keep the newest row, and filter it where a noise model ``filters``; return its target."""
    noise, phi, zeta, T = s.noise, s.phi, s.zeta, s.entries
    row, earlier = noise.rows[place], autoregressions.earlier_rows(noise, place)
    for i in range(T):
        row[i] = phi[i]
        row[T + i] = zeta[i]
    row[2 * T] = target
    if not filters:
        return target
    # the weight is 0 for members whose noise model does not filter
    weight, d = beside[WEIGHT], (beside[MODEL], beside[MODEL + 1], beside[MODEL + 2], beside[MODEL + 3])
    for i in range(T):
        phi[i] = if_less(0.0, weight, weight * autoregressions.white(row, earlier, d, i), phi[i])
    for i in range(T):
        zeta[i] = if_less(0.0, weight, weight * autoregressions.white(row, earlier, d, T + i), zeta[i])
    return if_less(0.0, weight, weight * autoregressions.white(row, earlier, d, 2 * T), target)


@inlined
def learn(s, beside, error, forgets):
    """Learn the newest row with its a-priori ``error``: `covariance.recursive_least_squares`.  Returns alpha."""
    T, memory, theta, forgetting = s.entries, s.memory, s.theta, s.settings[0]
    U, D, caps = memory[: T * T].reshape(T, T), block(memory, second.AT_D, T), block(memory, second.AT_CAPS, T)
    projected, gain = block(memory, second.AT_PROJECTED, T), block(memory, second.AT_GAIN, T)
    newest = block(memory, second.AT_ALPHA, T)
    alpha = second.measurement_update(T, U, D, s.zeta, forgetting, projected, gain)
    finite = 0.0 * alpha
    for i in range(T):
        theta[i] += gain[i] * error / alpha
        finite += 0.0 * (theta[i] * s.unit[i])
        if forgets:
            D[i] = min(D[i] / forgetting, caps[i])
    newest[0] = alpha
    unless_at_most(beside, finite, 0.0)
    return alpha


@inlined
def watch(s, beside, alpha, white):
    """Update the residual's variance, and mark lanes that raise an alarm: `outliers.watch`."""
    s.variance_ratio = max(alpha / s.settings[0], 1.0)
    square = s.error * s.error / s.variance_ratio
    s.residuals_seen += 1.0
    least = outliers.LEAST * s.largest_output
    s.late_variance, square, usual = outliers.follow(s.late_variance, s.usual_variance, square, least)
    power = if_less(0.0, usual, square / usual, 0.0)
    if s.has_noise_model:
        newest = white * white / s.variance_ratio
        s.late_innovation, newest, usual = outliers.follow(s.late_innovation, s.usual_innovation, newest, least)
        power = if_less(0.0, usual, newest / usual, 0.0)
    grown = s.cusum + power - outliers.GROWN
    tests = s.cusum_limit
    s.cusum = if_less(0.0, tests, max(grown, 0.0), s.cusum)
    beside[BEGAN] = if_less(0.0, tests, if_less(0.0, grown, beside[BEGAN], beside[COUNT]), beside[BEGAN])
    beside[ODD] = if_less(0.0, tests, if_less(tests, grown, 1.0, beside[ODD]), beside[ODD])
    share = max(1.0 / s.residuals_seen, outliers.LONG)
    s.usual_variance += share * (square - s.usual_variance)
    if s.has_noise_model:
        s.usual_innovation += share * (power - 1.0) * usual


@inlined
def take(s, models, beside, places, companion, how, u, y):
    """Take one sample, as `step.single.take_covariance` does; return the error in the unit of y.

    ``companion`` (T + 1,) becomes zeta and the target as learned; ``how``: whether a noise model filters, and whether
    the optimizer forgets.
    """
    filters, forgets = how
    unless_at_most(beside, abs(u), at.LARGEST)
    unless_at_most(beside, abs(y), at.LARGEST)
    beside[ODD] = if_less(s.elapsed, s.ready_at, beside[ODD], 1.0)
    follow_input(s, beside, u)
    s.elapsed += s.interval
    last = s.input_now
    held = last + 0.0 * (u - last)  # no sample is missing
    s.input_now = u
    start, end = last if s.straight_input else held, u if s.straight_input else held
    for b in range(2):
        advance(s, models[b], y, start, end)
    serving = models[0]
    s.last_output = y
    target = chain.fill_regressor(s, serving, y)
    error = outliers.equation_error(s, target)
    examine(s, beside, serving[bk.MODEL_OUTPUT], error, y)
    beside[COUNT] += 1.0
    white, newest_alpha = error, second.alpha_of(s)
    if s.has_noise_model:
        target = whiten(s, beside, places[0], target, filters)
        white = outliers.equation_error(s, target)
        unless_at_most(beside, newest_alpha, beside[ANEW])
        autoregressions.add_residuals(s.noise, places[0], s.theta, s.work, s.settings[0])
    for i in range(s.entries):
        companion[i] = s.zeta[i]
    companion[s.entries] = target
    alpha = learn(s, beside, white, forgets)
    if s.coloured:
        unless_at_most(beside, alpha, beside[ANEW])
        scatter.add(s.colour, places[1], white, alpha, s.settings[0], s.zeta)
    watch(s, beside, alpha, white)
    return s.error * s.output_scale
