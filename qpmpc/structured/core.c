/* The passes and the active-set method of passes.py and activeset.py, for one part of a QP in stages.
 *
 * STATES, INPUTS, READINGS and OUTPUTS are defined before this text: loops of known length are what
 * makes it fast. Matrices are row by row unless their name ends in _t. Nothing is allocated here.
 */
#include <math.h>
#include <stdint.h>
#include <string.h>

#define N STATES
#define M INPUTS
#define K READINGS
#define Y OUTPUTS

enum { FREE = 0, HELD = 1, GIVING = 2 };
enum { SOLVED = 0, FAILED = 1, INFEASIBLE = 2, ITERATION_LIMIT = 3 };

typedef struct {
    /* the part */
    int64_t horizon, moves, limit;
    double tolerance, loosest, equal_room, linear_share;
    const double *F, *F_held, *G;
    const double *read, *output, *output_weight, *decision_weight;
    const double *price, *give;
    const int64_t *rows, *variables, *outputs;
    /* its recursion */
    const double *closed, *closed_t, *gain, *inverse, *root, *noise, *covariance, *weak;
    /* what goes on from solve to solve */
    signed char *state;
    double *multiplier;
    /* what a solve writes on */
    double *q, *l, *u, *feed, *decision, *value, *spare, *slope, *after, *step, *before;
    double *seen_gain, *seen_weight;
    int64_t *seen;
    signed char *equal, *met;
    int64_t steps;
} Part;

/* out = matrix_t' x: each column of the matrix times one entry of x. */
static inline void times(double *restrict out, const double *restrict matrix_t, const double *x) {
    for (int a = 0; a < N; a++) out[a] = matrix_t[a] * x[0];
    for (int b = 1; b < N; b++)
        for (int a = 0; a < N; a++) out[a] += matrix_t[b * N + a] * x[b];
}

static inline double dot(const double *x, const double *y) {
    double sum = 0.0;
    for (int a = 0; a < N; a++) sum += x[a] * y[a];
    return sum;
}

/* The minimiser of 1/2 z' P z + q' z + price' A z, and what the rows read there. */
static void respond(const Part *part, const double *price, double *restrict decision,
                    double *restrict value) {
    const int64_t horizon = part->horizon, moves = part->moves;
    double p[N] = {0}, s[N] = {0}, next[N];
    for (int64_t i = horizon - 1; i >= 0; i--) {
        const double *here = price + i * K;
        for (int j = 0; j < K; j++)
            for (int a = 0; a < N; a++) p[a] += here[j] * part->read[j * N + a];
        times(next, part->closed + i * N * N, p);
        if (i < moves) {
            double slope[M];
            for (int c = 0; c < M; c++) {
                slope[c] = part->q[i * M + c];
                for (int a = 0; a < N; a++) slope[c] += part->G[a * M + c] * p[a];
            }
            for (int c = 0; c < M; c++) {
                double feed = 0.0;
                for (int d = 0; d < M; d++) feed -= part->inverse[(i * M + c) * M + d] * slope[d];
                part->feed[i * M + c] = feed;
                for (int a = 0; a < N; a++)
                    next[a] += part->q[i * M + c] * part->gain[(i * M + c) * N + a];
            }
        }
        memcpy(p, next, sizeof p);
    }
    for (int64_t i = 0; i < horizon; i++) {
        times(next, part->closed_t + i * N * N, s);
        if (i < moves)
            for (int c = 0; c < M; c++) {
                const double feed = part->feed[i * M + c];
                decision[i * M + c] = feed + dot(part->gain + (i * M + c) * N, s);
                for (int a = 0; a < N; a++) next[a] += part->G[a * M + c] * feed;
            }
        memcpy(s, next, sizeof s);
        for (int j = 0; j < K; j++) value[i * K + j] = dot(part->read + j * N, s);
    }
}

static inline int is_free_to_move(const Part *part, int64_t at) {
    const int state = part->state[at], size = state < 0 ? -state : state;
    return size == HELD || (size == GIVING && part->give[at % K] > 0.0);
}

