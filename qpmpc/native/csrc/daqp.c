/* DAQP's core on whitened variables, where the QP is a least-distance problem: minimise |x|^2 / 2
   within dlower <= M x <= dupper, x = z + v. Rows are normalised, as DAQP does itself. The last
   active set is where the next solve begins. The generator brings NS, the number of soft rows, and
   CORRECTS, whether DAQP was told of more curvature than the problem has. */

#define NMAX (NZ + NS + 1)

struct NAME(solver) {
  daqp_solve_call ldp;
  daqp_call refine, refresh;
  struct daqp_workspace work;
  struct daqp_settings settings;
  double upper[SOME(PADDED(NR))], lower[SOME(PADDED(NR))], product[SOME(NR)];
  double give[SOME(NR)], weight[SOME(NR)];
  double lam[NMAX], lam_star[NMAX], D[NMAX], xldl[NMAX], zldl[NMAX], x[NZ], old[NZ];
  double L[NMAX * (NMAX + 1) / 2];
  int set[NMAX], sense[SOME(NR)], proximal[NZ];
};

/* Begin the next solve from nothing. */
static void NAME(forget)(struct NAME(solver) *d, const struct NAME(constants) *c) {
  struct daqp_workspace *w = &d->work;
  for (int i = 0; i < NR; i++) d->sense[i] = c->sense[i];
  w->sing_ind = DAQP_NONE;
  w->n_active = w->reuse_ind = 0;
}

static void NAME(start)(struct NAME(solver) *d, const struct NAME(constants) *c,
                        void *const *functions, double iterations) {
  struct daqp_workspace *w = &d->work;
  d->ldp = (daqp_solve_call)functions[CALL_LDP];
  d->refine = (daqp_call)functions[CALL_REFINE];
  d->refresh = (daqp_call)functions[CALL_REFRESH];
  d->settings = (struct daqp_settings){
      .primal_tol = PRIMAL_TOL, .dual_tol = 1e-12, .zero_tol = 1e-11, .pivot_tol = 1e-8,
      .progress_tol = 1e-14, .cycle_tol = 10, .iter_limit = (int)iterations,
      .fval_bound = DAQP_FAR, .eps_prox = -1e-6, .eta_prox = -1.0, .rho_soft = 1e-6,
      .sing_tol = 3.7e-11, .refactor_tol = 1e-9};
  for (int i = 0; i < NR; i++) d->give[i] = c->give[i], d->weight[i] = c->weight[i];
  *w = (struct daqp_workspace){
      .n = NZ, .m = NR, .ms = 0, .M = (double *)c->normal_rows, .dupper = d->upper,
      .dlower = d->lower, .sense = d->sense, .scaling = (double *)c->normal, .x = d->x,
      .xold = d->old, .lam = d->lam, .lam_star = d->lam_star, .u = d->x, .L = d->L, .D = d->D,
      .xldl = d->xldl, .zldl = d->zldl, .WS = d->set, .sing_ind = DAQP_NONE,
      .prox_mask = d->proximal, .settings = &d->settings, .outer_iter = 1, .Mu = d->product};
#if NS > 0
  w->rho_ls = w->rho_us = d->give;
  w->w_ls = w->w_us = d->weight;
#endif
  NAME(forget)(d, c);
}

/* Whether rounding shows: an active row that is not where its multiplier says it is. */
static int NAME(coarse)(const struct daqp_workspace *w, const struct NAME(constants) *c) {
  int found = 0;
  for (int k = 0; k < w->n_active; k++) {
    const int i = w->WS[k];
    const double *row = c->normal_rows + (size_t)i * NZ;
    double value = w->sense[i] & DAQP_LOWER ? -w->dlower[i] : -w->dupper[i];
    if ((w->sense[i] & (DAQP_SOFT | DAQP_SLACK_FIXED)) == DAQP_SOFT) continue;
    for (int j = 0; j < NZ; j++) value += row[j] * w->u[j];
    found |= fabs(value) > ROUNDING;
  }
  return found;
}

/* Whether any soft row gives way, however little. */
static int NAME(gives)(const struct daqp_workspace *w) {
  int found = 0;
  for (int k = 0; k < w->n_active; k++)
    found |= (w->sense[w->WS[k]] & (DAQP_SOFT | DAQP_SLACK_FIXED)) == DAQP_SOFT;
  return found;
}

/* Solve again with the curvature that is not in the problem around the slack there is: its price
   is taken off the linear penalty, so that both together are the true penalty where the rows stand
   (a proximal point). The active set stays: this costs one step. */
static int NAME(correct)(struct NAME(solver) *d, const struct NAME(constants) *c,
                         int64_t *iterations) {
  struct daqp_workspace *w = &d->work;
  for (int k = 0; k < w->n_active; k++) {
    const int i = w->WS[k];
    w->lam[k] = w->lam_star[k];
    if ((w->sense[i] & (DAQP_SOFT | DAQP_SLACK_FIXED)) != DAQP_SOFT) continue;
    const double *row = c->normal_rows + (size_t)i * NZ;
    double value = 0;
    for (int j = 0; j < NZ; j++) value += row[j] * w->u[j];
    const double beyond = larger(value - d->upper[i], d->lower[i] - value) / c->normal[i];
    d->weight[i] -= c->excess[i] * larger(beyond, 0.0);
  }
  w->reuse_ind = 0;
  const int flag = d->ldp(w);
  *iterations += w->iterations;
  return flag;
}

