/* What is linear in predicted state and last command is done by `prepare`; `update` adds what the
   innovation and the preview change, `conclude` checks an answer, `commit` hands it out. The
   backend's own text stands before this one and brings `struct solver`, `start`, `forget` and `solve`. */

struct NAME(group) {
  const struct NAME(constants) *constants;
  const struct NAME(maps) *maps;
  int64_t known; /* whether xp, up, base are those of some state and command */
  block xp[XB], x[XB];
  double up[NU];
  block base[GB]; /* measured, outputs; free response; rows: without the innovation */
  block now[GB];  /* the same with it */
  block error[FB], q[ZB], v[ZB], l[SOME(RB)], u[SOME(RB)];
  block decision[ZB], predicted[FB], slack[SOME(RB)];
  double command[NU];
  int active;             /* how many rows have a multiplier */
  int row[SOME(NR)];      /* which */
  double price[SOME(NR)]; /* the multiplier, scaled */
  struct NAME(solver) solver;
};

static void NAME(prepare)(struct NAME(group) *g, const struct shared *s, int advance) {
  const struct NAME(constants) *c = g->constants;
  const struct NAME(maps) *at = g->maps;
  double p[NP];
  for (int i = 0; i < NX; i++) p[i] = s->state[at->state[i]];
  for (int i = 0; i < NU; i++) p[NX + i] = g->up[i] = s->command[at->input[i]];
  if (advance) {
    product(XB, NP, c->advance, p, NULL, g->xp);
    const double *x = (const double *)g->xp;
    for (int i = 0; i < NX; i++) s->state[at->state[i]] = p[i] = x[i];
  } else {
    double *x = (double *)g->xp;
    for (int i = 0; i < NX; i++) x[i] = p[i];
  }
  product(GB, NP, c->respond, p, NULL, g->base);
  g->known = 1;
}

/* Whether state and command are still those that `prepare` saw. */
INLINE int NAME(fresh)(const struct NAME(group) *g, const struct shared *s) {
  const double *x = (const double *)g->xp;
  int same = g->known != 0;
  for (int i = 0; i < NX; i++) same &= s->state[g->maps->state[i]] == x[i];
  for (int i = 0; i < NU; i++) same &= s->command[g->maps->input[i]] == g->up[i];
  return same;
}

/* Return 0, or REFUSED, or 1 where something is not finite. */
static int NAME(update)(struct NAME(group) *g, const struct shared *s) {
  const struct NAME(constants) *c = g->constants;
  const struct NAME(maps) *at = g->maps;
  double e[SOME(NM)];
  int refused = 0;
  const double *head = (const double *)g->base;
  for (int i = 0; i < NM; i++) {
    e[i] = s->measurement[at->measured[i]] - head[i];
    refused |= fabs(e[i]) > s->gate[at->measured[i]];
  }
  if (refused) return REFUSED;
  product(XB, NM, c->correct, e, g->xp, g->x);
  product(GB, NM, c->innovate, e, g->base, g->now);
  const double *now = (const double *)g->now, *output = now + NM, *free = now + LANES * HB;
  const double *offset = now + LANES * (HB + FB);
  double *error = (double *)g->error;
  double miss[NY];
  for (int j = 0; j < NY; j++) miss[j] = output[j] - s->preview[at->output[j]];
  for (int i = 0; i < HORIZON; i++)
    for (int j = 0; j < NY; j++) {
      const int k = i * NY + j;
      error[k] = s->preview[(i + 1) * OUTPUTS + at->output[j]] + s->decay[i] * miss[j] - free[k];
    }
  product(ZB, NF, c->gradient, error, NULL, g->q);
  product(ZB, NF, c->whitened, error, NULL, g->v);
  double *l = (double *)g->l, *u = (double *)g->u;
  int crossed = 0;
  for (int i = 0; i < NR; i++) {
    l[i] = s->lower[at->row[i]] - offset[i];
    u[i] = s->upper[at->row[i]] - offset[i];
    crossed |= !(u[i] - l[i] >= 0); /* NaN too, and two infinities of one sign */
  }
  return crossed || !isfinite(total(ZB, g->q)) || !isfinite(total(XB, g->x));
}