/* Solve (A P^-1 A' + noise + give) y = slope over the rows that are held. */
static void equalise(const Part *part, const double *slope, double *y) {
    const int64_t horizon = part->horizon;
    int64_t first = horizon, last = -1, count = 0;
    memset(y, 0, (size_t)(horizon * K) * sizeof *y);
    for (int64_t at = 0; at < horizon * K; at++)
        if (is_free_to_move(part, at)) {
            if (first == horizon) first = at / K;
            last = at / K;
        }
    if (last < 0) return;
    double covariance[N * N], half[N * N], mean[N] = {0}, next[N], reach[N];
    memcpy(covariance, part->covariance + first * N * N, sizeof covariance);
    for (int64_t i = first; i <= last; i++) {
        if (i > first) {
            const double *closed = part->closed + i * N * N, *closed_t = part->closed_t + i * N * N;
            times(next, closed_t, mean);
            memcpy(mean, next, sizeof mean);
            for (int a = 0; a < N; a++) times(half + a * N, closed_t, covariance + a * N);
            for (int a = 0; a < N; a++) {
                double *row = covariance + a * N;
                memcpy(row, part->noise + (i * N + a) * N, N * sizeof *row);
                for (int b = 0; b < N; b++)
                    for (int c = 0; c < N; c++) row[c] += closed[a * N + b] * half[b * N + c];
            }
        }
        for (int j = 0; j < K; j++) {
            const int64_t at = i * K + j;
            if (!is_free_to_move(part, at)) continue;
            const double *read = part->read + j * N;
            const int gives = part->state[at] == GIVING || part->state[at] == -GIVING;
            for (int a = 0; a < N; a++) reach[a] = dot(covariance + a * N, read);
            const double spread =
                fmax(dot(read, reach), 0.0) + part->weak[at] + (gives ? part->give[j] : 0.0);
            const double surprise = slope[at] - dot(read, mean);
            double *gain = part->seen_gain + count * N;
            for (int a = 0; a < N; a++) gain[a] = reach[a] / spread;
            for (int a = 0; a < N; a++) mean[a] += gain[a] * surprise;
            for (int a = 0; a < N; a++)
                for (int b = 0; b < N; b++) covariance[a * N + b] -= gain[a] * reach[b];
            part->seen[count] = at;
            part->seen_weight[count++] = surprise / spread;
        }
    }
    double adjoint[N] = {0};
    int64_t stage = last;
    while (count-- > 0) {
        const int64_t at = part->seen[count];
        for (; stage > at / K; stage--) {
            times(next, part->closed + stage * N * N, adjoint);
            memcpy(adjoint, next, sizeof adjoint);
        }
        y[at] = part->seen_weight[count] - dot(part->seen_gain + count * N, adjoint);
        for (int a = 0; a < N; a++) adjoint[a] += part->read[(at % K) * N + a] * y[at];
    }
}

/* The range of a multiplier in its present state. */
static inline void range(const Part *part, int64_t at, double *low, double *high) {
    const double price = part->price[at % K];
    const int curved = part->give[at % K] > 0.0;
    *low = *high = 0.0;
    switch (part->state[at]) {
        case HELD: *high = price; if (part->equal[at]) *low = -price; break;
        case -HELD: *low = -price; if (part->equal[at]) *high = price; break;
        case GIVING: *low = price; *high = curved ? INFINITY : price; break;
        case -GIVING: *high = -price; *low = curved ? -INFINITY : -price; break;
    }
}

/* The slope of the dual cost in the multipliers that may move; return the largest. */
static double find_slope(const Part *part, const double *value, double *slope) {
    double worst = 0.0;
    for (int64_t at = 0; at < part->horizon * K; at++) {
        slope[at] = 0.0;
        if (part->state[at] == FREE || !is_free_to_move(part, at)) continue;
        slope[at] = value[at] - (part->state[at] > 0 ? part->u[at] : part->l[at]);
        if (part->state[at] == GIVING)
            slope[at] -= (part->multiplier[at] - part->price[at % K]) * part->give[at % K];
        else if (part->state[at] == -GIVING)
            slope[at] -= (part->multiplier[at] + part->price[at % K]) * part->give[at % K];
        worst = fmax(worst, fabs(slope[at]));
    }
    return worst;
}

