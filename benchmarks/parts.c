/* The parts of the default method as plain C on the same arrays: filters with instruments, least squares, Kalman.
 * layout.h, made from replant.kernels.schema and .bank, says where each number lies. */
#include <float.h>
#include <math.h>
#include <stdint.h>
#include "layout.h"

static int64_t at_gain(int64_t n) { return DENOMINATOR + 2 * n; }
static int64_t at_weights(int64_t n, int64_t T) { return DENOMINATOR + 2 * n + T; }
static int64_t at_states(int64_t n, int64_t T) { return DENOMINATOR + 2 * n + 2 * T; }

/* --- filters: a held input, no dead time, a regular clock whose discretisation is there */

static void advance_channel(
    double *restrict bank, int64_t n, int64_t T, int64_t channel, int64_t at, double start, double end, double *restrict new)
{
    double *restrict x = bank + at_states(n, T) + channel * n;
    const double *restrict A = bank + at + 1, *restrict constant = A + n * n, *restrict ramp = constant + n;
    double rise = end - start;
    for (int64_t i = 0; i < n; i++) {
        double total = constant[i] * start + ramp[i] * rise;
        for (int64_t j = 0; j < n; j++)
            total += A[i * n + j] * x[j];
        new[i] = total;
    }
    for (int64_t i = 0; i < n; i++)
        x[i] = new[i];
}

/* two channels at once, as ours: each loads A but once for both */
static void advance_two(
    double *restrict bank, int64_t n, int64_t T, int64_t at, int64_t one, double start, double end, int64_t other,
    double other_start, double other_end, double *restrict new)
{
    double *restrict x = bank + at_states(n, T) + one * n, *restrict z = bank + at_states(n, T) + other * n;
    const double *restrict A = bank + at + 1, *restrict constant = A + n * n, *restrict ramp = constant + n;
    double rise = end - start, other_rise = other_end - other_start, *restrict spare = new + n;
    for (int64_t i = 0; i < n; i++) {
        double total = constant[i] * start + ramp[i] * rise;
        double sum = constant[i] * other_start + ramp[i] * other_rise;
        for (int64_t j = 0; j < n; j++) {
            total += A[i * n + j] * x[j];
            sum += A[i * n + j] * z[j];
        }
        new[i] = total;
        spare[i] = sum;
    }
    for (int64_t i = 0; i < n; i++) {
        x[i] = new[i];
        z[i] = spare[i];
    }
}

static int64_t discretization(const double *bank, int64_t n, int64_t T, double interval)
{
    int64_t kept = at_states(n, T) + CHANNELS * n, size = 1 + n * n + 2 * n;
    for (int64_t slot = 0; slot < KEPT; slot++)
        if (fabs(bank[kept + slot * size] - interval) <= 1e-9 * interval)
            return kept + slot * size;
    return -1;
}

static double fill_known(
    const double *restrict bank, int64_t n, int64_t T, int64_t inputs, int constant, int nuisances, int fixed,
    double *restrict phi)
{
    const double *gain = bank + at_gain(n), *states = bank + at_states(n, T), *weights = bank + at_weights(n, T);
    const double *wu = states + INPUT * n + n - inputs, *impulse = states + IMPULSE * n;
    int64_t first = n, last = n + inputs;
    for (int64_t i = 0; i < inputs; i++)
        phi[first + i] = gain[first + i] * wu[i];
    if (constant)
        phi[last] = gain[last] * (fixed ? 1.0 : states[CONSTANT_CHANNEL * n + n - 1]);
    if (nuisances)
        for (int64_t i = 0; i < n; i++)
            phi[last + 1 + i] = gain[last + 1 + i] * impulse[i];
    double output = 0.0;
    for (int64_t i = n; i < T; i++)
        output += weights[i] * phi[i];
    return output;
}

static double fill_output(const double *restrict bank, int64_t n, int64_t T, int64_t channel, double y, double *restrict phi)
{
    const double *gain = bank + at_gain(n), *w = bank + at_states(n, T) + channel * n;
    const double *characteristic = bank + DENOMINATOR + n;
    for (int64_t i = 0; i < n; i++) {
        phi[i] = gain[i] * w[i];
        y -= characteristic[i] * w[i];
    }
    return y;
}