INLINE int NAME(answer)(struct NAME(group) *g, int64_t *iterations) {
  g->active = NAME(solve)(&g->solver, g->constants, g->v, g->l, g->u, g->decision, g->row,
                          g->price, iterations);
  return g->active < 0;
}

/* Check the answer against the optimality conditions, in the QP's own units and in scaled ones;
   see qpmpc/residuals.py. */
static void NAME(conclude)(struct NAME(group) *g, const struct shared *s, struct findings *f) {
  const struct NAME(constants) *c = g->constants;
  const struct NAME(maps) *at = g->maps;
  const double *z = (const double *)g->decision;
  block gradient[ZB], residual[ZB];
  product(ZB, NZ, c->hessian, z, g->q, gradient);
  block dot = {0};
  for (int b = 0; b < ZB; b++) dot += g->decision[b] * gradient[b];
  double gap = total(1, &dot), primal = 0, worst = 0, odd = 0;
#if NR > 0
  block rows[RB];
  double *slack = (double *)g->slack;
  const double *Ax = (const double *)rows, *l = (const double *)g->l, *u = (const double *)g->u;
  const double *E = (const double *)c->row_scale;
  product(RB, NZ, c->rows, z, NULL, rows);
#if SOFT
  const double *linear = (const double *)c->linear, *curve = (const double *)c->quadratic;
  const double *linear_scaled = (const double *)c->linear_scaled;
  const double *curve_scaled = (const double *)c->quadratic_scaled;
  const double *hard = (const double *)c->hard; /* 1 or 0 */
  double owed[NR]; /* what a soft row should pay and does not, or how far it gives way unpaid */
  for (int i = 0; i < NR; i++) {
    const double give = larger(larger(Ax[i] - u[i], l[i] - Ax[i]), 0.0), far = E[i] * give;
    slack[i] = give;
    primal = larger(primal, hard[i] * give);
    odd = larger(odd, hard[i] * far);
    gap += (linear[i] + curve[i] * give) * give;
    owed[i] = (1.0 - hard[i]) * smaller(linear_scaled[i] + 2.0 * curve_scaled[i] * far, far);
  }
#else
  for (int i = 0; i < NR; i++) {
    slack[i] = larger(larger(Ax[i] - u[i], l[i] - Ax[i]), 0.0);
    primal = larger(primal, slack[i]);
    odd = larger(odd, E[i] * slack[i]);
  }
#endif
  for (int k = 0; k < g->active; k++) {
    const int i = g->row[k];
    const double price = g->price[k], y = price * E[i] * c->multiplier[0];
    const block *a = c->rows_across + (size_t)i * ZB;
    for (int b = 0; b < ZB; b++) gradient[b] += a[b] * y;
    if (y != 0) gap += y * (y > 0 ? u[i] : l[i]);
    const double above = E[i] * (u[i] - Ax[i]), below = E[i] * (Ax[i] - l[i]);
    worst = larger(worst, larger(smaller(above, price), smaller(below, -price)));
#if SOFT
    if (hard[i] == 0) {
      const double far = E[i] * slack[i];
      const double left = linear_scaled[i] + 2.0 * curve_scaled[i] * far - fabs(price);
      owed[i] = larger(-left, smaller(left, far));
      const double excess = larger(fabs(y) - linear[i], 0.0);
      if (curve[i] > 0) gap += excess * excess / (4.0 * curve[i]);
    }
#endif
  }
#if SOFT
  for (int i = 0; i < NR; i++) worst = larger(worst, owed[i]);
#endif
#endif
  product(ZB, NZ, c->scaled_gradient, (const double *)gradient, NULL, residual);
  const double *raw = (const double *)gradient, *scaled = (const double *)residual;
  double dual = 0, steep = 0;
  for (int i = 0; i < NZ; i++) {
    dual = larger(dual, fabs(raw[i]));
    steep = larger(steep, fabs(scaled[i]));
  }
  f->primal = larger(f->primal, primal);
  f->dual = larger(f->dual, dual);
  f->gap += gap;
  f->infeasible = larger(f->infeasible, odd);
  f->steep = larger(f->steep, steep);
  f->unpaid = larger(f->unpaid, worst);
  f->lost |= !isfinite(total(ZB, gradient) + gap); /* comparisons lose what is not a number */
  product(FB, NZ, c->theta, z, g->now + HB, g->predicted);
  for (int i = 0; i < NU; i++) {
    const int k = at->input[i];
    const double wished = INCREMENT ? g->up[i] + z[i] : z[i];
    const double low = smaller(larger(s->low[k], g->up[i] + s->fall[k]), s->high[k]);
    const double high = larger(smaller(s->high[k], g->up[i] + s->rise[k]), s->low[k]);
    const double given = smaller(larger(wished, low), high);
    if (fabs(given - wished) > CLIP_TOLERANCE * smaller(high - low, 1e12)) f->clipped = 1;
    g->command[i] = given;
  }
}