static inline double excess(const Part *part, int64_t at) {
    if (part->rows[at] < 0) return -INFINITY;
    const double value = part->value[at], u = part->u[at], l = part->l[at];
    if (part->state[at] == FREE) return fmax(value - u, l - value);
    if (part->give[at % K] > 0.0) return -INFINITY;
    if (part->state[at] == GIVING) return u - value;
    if (part->state[at] == -GIVING) return value - l;
    return -INFINITY;
}

static void release_one(const Part *part, int64_t at) {
    if (part->state[at] == FREE)
        part->state[at] = part->value[at] > part->u[at] ? HELD : -HELD;
    else
        part->state[at] /= GIVING;
}

/* Free the worst row of each run of rows that should be. */
static int release(const Part *part, double tolerance) {
    int found = 0;
    for (int j = 0; j < K; j++) {
        int64_t best = -1;
        double most = tolerance;
        for (int64_t at = j; at < part->horizon * K; at += K) {
            const double here = excess(part, at);
            if (here > tolerance) {
                if (best < 0 || here > most) best = at, most = here;
            } else if (best >= 0) {
                release_one(part, best);
                found = 1, best = -1, most = tolerance;
            }
        }
        if (best >= 0) release_one(part, best), found = 1;
    }
    return found;
}

static void settle(const Part *part) {
    for (int64_t at = 0; at < part->horizon * K; at++) {
        if (!part->met[at]) continue;
        if (part->state[at] == GIVING || part->state[at] == -GIVING)
            part->state[at] /= GIVING;
        else if (part->multiplier[at] == 0.0 && !part->equal[at])
            part->state[at] = FREE;
        else
            part->state[at] = part->multiplier[at] > 0.0 ? GIVING : -GIVING;
    }
}

/* One step on the multipliers that may move; return by how much the dual cost rose. */
static double climb(const Part *part, int *whole, double *promise) {
    const int64_t size = part->horizon * K;
    double *y = part->multiplier;
    int any = 0;
    equalise(part, part->slope, part->step);
    memcpy(part->before, y, (size_t)size * sizeof *y);
    for (int64_t at = 0; at < size; at++) {
        part->met[at] = 0;
        if (!is_free_to_move(part, at)) continue;
        double low, high;
        range(part, at, &low, &high);
        const double aim = y[at] + part->step[at];
        y[at] = fmin(fmax(aim, low), high);
        part->met[at] = y[at] != aim;
        any |= part->met[at];
    }
    respond(part, y, part->decision, part->value);
    find_slope(part, part->value, part->after);
    double gain = 0.0;
    *promise = 0.0;
    for (int64_t at = 0; at < size; at++) {
        *promise += part->slope[at] * (y[at] - part->before[at]);
        gain += part->after[at] * (y[at] - part->before[at]);
    }
    gain = 0.5 * (gain + *promise);
    if (any && gain <= 0.0) {
        double least = INFINITY;
        for (int64_t at = 0; at < size; at++) {
            if (!part->met[at]) continue;
            double low, high;
            range(part, at, &low, &high);
            const double step = part->step[at], before = part->before[at];
            least = fmin(least, (step > 0 ? high - before : before - low) / fabs(step));
        }
        for (int64_t at = 0; at < size; at++) {
            if (!is_free_to_move(part, at)) continue;
            const double step = part->step[at], before = part->before[at];
            y[at] = before + least * step;
            if (!part->met[at]) continue;
            double low, high;
            range(part, at, &low, &high);
            part->met[at] = (step > 0 ? high - before : before - low) / fabs(step) <= least;
            if (part->met[at]) y[at] = step > 0 ? high : low;
        }
        respond(part, y, part->decision, part->value);
        find_slope(part, part->value, part->after);
        gain = 0.0;
        for (int64_t at = 0; at < size; at++)
            gain += 0.5 * (part->slope[at] + part->after[at]) * (y[at] - part->before[at]);
    }
    *whole = !any;
    if (any) settle(part);
    return gain;
}