/* Whether a row that may give way stands inside of its bound, and is told not to: within its dual
   tolerance, which the little curvature makes a long way, DAQP leaves such rows where they are. */
static int NAME(retract)(struct NAME(solver) *d, const struct NAME(constants) *c) {
  struct daqp_workspace *w = &d->work;
  int found = 0;
  for (int k = 0; k < w->n_active; k++) {
    const int i = w->WS[k];
    if ((w->sense[i] & (DAQP_SOFT | DAQP_SLACK_FIXED)) != DAQP_SOFT) continue;
    const double *row = c->normal_rows + (size_t)i * NZ;
    double value = 0;
    for (int j = 0; j < NZ; j++) value += row[j] * w->u[j];
    const double inside = w->sense[i] & DAQP_LOWER ? value - d->lower[i] : d->upper[i] - value;
    if (inside > INSIDE) w->sense[i] |= DAQP_SLACK_FIXED, found = 1;
  }
  if (found) d->refresh(w);
  return found;
}

/* Put the penalties back, and in the place of the last dual iterate one that is well inside of what
   the rows' states allow: at a penalty itself DAQP takes the next change of state for rounding. */
static void NAME(restore)(struct NAME(solver) *d, const struct NAME(constants) *c) {
  struct daqp_workspace *w = &d->work;
  for (int i = 0; i < NR; i++) d->weight[i] = c->weight[i];
  for (int k = 0; k < w->n_active; k++) {
    const int i = w->WS[k], state = w->sense[i];
    const double most = c->weight[i] / c->normal[i];
    double price = 1.0;
    if (state & DAQP_SOFT) price = state & DAQP_SLACK_FIXED ? 0.9 * most : most + 1.0;
    w->lam[k] = state & DAQP_LOWER ? -price : price;
  }
}

/* Return how many rows have a multiplier, which and what it is, or -1 without an answer. */
static int NAME(solve)(struct NAME(solver) *d, const struct NAME(constants) *c, const block *v,
                       const block *l, const block *u, block *decision, int *row, double *price,
                       int64_t *iterations) {
  block distance[ZB];
  int active = 0;
  if (d->settings.iter_limit < 2) return -1; /* DAQP's count begins with one */
#if NR > 0
  struct daqp_workspace *w = &d->work;
  block shift[RB];
  const double *least = (const double *)l, *most = (const double *)u;
  const double *scale = (const double *)c->bound_scale, *moved = (const double *)shift;
  product(RB, NZ, c->normal_columns, (const double *)v, NULL, shift);
  int beyond = 0;
  for (int i = 0; i < NR; i++) {
    const double tolerance = PRIMAL_TOL * c->normal[i];
    d->upper[i] = smaller(scale[i] * most[i], DAQP_FAR) + moved[i];
    d->lower[i] = larger(scale[i] * least[i], -DAQP_FAR) + moved[i];
    beyond |= (d->upper[i] < -tolerance) | (d->lower[i] > tolerance);
  }
  if (beyond || w->n_active > 0) {
    w->reuse_ind = 0; /* other right-hand sides: nothing of the last forward substitution holds */
    int flag = d->ldp(w);
    *iterations += w->iterations;
    const int corrected =
        CORRECTS && (flag == DAQP_OPTIMAL || flag == DAQP_GAVE_WAY) && NAME(gives)(w);
    if (corrected) flag = NAME(correct)(d, c, iterations);
    if (corrected && flag > 0 && NAME(retract)(d, c)) {
      flag = d->ldp(w);
      *iterations += w->iterations;
    }
    if (flag != DAQP_OPTIMAL && flag != DAQP_GAVE_WAY) {
      for (int i = 0; i < NR; i++) d->weight[i] = c->weight[i];
      NAME(forget)(d, c);
      return -1;
    }
    active = w->n_active;
    if (NAME(coarse)(w, c)) d->refine(w);
    double *x = (double *)distance;
    for (int i = 0; i < NZ; i++) x[i] = w->u[i];
    for (int i = NZ; i < PADDED(NZ); i++) x[i] = 0;
    for (int k = 0; k < active; k++) {
      row[k] = w->WS[k];
      price[k] = w->lam_star[k] * c->normal[row[k]];
    }
    for (int b = 0; b < ZB; b++) distance[b] -= v[b];
    if (corrected) NAME(restore)(d, c);
  } else
#endif
  {
    *iterations += 1;
    for (int b = 0; b < ZB; b++) distance[b] = -v[b];
  }
  product(ZB, NZ, c->whitening, (const double *)distance, NULL, decision);
  return active;
}