static double observe(int64_t *ints, double *reals, double *banks, int64_t bank_size, double u, double y)
{
    int64_t n = ints[ORDER], T = ints[ENTRIES], inputs = ints[INPUT_ENTRIES], ring = ints[RING_SIZE];
    int refined = ints[REFINED] == 1, modelled = ints[INSTRUMENTS] == 1, constant = ints[HAS_CONSTANT] == 1;
    double interval = reals[INTERVAL], *work = reals + ints[AT_WORK];
    double *phi = reals + ints[AT_PHI], *zeta = reals + ints[AT_ZETA];
    reals[ELAPSED] += interval;
    double last = reals[ints[AT_INPUTS] + ints[RING_HEAD]];
    int64_t newest = ints[RING_HEAD] + 1 == ring ? 0 : ints[RING_HEAD] + 1;
    ints[RING_HEAD] = newest;
    reals[ints[AT_INPUTS] + newest] = u;
    reals[ints[AT_HELD] + newest] = last;
    reals[ints[AT_INTERVALS] + newest] = interval;
    double serving = 0.0;
    for (int64_t b = modelled ? 2 : 0; b >= 0; b--) {
        if ((b == 3 - ints[SERVING_BANK] && ints[WARMING] == 0) || (b == 0 && refined))
            continue;
        double *bank = banks + b * bank_size;
        int64_t slot = discretization(bank, n, T, interval);
        advance_two(bank, n, T, slot, OUTPUT, reals[LAST_OUTPUT], y, INPUT, last, last, work);
        reals[INPUT_NOW] = u;
        if (b > 0)
            advance_two(bank, n, T, slot, IMPULSE, 0.0, 0.0, CONSTANT_CHANNEL, 1.0, 1.0, work);
        if (!modelled)
            continue;
        double output = serving;
        if (b > 0) {
            output = fill_known(bank, n, T, inputs, constant, refined, b == 0, zeta);
            if (b == ints[SERVING_BANK])
                serving = output;
        }
        if (refined || b == 0) {
            advance_channel(bank, n, T, MODEL, slot, bank[INSTRUMENT], output, work);
            bank[INSTRUMENT] = bank[MODEL_OUTPUT] = output;
        }
    }
    reals[LAST_OUTPUT] = y;
    const double *bank = banks + (refined ? ints[SERVING_BANK] : 0) * bank_size;
    double target = fill_output(bank, n, T, OUTPUT, y, phi);
    fill_known(bank, n, T, inputs, constant, refined, !refined, phi);
    if (modelled) {
        for (int64_t i = n; i < T; i++)
            zeta[i] = phi[i];
        fill_output(bank, n, T, MODEL, bank[INSTRUMENT], zeta);
    }
    return target / reals[OUTPUT_SCALE];
}

void run_filters(
    int64_t *ints, double *reals, double *banks, int64_t bank_size, int64_t K, const double *u, const double *y,
    double *targets)
{
    for (int64_t k = 0; k < K; k++)
        targets[k] = observe(ints, reals, banks, bank_size, u[k], y[k]);
}

/* --- optimizers that keep a covariance: a row is phi (P), y, 1, zeta (P) */

static double measurement_update(
    int64_t P, double *restrict U, double *restrict D, const double *restrict zeta, double noise,
    double *restrict projected, double *restrict gain)
{
    for (int64_t i = 0; i < P; i++) {
        double total = zeta[i];
        for (int64_t j = 0; j < i; j++)
            total += U[j * P + i] * zeta[j];
        projected[i] = total;
    }
    double alpha = noise;
    for (int64_t j = 0; j < P; j++) {
        double v = D[j] * projected[j], before = alpha;
        gain[j] = v;
        alpha = before + projected[j] * v;
        D[j] *= before / alpha;
        double factor = -projected[j] / before;
        for (int64_t i = 0; i < j; i++) {
            double u = U[i * P + j];
            U[i * P + j] = u + gain[i] * factor;
            gain[i] += u * v;
        }
    }
    return alpha;
}

static double innovation(int64_t P, const double *restrict theta, const double *restrict row)
{
    double error = row[P];
    for (int64_t i = 0; i < P; i++)
        error -= theta[i] * row[i];
    return error;
}