/* Take the last active set for this one, one step later, as far as it fits the bounds. */
static void resume(const Part *part) {
    const int64_t size = part->horizon * K;
    memmove(part->state, part->state + K, (size_t)(size - K));
    memmove(part->multiplier, part->multiplier + K, (size_t)(size - K) * sizeof(double));
    for (int64_t at = 0; at < size; at++) {
        signed char *state = part->state + at;
        double *y = part->multiplier + at;
        const double u = part->u[at], l = part->l[at];
        part->equal[at] =
            u - l <= part->equal_room * (1.0 + (isfinite(u) ? fabs(u) : 0.0));
        if (*state == FREE) {
            *y = 0.0;
            continue;
        }
        const int held = *state == HELD || *state == -HELD;
        if (part->rows[at] < 0 || (*state > 0 && isinf(u)) || (*state < 0 && isinf(l)) ||
            (held && *y * *state < 0.0 && !part->equal[at]))
            *state = FREE;
        double low, high;
        range(part, at, &low, &high);
        *y = fmin(fmax(*y, low), high);
    }
}

static int optimise(Part *part) {
    const int64_t size = part->horizon * K;
    resume(part);
    respond(part, part->multiplier, part->decision, part->value);
    double reach = 0.0;
    for (int64_t at = 0; at < size; at++) reach = fmax(reach, fabs(part->value[at]));
    double tolerance = part->tolerance * (1.0 + reach);
    const double loosest = part->loosest * (1.0 + reach);
    double climbed = INFINITY, last = INFINITY;
    int stuck = 0;
    for (part->steps = 0; part->steps < part->limit; part->steps++) {
        double worst = find_slope(part, part->value, part->slope);
        if (worst <= tolerance) {
            if (climbed <= 0.0 && part->steps) tolerance = fmin(10.0 * tolerance, loosest);
            if (!release(part, tolerance)) return SOLVED;
            worst = find_slope(part, part->value, part->slope);
            climbed = 0.0, last = INFINITY, stuck = 0;
        } else if (stuck >= 2) {
            if (worst > loosest) return FAILED;
            tolerance = 2.0 * worst, stuck = 0;
            continue;
        }
        int whole;
        double promise;
        const double gain = climb(part, &whole, &promise);
        climbed += fmax(gain, 0.0);
        stuck = whole && worst > 0.5 * last ? stuck + 1 : 0;
        last = worst;
        if (whole && gain > part->linear_share * promise && worst > loosest) {
            part->steps++;
            return INFEASIBLE;
        }
    }
    return ITERATION_LIMIT;
}

/* Solve for the vectors of the whole QP; write the part's share of minimiser and multipliers. */
int solve(Part *part, const double *q, const double *l, const double *u, double *x, double *y) {
    const int64_t size = part->horizon * K;
    for (int64_t i = 0; i < part->moves * M; i++) part->q[i] = q[part->variables[i]];
    for (int64_t at = 0; at < size; at++) {
        const int64_t row = part->rows[at];
        part->l[at] = row < 0 ? -INFINITY : l[row];
        part->u[at] = row < 0 ? INFINITY : u[row];
    }
    const int status = optimise(part);
    for (int64_t i = 0; i < part->moves * M; i++) x[part->variables[i]] = part->decision[i];
    for (int64_t at = 0; at < size; at++)
        if (part->rows[at] >= 0) y[part->rows[at]] = part->multiplier[at];
    return status;
}

/* The minimiser without rows. */
void minimise(Part *part, const double *q, double *out) {
    for (int64_t i = 0; i < part->moves * M; i++) part->q[i] = q[part->variables[i]];
    memset(part->step, 0, (size_t)(part->horizon * K) * sizeof(double));
    respond(part, part->step, part->decision, part->value);
    for (int64_t i = 0; i < part->moves * M; i++) out[part->variables[i]] = part->decision[i];
}

/* One step of the recursion without feedback. */
static inline void forward(const Part *part, int64_t i, const double *z, double *s) {
    double next[N] = {0};
    const double *F = i < part->moves ? part->F : part->F_held;
    for (int a = 0; a < N; a++) {
        for (int b = 0; b < N; b++) next[a] += F[a * N + b] * s[b];
        if (i < part->moves)
            for (int c = 0; c < M; c++) next[a] += part->G[a * M + c] * z[i * M + c];
    }
    memcpy(s, next, sizeof next);
}