#if !HEEDED
/* How large gradient and rows are, for residuals relative to them. */
static void NAME(size)(const struct NAME(group) *g, struct findings *f) {
  const double *v = (const double *)g->v;
  for (int i = 0; i < NZ; i++) f->level = larger(f->level, fabs(v[i]));
#if NR > 0
  block rows[RB];
  const double *Ax = (const double *)rows, *E = (const double *)g->constants->row_scale;
  product(RB, NZ, g->constants->rows, (const double *)g->decision, NULL, rows);
  for (int i = 0; i < NR; i++) f->reach = larger(f->reach, fabs(E[i] * Ax[i]));
#endif
}

/* What soft rows give way unpaid, both in proportion to those sizes. */
static void NAME(relate)(const struct NAME(group) *g, struct findings *f) {
#if SOFT
  const struct NAME(constants) *c = g->constants;
  const double *slack = (const double *)g->slack, *E = (const double *)c->row_scale;
  const double *linear = (const double *)c->linear_scaled;
  const double *curve = (const double *)c->quadratic_scaled, *hard = (const double *)c->hard;
  for (int i = 0; i < NR; i++) {
    const double far = E[i] * slack[i], owed = (linear[i] + 2.0 * curve[i] * far) / f->level;
    f->unpaid = larger(f->unpaid, (1.0 - hard[i]) * smaller(owed, far / f->reach));
  }
#else
  (void)g, (void)f;
#endif
}
#endif

static void NAME(commit)(const struct NAME(group) *g, const struct shared *s) {
  const struct NAME(maps) *at = g->maps;
  const double *x = (const double *)g->x, *free = (const double *)(g->now + HB);
  const double *q = (const double *)g->q, *z = (const double *)g->decision;
  const double *l = (const double *)g->l, *u = (const double *)g->u;
  const double *slack = (const double *)g->slack, *predicted = (const double *)g->predicted;
  for (int i = 0; i < NX; i++) s->state[at->state[i]] = x[i];
  for (int i = 0; i < HORIZON; i++)
    for (int j = 0; j < NY; j++) {
      const int k = i * OUTPUTS + at->output[j];
      s->free[k] = free[i * NY + j];
      s->values[AT_PREDICTED + k] = predicted[i * NY + j];
    }
  for (int j = 0; j < NU; j++) {
    const int to = at->input[j];
    double planned = INCREMENT ? g->up[j] : 0.0;
    for (int i = 0; i < MOVES; i++) {
      const int k = i * INPUTS + to;
      const double move = z[i * NU + j];
      s->q[k] = q[i * NU + j];
      s->values[AT_DECISION + k] = move;
      planned = INCREMENT ? planned + move : move;
      s->plan[k] = planned;
    }
    s->command[to] = s->values[AT_COMMAND + to] = g->command[j];
  }
  for (int i = 0; i < NR; i++) {
    const int k = at->row[i];
    s->l[k] = l[i];
    s->u[k] = u[i];
    s->values[AT_VIOLATION + k] = slack[i];
  }
}