void run_least_squares(
    int64_t P, double *theta, double *memory, const double *settings, const double *buffer, int64_t K, int64_t direction)
{
    double *U = memory, *D = U + P * P, *caps = D + P, *projected = caps + P, *gain = projected + P;
    double forgetting = settings[0];
    int64_t width = direction ? 2 * P + 2 : P + 2;
    for (int64_t k = 0; k < K; k++) {
        const double *row = buffer + k * width;
        double error = innovation(P, theta, row);
        double alpha = measurement_update(P, U, D, row + direction, forgetting, projected, gain);
        for (int64_t i = 0; i < P; i++) {
            theta[i] += gain[i] * error / alpha;
            if (forgetting < 1.0)
                D[i] = fmin(D[i] / forgetting, caps[i]);
        }
        gain[P] = alpha;
    }
}

static void time_update(int64_t P, double *restrict U, double *restrict D, const double *restrict increase, double *restrict work)
{
    double *restrict rows = work, *restrict weights = work + 2 * P * P;
    for (int64_t i = 0; i < P; i++) {
        for (int64_t j = 0; j < P; j++) {
            rows[i * 2 * P + j] = U[i * P + j];
            rows[i * 2 * P + P + j] = i == j;
        }
        weights[i] = D[i];
        weights[P + i] = increase[i];
    }
    for (int64_t i = P - 1; i >= 0; i--) {
        double length = 0.0;
        for (int64_t k = 0; k < 2 * P; k++)
            length += rows[i * 2 * P + k] * rows[i * 2 * P + k] * weights[k];
        D[i] = length;
        for (int64_t j = 0; j < i; j++) {
            double cross = 0.0;
            for (int64_t k = 0; k < 2 * P; k++)
                cross += rows[j * 2 * P + k] * rows[i * 2 * P + k] * weights[k];
            cross = length > 0.0 ? cross / length : 0.0;
            U[j * P + i] = cross;
            for (int64_t k = 0; k < 2 * P; k++)
                rows[j * 2 * P + k] -= cross * rows[i * 2 * P + k];
        }
    }
}

void run_kalman(
    int64_t P, double *theta, double *memory, const double *settings, const double *buffer, int64_t K, int64_t direction,
    double interval)
{
    double *U = memory, *D = U + P * P, *noise = D + P, *increase = noise + 1, *projected = increase + P;
    double *gain = projected + P, *work = gain + P, *last_alpha = work + 2 * P * P + 2 * P;
    int64_t width = direction ? 2 * P + 2 : P + 2;
    for (int64_t k = 0; k < K; k++) {
        const double *row = buffer + k * width;
        for (int64_t i = 0; i < P; i++)
            increase[i] = settings[1 + i] * interval;
        time_update(P, U, D, increase, work);
        double error = innovation(P, theta, row);
        double alpha = measurement_update(P, U, D, row + direction, *noise, projected, gain);
        for (int64_t i = 0; i < P; i++)
            theta[i] += gain[i] * error / alpha;
        *last_alpha = alpha;
        double share = fmin(settings[0] * interval, 1.0);
        *noise = fmax(*noise + (error * error * *noise / alpha - *noise) * share, DBL_MIN);
    }
}

/* --- the noise model: a row is phi (T), zeta (T), target; numbers as kernels.filters.autoregressions has them */