static inline void backward(const Part *part, int64_t i, double *p) {
    double next[N];
    times(next, i < part->moves ? part->F : part->F_held, p);
    memcpy(p, next, sizeof next);
}

/* Outputs under a decision: the part's share of Theta x. */
void outputs(Part *part, const double *x, double *out) {
    double s[N] = {0};
    for (int64_t i = 0; i < part->moves * M; i++) part->decision[i] = x[part->variables[i]];
    for (int64_t i = 0; i < part->horizon; i++) {
        forward(part, i, part->decision, s);
        for (int j = 0; j < Y; j++) out[part->outputs[i * Y + j]] = dot(part->output + j * N, s);
    }
}

/* Gradient from weights on the outputs: the part's share of Theta' error. */
void output_gradient(Part *part, const double *error, double *out) {
    double p[N] = {0};
    for (int64_t i = part->horizon - 1; i >= 0; i--) {
        for (int j = 0; j < Y; j++)
            for (int a = 0; a < N; a++)
                p[a] += error[part->outputs[i * Y + j]] * part->output[j * N + a];
        if (i < part->moves)
            for (int c = 0; c < M; c++) {
                double sum = 0.0;
                for (int a = 0; a < N; a++) sum += part->G[a * M + c] * p[a];
                out[part->variables[i * M + c]] = sum;
            }
        backward(part, i, p);
    }
}

/* The part's share of A x. */
void rows(Part *part, const double *x, double *out) {
    double s[N] = {0};
    for (int64_t i = 0; i < part->moves * M; i++) part->decision[i] = x[part->variables[i]];
    for (int64_t i = 0; i < part->horizon; i++) {
        forward(part, i, part->decision, s);
        for (int j = 0; j < K; j++)
            if (part->rows[i * K + j] >= 0) out[part->rows[i * K + j]] = dot(part->read + j * N, s);
    }
}

/* The part's share of P x + A' y. */
void gradient(Part *part, const double *x, const double *y, double *out) {
    double s[N] = {0}, p[N] = {0};
    for (int64_t i = 0; i < part->moves * M; i++) part->decision[i] = x[part->variables[i]];
    for (int64_t i = 0; i < part->horizon; i++) {
        forward(part, i, part->decision, s);
        for (int j = 0; j < Y; j++)
            part->spare[i * Y + j] = 2.0 * part->output_weight[j] * dot(part->output + j * N, s);
    }
    for (int64_t i = part->horizon - 1; i >= 0; i--) {
        for (int j = 0; j < Y; j++)
            for (int a = 0; a < N; a++) p[a] += part->spare[i * Y + j] * part->output[j * N + a];
        for (int j = 0; j < K; j++) {
            const int64_t row = part->rows[i * K + j];
            if (row >= 0)
                for (int a = 0; a < N; a++) p[a] += y[row] * part->read[j * N + a];
        }
        if (i < part->moves)
            for (int c = 0; c < M; c++) {
                double sum = 2.0 * part->decision_weight[c] * part->decision[i * M + c];
                for (int a = 0; a < N; a++) sum += part->G[a * M + c] * p[a];
                out[part->variables[i * M + c]] = sum;
            }
        backward(part, i, p);
    }
}

/* The part's share of T' g, T being the factor of P that the recursion gives. */
void whiten(Part *part, const double *g, double *out) {
    double p[N] = {0}, next[N];
    for (int64_t i = part->horizon - 1; i >= 0; i--) {
        times(next, part->closed + i * N * N, p);
        if (i < part->moves) {
            double slope[M];
            for (int c = 0; c < M; c++) {
                const double here = g[part->variables[i * M + c]];
                slope[c] = here;
                for (int a = 0; a < N; a++) {
                    slope[c] += part->G[a * M + c] * p[a];
                    next[a] += here * part->gain[(i * M + c) * N + a];
                }
            }
            for (int c = 0; c < M; c++) {
                double sum = 0.0;
                for (int d = 0; d < M; d++) sum += part->root[(i * M + d) * M + c] * slope[d];
                out[part->variables[i * M + c]] = sum;
            }
        }
        memcpy(p, next, sizeof p);
    }
}
