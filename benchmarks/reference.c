/*
 * The loop of replant's kernels, written by hand in C: the yardstick of kernels.py.
 *
 * Same arithmetic in the same order, so the same numbers; sizes known at run time only, one struct of pointers, each
 * array on its own.  Compiled by kernels.py; `run` takes a chunk of samples, as replant.kernels.step.fixed_filter.steps does.
 */
#include <math.h>
#include <stdint.h>

enum { GRADIENT, ADAM, AMSGRAD, ADAGRAD, RMSPROP, NADAM, ADADELTA, INTEGRAL_COST };

typedef struct {
    /* structure and settings */
    int64_t order, entries, input_entries, memory_size;
    int64_t algorithm, square_input, normalize, lag, capacity, batch, warmup, seed, recent_rows;
    double input_offset, output_offset, output_scale, interval;
    const double *transition, *output_taps, *input_taps, *characteristic, *gain, *unit, *settings;
    /* state */
    int64_t started, samples, rejected, refused, filled, head, drawn, past, recent_head;
    double last_output, elapsed;
    double *output_state, *input_state, *past_inputs, *past_held, *past_intervals, *recent, *phi, *theta, *memory, *backup, *buffer;
    int64_t *rows;
} identifier;

/* --- random rows: SplitMix64 */

static int64_t draw_below(uint64_t seed, uint64_t position, uint64_t bound)
{
    uint64_t z = seed + (position + 1) * 0x9E3779B97F4A7C15u;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    z ^= z >> 31;
    return (int64_t)(((z >> 32) * bound) >> 32);
}

/* --- powers of beta end here, before they are less than normal numbers: 1 less this is 1 */

#define VANISHED 1e-100

static double larger(double a, double b) { return b > a ? b : a; }

/* --- optimizers: a row of the buffer is phi (P entries), y, 1/m^2 */

static double normalized_error(int64_t P, const double *restrict theta, const double *restrict row)
{
    double prediction = 0.0;
    for (int64_t i = 0; i < P; i++)
        prediction += theta[i] * row[i];
    return (row[P] - prediction) * row[P + 1];
}

static void gradient(identifier *id, int64_t batch)
{
    int64_t P = id->entries;
    double *restrict theta = id->theta, gain = id->settings[0];
    for (int64_t k = 0; k < batch; k++) {
        const double *restrict phi = id->buffer + id->rows[k] * (P + 2);
        double step = gain * normalized_error(P, theta, phi);
        for (int64_t i = 0; i < P; i++)
            theta[i] += step * phi[i];
    }
}

static void adam(identifier *id, int64_t batch)
{
    int64_t P = id->entries;
    double alpha = id->settings[0], beta1 = id->settings[1], beta2 = id->settings[2], epsilon = id->settings[3];
    double *restrict theta = id->theta, *restrict m = id->memory, *restrict v = m + P;
    double power1 = v[P], power2 = v[P + 1];
    for (int64_t k = 0; k < batch; k++) {
        const double *restrict phi = id->buffer + id->rows[k] * (P + 2);
        double error = normalized_error(P, theta, phi);
        power1 = larger(power1 * beta1, VANISHED);
        power2 = larger(power2 * beta2, VANISHED);
        double rate = alpha / (1.0 - power1), root = 1.0 / sqrt(1.0 - power2);
        for (int64_t i = 0; i < P; i++) {
            double g = -error * phi[i];
            m[i] = beta1 * m[i] + (1.0 - beta1) * g;
            v[i] = beta2 * v[i] + (1.0 - beta2) * g * g;
            theta[i] -= rate * m[i] / (sqrt(v[i]) * root + epsilon);
        }
    }
    v[P] = power1;
    v[P + 1] = power2;
}

