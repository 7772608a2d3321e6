/* What all parts of a compiled step share. The generator writes the sizes of the whole before it:
   STATES, INPUTS, MEASURED, OUTPUTS, HORIZON, MOVES, ROWS, INCREMENT (whether the decision is one),
   HEEDED (whether answers heed the rows), TOLERANCE and CLIP_TOLERANCE. */

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <time.h>

#define INLINE static inline __attribute__((always_inline))
#define LANES 8
#define BLOCKS(n) (((n) + LANES - 1) / LANES)
#define PADDED(n) (BLOCKS(n) * LANES)
#define SOME(n) ((n) > 0 ? (n) : 1)
#define JOIN_(a, b) a##_##b
#define JOIN(a, b) JOIN_(a, b)

typedef double block __attribute__((vector_size(8 * LANES), aligned(8 * LANES), may_alias));

/* How a cycle ended: what `step` returns. From HANDED_OVER on nothing has been decided, and all
   memory that is shared is as `prepare` left it. */
enum {
  DECIDED = 0,
  CLIPPED = 1,
  HANDED_OVER = 2,      /* an answer that is not optimal */
  NOT_MEASURED = 3,     /* NaN or infinity among what was measured */
  NOT_FINITE = 4,       /* NaN or infinity among the vectors of the QP, or bounds that cross */
  NOT_CHECKED = 5,      /* an answer that failed the check */
  TOO_LATE = 6,         /* an answer after the deadline */
  NOT_STEADY = 7        /* the gain is not that of the steady state, or the gate refuses a row */
};

#define REFUSED 2 /* what `update` says where the gate refuses a row */

/* Memory that the interpreted path reads and writes too; pointers only, in the generator's order. */
struct shared {
  const double *measurement; /* (MEASURED) */
  const double *preview;     /* (HORIZON + 1, OUTPUTS) */
  const double *decay;       /* (HORIZON) */
  const double *lower;       /* (ROWS) bounds as they are in this cycle */
  const double *upper;       /* (ROWS) */
  const double *low;         /* (INPUTS) of u(k) */
  const double *high;        /* (INPUTS) */
  const double *fall;        /* (INPUTS) of the change of u(k) */
  const double *rise;        /* (INPUTS) */
  const double *remaining;   /* time until the answer has to be there [s] */
  const double *gate;        /* (MEASURED) innovation up to which a row is taken */
  int64_t *missing;          /* (MEASURED) cycles for which each row has not been used */
  const int64_t *settled;    /* whether the observer's gain is that of the steady state */
  double *state;             /* (STATES) */
  double *command;           /* (INPUTS) */
  double *free;              /* (HORIZON, OUTPUTS) */
  double *q;                 /* (MOVES, INPUTS) */
  double *l;                 /* (ROWS) */
  double *u;                 /* (ROWS) */
  double *plan;              /* (MOVES, INPUTS) */
  int64_t *cursor;           /* which command of the plan is the next */
  int64_t *prepared;         /* whether the state is that of the cycle to come */
  double *values;            /* what a step leaves behind, see VALUES below */
  int64_t *counts;           /* iterations of the last step */
};

/* Where what a step leaves behind stands in `values`. */
enum {
  AT_COMMAND = 0,
  AT_DECISION = AT_COMMAND + INPUTS,
  AT_PREDICTED = AT_DECISION + MOVES * INPUTS,
  AT_VIOLATION = AT_PREDICTED + HORIZON * OUTPUTS,
  AT_RESIDUALS = AT_VIOLATION + ROWS, /* primal, dual, gap, scaled */
  AT_TIMES = AT_RESIDUALS + 4,        /* update, solve [s] */
  VALUES = AT_TIMES + 2
};

/* What the groups bring together of the check. */
struct findings {
  double primal, dual, gap;          /* in the QP's own units */
  double infeasible, steep, unpaid;  /* scaled: hard rows, gradient, complementarity */
  double level, reach;               /* size of the gradient and of the rows, scaled */
  int lost, clipped;                 /* whether anything is not finite; whether a command was clipped */
  int64_t iterations;
};

INLINE double larger(double a, double b) { return a > b ? a : b; }
INLINE double smaller(double a, double b) { return a < b ? a : b; }

INLINE double seconds(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* y = base + M x, with M in columns of whole blocks; base may be y, or NULL for zero. */
INLINE void product(int blocks, int columns, const block *M, const double *x, const block *base,
                    block *y) {
  const block zero = {0};
  int b = 0;
  for (; b + 4 <= blocks; b += 4) {
    block s0 = base ? base[b] : zero, s1 = base ? base[b + 1] : zero;
    block s2 = base ? base[b + 2] : zero, s3 = base ? base[b + 3] : zero;
    for (int j = 0; j < columns; j++) {
      const block *column = M + (size_t)j * blocks + b;
      s0 += column[0] * x[j];
      s1 += column[1] * x[j];
      s2 += column[2] * x[j];
      s3 += column[3] * x[j];
    }
    y[b] = s0, y[b + 1] = s1, y[b + 2] = s2, y[b + 3] = s3;
  }
  for (; b + 2 <= blocks; b += 2) {
    block s0 = base ? base[b] : zero, s1 = base ? base[b + 1] : zero;
    for (int j = 0; j < columns; j++) {
      const block *column = M + (size_t)j * blocks + b;
      s0 += column[0] * x[j];
      s1 += column[1] * x[j];
    }
    y[b] = s0, y[b + 1] = s1;
  }
  for (; b < blocks; b++) { /* two sums, as one would wait for itself */
    block s0 = base ? base[b] : zero, s1 = zero;
    int j = 0;
    for (; j + 2 <= columns; j += 2) {
      s0 += M[(size_t)j * blocks + b] * x[j];
      s1 += M[(size_t)(j + 1) * blocks + b] * x[j + 1];
    }
    for (; j < columns; j++) s0 += M[(size_t)j * blocks + b] * x[j];
    y[b] = s0 + s1;
  }
}

INLINE double total(int blocks, const block *x) {
  block s = {0};
  for (int b = 0; b < blocks; b++) s += x[b];
  double sum = 0;
  for (int i = 0; i < LANES; i++) sum += s[i];
  return sum;
}