static double filter_row(int64_t T, double *restrict noise, double *restrict phi, double *restrict zeta, double target)
{
    int64_t size = LAGS + 1, newest = ((int64_t)noise[NOISE_POSITION] + 1) % size, width = 2 * T + 1;
    int64_t order = (int64_t)noise[NOISE_ORDER], known = (int64_t)noise[NOISE_KNOWN];
    int64_t lags = order < known ? order : known;
    const double *d = noise + NOISE_MODELS + size * lags;
    double weight = sqrt(noise[NOISE_GAIN] * noise[NOISE_VARIANCES] / noise[NOISE_VARIANCES + lags]);
    double d_1 = d[1], d_2 = d[2], d_3 = d[3], d_4 = d[4];
    noise[NOISE_POSITION] = newest;
    noise[NOISE_KNOWN] = fmin(known + 1.0, size);
    double *restrict row = noise + NOISE_ROWS + newest * width;
    const double *row_1 = noise + NOISE_ROWS + (newest + 4) % size * width;
    const double *row_2 = noise + NOISE_ROWS + (newest + 3) % size * width;
    const double *row_3 = noise + NOISE_ROWS + (newest + 2) % size * width;
    const double *row_4 = noise + NOISE_ROWS + (newest + 1) % size * width;
    for (int64_t i = 0; i < T; i++)
        row[i] = phi[i];
    for (int64_t i = 0; i < T; i++)
        row[T + i] = zeta[i];
    row[2 * T] = target;
    for (int64_t i = 0; i < T; i++)
        phi[i] = weight * (row[i] + d_1 * row_1[i] + d_2 * row_2[i] + d_3 * row_3[i] + d_4 * row_4[i]);
    for (int64_t i = T; i < 2 * T; i++)
        zeta[i - T] = weight * (row[i] + d_1 * row_1[i] + d_2 * row_2[i] + d_3 * row_3[i] + d_4 * row_4[i]);
    int64_t i = 2 * T;
    return weight * (target + d_1 * row_1[i] + d_2 * row_2[i] + d_3 * row_3[i] + d_4 * row_4[i]);
}

static void add_residuals(int64_t T, double *noise, const double *restrict theta, double *restrict errors)
{
    int64_t size = LAGS + 1, newest = (int64_t)noise[NOISE_POSITION];
    if (noise[NOISE_KNOWN] < size)
        return;
    for (int64_t lag = 0; lag < size; lag++) {
        const double *row = noise + NOISE_ROWS + (newest + size - lag) % size * (2 * T + 1);
        double error = row[2 * T];
        for (int64_t i = 0; i < T; i++)
            error -= theta[i] * row[i];
        errors[lag] = error;
    }
    noise[NOISE_COUNT] += 1.0;
    for (int64_t i = 0; i < size; i++)
        for (int64_t j = 0; j <= i; j++)
            noise[NOISE_SUMS + size * i + j] += errors[i] * errors[j];
}

void run_noise_model(
    int64_t T, double *noise, int64_t K, const double *rows, double *phi, double *zeta, const double *theta,
    double *errors, double *targets)
{
    for (int64_t k = 0; k < K; k++) {
        const double *row = rows + k * (2 * T + 1);
        for (int64_t i = 0; i < T; i++) {
            phi[i] = row[i];
            zeta[i] = row[T + i];
        }
        targets[k] = filter_row(T, noise, phi, zeta, row[2 * T]);
        add_residuals(T, noise, theta, errors);
    }
}

/* --- the projection on a reference */

static double explained(const double *restrict reference, int64_t weights)
{
    double total = 0.0;
    for (int64_t i = 0; i < REFERENCE_SIZE; i++)
        total += reference[weights + i] * reference[REFERENCE_STATES + i];
    return total;
}

void run_reference(
    double *reference, int64_t K, const double *r, const double *u, const double *y, double *work, double *outputs)
{
    double a = reference[REFERENCE_POLE], *states = reference + REFERENCE_STATES, *gain = work + REFERENCE_SIZE;
    double *of_input = reference + REFERENCE_WEIGHTS, *of_output = of_input + REFERENCE_SIZE;
    for (int64_t k = 0; k < K; k++) {
        double before = states[0];
        states[0] = a * before + sqrt(1.0 - a * a) * (r[k] - reference[REFERENCE_ORIGIN]);
        for (int64_t i = 1; i < LAGUERRE; i++) {
            double old = states[i];
            states[i] = before + a * (old - states[i - 1]);
            before = old;
        }
        outputs[k] = explained(reference, REFERENCE_WEIGHTS);
        outputs[k] += explained(reference, REFERENCE_WEIGHTS + REFERENCE_SIZE);
        double alpha = measurement_update(
            REFERENCE_SIZE, reference + REFERENCE_FACTORS, reference + REFERENCE_DIAGONAL, states, 1.0, work, gain);
        double for_input = (u[k] - explained(reference, REFERENCE_WEIGHTS)) / alpha;
        double for_output = (y[k] - explained(reference, REFERENCE_WEIGHTS + REFERENCE_SIZE)) / alpha;
        for (int64_t i = 0; i < REFERENCE_SIZE; i++) {
            of_input[i] += gain[i] * for_input;
            of_output[i] += gain[i] * for_output;
        }
    }
}