static void amsgrad(identifier *id, int64_t batch)
{
    int64_t P = id->entries;
    double alpha = id->settings[0], beta1 = id->settings[1], beta2 = id->settings[2], epsilon = id->settings[3];
    double *restrict theta = id->theta;
    double *restrict m = id->memory, *restrict v = m + P, *restrict largest = v + P;
    for (int64_t k = 0; k < batch; k++) {
        const double *restrict phi = id->buffer + id->rows[k] * (P + 2);
        double error = normalized_error(P, theta, phi);
        for (int64_t i = 0; i < P; i++) {
            double g = -error * phi[i];
            m[i] = beta1 * m[i] + (1.0 - beta1) * g;
            v[i] = beta2 * v[i] + (1.0 - beta2) * g * g;
            largest[i] = v[i] > largest[i] ? v[i] : largest[i];
            theta[i] -= alpha * m[i] / (sqrt(largest[i]) + epsilon);
        }
    }
}

static void adagrad(identifier *id, int64_t batch)
{
    int64_t P = id->entries;
    double alpha = id->settings[0], epsilon = id->settings[1];
    double *restrict theta = id->theta, *restrict sum = id->memory;
    for (int64_t k = 0; k < batch; k++) {
        const double *restrict phi = id->buffer + id->rows[k] * (P + 2);
        double error = normalized_error(P, theta, phi);
        for (int64_t i = 0; i < P; i++) {
            double g = -error * phi[i];
            sum[i] += g * g;
            theta[i] -= alpha * g / (sqrt(sum[i]) + epsilon);
        }
    }
}

static void rmsprop(identifier *id, int64_t batch)
{
    int64_t P = id->entries;
    double alpha = id->settings[0], rho = id->settings[1], epsilon = id->settings[2];
    double *restrict theta = id->theta, *restrict v = id->memory;
    for (int64_t k = 0; k < batch; k++) {
        const double *restrict phi = id->buffer + id->rows[k] * (P + 2);
        double error = normalized_error(P, theta, phi);
        for (int64_t i = 0; i < P; i++) {
            double g = -error * phi[i];
            v[i] = rho * v[i] + (1.0 - rho) * g * g;
            theta[i] -= alpha * g / (sqrt(v[i]) + epsilon);
        }
    }
}

static void nadam(identifier *id, int64_t batch)
{
    int64_t P = id->entries;
    double alpha = id->settings[0], beta1 = id->settings[1], beta2 = id->settings[2], epsilon = id->settings[3];
    double *restrict theta = id->theta, *restrict m = id->memory, *restrict v = m + P;
    double power1 = v[P], power2 = v[P + 1];
    for (int64_t k = 0; k < batch; k++) {
        const double *restrict phi = id->buffer + id->rows[k] * (P + 2);
        double error = normalized_error(P, theta, phi);
        power1 = larger(power1 * beta1, VANISHED);
        power2 = larger(power2 * beta2, VANISHED);
        double now = alpha * (1.0 - beta1) / (1.0 - power1), ahead = alpha * beta1 / (1.0 - beta1 * power1);
        double root = 1.0 / sqrt(1.0 - power2);
        for (int64_t i = 0; i < P; i++) {
            double g = -error * phi[i];
            m[i] = beta1 * m[i] + (1.0 - beta1) * g;
            v[i] = beta2 * v[i] + (1.0 - beta2) * g * g;
            theta[i] -= (ahead * m[i] + now * g) / (sqrt(v[i]) * root + epsilon);
        }
    }
    v[P] = power1;
    v[P + 1] = power2;
}

static void adadelta(identifier *id, int64_t batch)
{
    int64_t P = id->entries;
    double alpha = id->settings[0], rho = id->settings[1], epsilon = id->settings[2];
    double *restrict theta = id->theta, *restrict squares = id->memory, *restrict moved = squares + P;
    for (int64_t k = 0; k < batch; k++) {
        const double *restrict phi = id->buffer + id->rows[k] * (P + 2);
        double error = normalized_error(P, theta, phi);
        for (int64_t i = 0; i < P; i++) {
            double g = -error * phi[i];
            squares[i] = rho * squares[i] + (1.0 - rho) * g * g;
            double step = sqrt(moved[i] + epsilon) / sqrt(squares[i] + epsilon) * g;
            moved[i] = rho * moved[i] + (1.0 - rho) * step * step;
            theta[i] -= alpha * step;
        }
    }
}

