/* The walk from region to region, as in interpreted.py: same names, same order, no memory of its
   own. Rooms are distances to the upper bounds, then to the lower ones, 2 m in all. */

#include <math.h>
#include <stdint.h>
#include <string.h>

typedef struct {
    int32_t k, fixed;       /* rows held, rows that pull with their penalty alone */
    const int8_t *side;     /* m */
    const int32_t *held;    /* k + fixed: the fixed ones behind */
    const int32_t *pick;    /* k */
    const double *sign;     /* k */
    const double *low;      /* k */
    const double *high;     /* k */
    const double *shift;    /* k */
    const double *inverse;  /* k k */
    const double *base;     /* m */
    int32_t *link;          /* 2 m: region behind each slot, -1: unknown */
} region;

typedef struct {
    int32_t n, m, steps, last, begun, stuck_at, stuck_slot, unused;
    int64_t same, walked, missed, tried, longest;
    double exact, far;
    const double *minimiser; /* n n */
    const double *rows;      /* m n */
    const double *response;  /* m n: transposed */
    const double *gram;      /* m m, symmetric */
    const double *linear;    /* m */
    const region *regions;
    const double *q, *l, *u;
    double *x, *y;
    double *begin, *end;         /* 2 m: rooms at the ends of the way */
    double *gap_begin, *gap_end; /* 2 m: what is left of them in a region */
    double *pull_begin, *pull;   /* m */
} law;

/* What is left of the rooms in a region, and the pulls there. */
static void measure(const law *w, const region *r, const double *room, double *gap, double *pull)
{
    const int32_t m = w->m, k = r->k;
    for (int32_t a = 0; a < k; a++) {
        double sum = 0.0;
        for (int32_t b = 0; b < k; b++) sum += r->inverse[a * k + b] * room[r->pick[b]];
        pull[a] = r->shift[a] - sum;
    }
    memcpy(gap, room, 2 * (size_t)m * sizeof(double));
    for (int32_t a = 0; a < k + r->fixed; a++) {
        const double y = a < k ? r->sign[a] * pull[a] : r->base[r->held[a]];
        const double *column = w->gram + (size_t)r->held[a] * m;
        for (int32_t i = 0; i < m; i++) {
            gap[i] += column[i] * y;
            gap[m + i] -= column[i] * y;
        }
    }
    for (int32_t a = 0; a < k + r->fixed; a++) {
        const int32_t i = r->held[a];
        switch (r->side[i]) {
        case 1: gap[i] = 0.0; break;
        case -1: gap[m + i] = 0.0; break;
        case 2: gap[i] = -gap[i]; break;
        case -2: gap[m + i] = -gap[m + i]; break;
        }
    }
}

static double least(const law *w, const region *r, int32_t a)
{
    const int32_t row = r->held[a];
    return r->low[a] > 0.0 || w->l[row] != w->u[row] ? r->low[a] : -w->linear[row];
}

static int holds(const law *w, const region *r, double exact)
{
    for (int32_t j = 0; j < 2 * w->m; j++)
        if (!(w->gap_end[j] >= -exact)) return 0;
    for (int32_t a = 0; a < r->k; a++)
        if (!(w->pull[a] - least(w, r, a) >= -exact && r->high[a] - w->pull[a] >= -exact)) return 0;
    return 1;
}

/* Keep the first inequality that fails on the way; never before where the way has come to. */
static void first(double from, double to, double way, int32_t slot, double exact, double *reach,
                  int32_t *found)
{
    if (to >= -exact) return;
    double at = from > to ? from / (from - to) : 0.0;
    if (!(at > way)) at = way;
    if (at < *reach) {
        *reach = at;
        *found = slot;
    }
}

static void answer(law *w, const region *r)
{
    const int32_t n = w->n;
    memset(w->y, 0, (size_t)w->m * sizeof(double));
    for (int32_t i = 0; i < n; i++) {
        double sum = 0.0;
        for (int32_t j = 0; j < n; j++) sum += w->minimiser[i * n + j] * w->q[j];
        w->x[i] = sum;
    }
    for (int32_t a = 0; a < r->k + r->fixed; a++) {
        const int32_t row = r->held[a];
        const double y = a < r->k ? r->sign[a] * w->pull[a] : r->base[row];
        const double *column = w->response + (size_t)row * n;
        w->y[row] = y;
        for (int32_t i = 0; i < n; i++) w->x[i] -= column[i] * y;
    }
}

void walk_stand(law *w, int32_t index)
{
    w->last = index;
    w->begun = 1;
    memcpy(w->begin, w->end, 2 * (size_t)w->m * sizeof(double));
}

static int32_t search(law *w)
{
    const int32_t n = w->n, m = w->m;
    double level = 0.0, way = 0.0;
    for (int32_t j = 0; j < n; j++) level = fmax(level, fabs(w->q[j]));
    const double exact = w->exact * (1.0 + level);
    for (int32_t i = 0; i < m; i++) {
        double row = 0.0;
        for (int32_t j = 0; j < n; j++) row += w->rows[i * n + j] * w->q[j];
        w->end[i] = w->u[i] - row > w->far ? w->far : w->u[i] - row; /* NaN stays */
        w->end[m + i] = row - w->l[i] > w->far ? w->far : row - w->l[i];
    }
    if (!w->begun) /* anything with room on all sides lies in the first region */
        for (int32_t j = 0; j < 2 * m; j++) w->begin[j] = fmin(fabs(w->end[j]) + 1.0, w->far);
    w->stuck_at = -1;
    int32_t index = w->last;
    for (int32_t tried = 1; tried <= w->steps; tried++) {
        const region *r = w->regions + index;
        measure(w, r, w->end, w->gap_end, w->pull);
        if (holds(w, r, exact)) {
            answer(w, r);
            walk_stand(w, index);
            return tried;
        }
        measure(w, r, w->begin, w->gap_begin, w->pull_begin);
        double reach = INFINITY;
        int32_t slot = -1;
        for (int32_t j = 0; j < 2 * m; j++) {
            const int32_t row = j < m ? j : j - m;
            const int32_t change = 2 * row + (r->side[row] == 0 && j >= m);
            first(w->gap_begin[j], w->gap_end[j], way, change, exact, &reach, &slot);
        }
        for (int32_t a = 0; a < r->k; a++) {
            const double low = least(w, r, a);
            first(w->pull_begin[a] - low, w->pull[a] - low, way, 2 * r->held[a], exact, &reach, &slot);
        }
        for (int32_t a = 0; a < r->k; a++)
            first(r->high[a] - w->pull_begin[a], r->high[a] - w->pull[a], way, 2 * r->held[a] + 1,
                  exact, &reach, &slot);
        const int32_t following = slot < 0 ? -1 : r->link[slot];
        if (following < 0) {
            w->stuck_at = index;
            w->stuck_slot = slot;
            return -tried;
        }
        index = following;
        way = reach;
    }
    return -w->steps;
}

/* How many regions were tried, the last of which holds; negative if none does. */
int32_t walk_search(law *w)
{
    const int32_t found = search(w), tried = found > 0 ? found : -found;
    w->same += found == 1;
    w->walked += found > 1;
    w->missed += found < 0;
    w->tried += tried;
    if (tried > w->longest) w->longest = tried;
    return found;
}