static void integral_cost(identifier *id, int64_t batch)
{
    int64_t P = id->entries;
    double period = id->settings[0], gain = id->settings[1], keep = 1.0 - period * id->settings[2];
    double *restrict theta = id->theta;
    double *restrict R = id->memory, *restrict Q = R + P * P, *restrict slope = Q + P;
    for (int64_t k = 0; k < batch; k++) {
        const double *restrict phi = id->buffer + id->rows[k] * (P + 2);
        double y = phi[P], weight = period * phi[P + 1];
        for (int64_t i = 0; i < P; i++)
            theta[i] -= period * gain * slope[i];
        for (int64_t i = 0; i < P; i++) {
            double weighted = weight * phi[i], sum = keep * Q[i] - weighted * y;
            Q[i] = sum;
            for (int64_t j = 0; j < P; j++) {
                double entry = keep * R[i * P + j] + weighted * phi[j];
                R[i * P + j] = entry;
                sum += entry * theta[j];
            }
            slope[i] = sum;
        }
    }
}

static void learn(identifier *id, int64_t batch)
{
    switch (id->algorithm) {
    case GRADIENT: gradient(id, batch); break;
    case ADAM: adam(id, batch); break;
    case AMSGRAD: amsgrad(id, batch); break;
    case ADAGRAD: adagrad(id, batch); break;
    case RMSPROP: rmsprop(id, batch); break;
    case NADAM: nadam(id, batch); break;
    case ADADELTA: adadelta(id, batch); break;
    case INTEGRAL_COST: integral_cost(id, batch); break;
    }
}

/* --- one sample */

static void advance_filters(identifier *id, double u, double y)
{
    int64_t n = id->order, ring = id->lag + 3;
    const double *restrict A = id->transition, *restrict G = id->output_taps, *restrict H = id->input_taps;
    double *restrict wy = id->output_state, *restrict wu = id->input_state, *restrict spare = id->backup;
    if (!id->started) {
        for (int64_t i = 0; i < ring; i++)
            id->past_inputs[i] = id->past_held[i] = u, id->past_intervals[i] = id->interval;
        id->last_output = y;
        id->started = 1;
        return;
    }
    int64_t newest = id->past + 1 == ring ? 0 : id->past + 1;
    int64_t oldest = newest + 1 == ring ? 0 : newest + 1, middle = oldest + 1 == ring ? 0 : oldest + 1;
    int64_t latest = middle + 1 == ring ? 0 : middle + 1;
    id->past = newest;
    id->past_inputs[newest] = u;
    double u2 = id->past_inputs[oldest], u1 = id->past_inputs[middle], u0 = id->past_inputs[latest];
    id->past_held[newest] = u1;
    id->past_intervals[newest] = id->interval;
    double y1 = id->last_output;
    for (int64_t i = 0; i < n; i++) {
        double sy = G[i] * y1 + G[n + i] * y;
        double su = H[i] * u2 + H[n + i] * u1 + H[2 * n + i] * u0;
        for (int64_t j = 0; j < n; j++) {
            sy += A[i * n + j] * wy[j];
            su += A[i * n + j] * wu[j];
        }
        spare[i] = sy;
        spare[n + i] = su;
    }
    for (int64_t i = 0; i < n; i++) {
        wy[i] = spare[i];
        wu[i] = spare[n + i];
    }
    id->last_output = y;
}

static double regressor(identifier *id, double y)
{
    int64_t n = id->order, P = id->entries, inputs = id->input_entries;
    const double *restrict wy = id->output_state, *restrict wu = id->input_state + n - inputs;
    const double *restrict gain = id->gain, *restrict characteristic = id->characteristic;
    double *restrict phi = id->phi, target = y;
    for (int64_t i = 0; i < n; i++) {
        target -= characteristic[i] * wy[i];
        phi[i] = gain[i] * wy[i];
    }
    for (int64_t i = 0; i < inputs; i++)
        phi[n + i] = gain[n + i] * wu[i];
    if (P > n + inputs)
        phi[P - 1] = gain[P - 1];
    return target / id->output_scale;
}

static int64_t remember(identifier *id, double target)
{
    int64_t P = id->entries, head = id->head, batch = id->batch;
    const double *restrict phi = id->phi;
    double *restrict row = id->buffer + head * (P + 2), squares = 0.0;
    for (int64_t i = 0; i < P; i++) {
        row[i] = phi[i];
        squares += phi[i] * phi[i];
    }
    row[P] = target;
    row[P + 1] = id->normalize ? 1.0 / (1.0 + squares) : 1.0;
    id->head = head + 1 < id->capacity ? head + 1 : 0;
    if (id->filled < id->capacity)
        id->filled++;
    if (id->filled <= id->warmup)
        batch = 1;
    for (int64_t i = 0; i < batch - 1; i++)
        id->rows[i] = draw_below(id->seed, id->drawn + i, id->filled);
    id->drawn += batch - 1;
    id->rows[batch - 1] = head;
    return batch;
}

static void save(identifier *id)
{
    int64_t P = id->entries, M = id->memory_size;
    for (int64_t i = 0; i < P; i++)
        id->backup[i] = id->theta[i];
    for (int64_t i = 0; i < M; i++)
        id->backup[P + i] = id->memory[i];
}

static void restore(identifier *id)
{
    int64_t P = id->entries, M = id->memory_size;
    for (int64_t i = 0; i < P; i++)
        id->theta[i] = id->backup[i];
    for (int64_t i = 0; i < M; i++)
        id->memory[i] = id->backup[P + i];
}

static int all_finite(const identifier *id)
{
    int64_t P = id->entries, M = id->memory_size;
    const double *theta = id->theta, *unit = id->unit, *memory = id->memory;
    int yes = 1;
    for (int64_t i = 0; i < P; i++)
        yes &= isfinite(theta[i] * unit[i]) != 0;
    for (int64_t i = 0; i < M; i++)
        yes &= isfinite(memory[i]) != 0;
    return yes;
}

static void keep_sample(identifier *id, double u, double y)
{
    double *restrict row = id->recent + 3 * id->recent_head;
    row[0] = u;
    row[1] = y;
    row[2] = id->interval;
    id->recent_head = id->recent_head + 1 < id->recent_rows ? id->recent_head + 1 : 0;
}

static double step(identifier *id, double u, double y)
{
    if (id->square_input)
        u *= u;
    u -= id->input_offset;
    y -= id->output_offset;
    if (!(fabs(u) <= 1e150 && fabs(y) <= 1e150)) {
        id->rejected++;
        return NAN;
    }
    if (id->recent_rows > 0)
        keep_sample(id, u, y);
    if (id->samples > 0)
        id->elapsed += id->interval;
    advance_filters(id, u, y);
    double target = regressor(id, y), error = target;
    for (int64_t i = 0; i < id->entries; i++)
        error -= id->theta[i] * id->phi[i];
    save(id);
    learn(id, remember(id, target));
    if (!all_finite(id)) {
        id->refused++;
        restore(id);
    }
    id->samples++;
    return error * id->output_scale;
}

void run(identifier *id, int64_t samples, const double *u, const double *y, double *errors, double *parameters)
{
    int64_t P = id->entries;
    for (int64_t k = 0; k < samples; k++) {
        errors[k] = step(id, u[k], y[k]);
        for (int64_t i = 0; i < P; i++)
            parameters[k * P + i] = id->theta[i] * id->unit[i];
    }
}
