/* The unconstrained minimiser: one product. Rows are not looked at. */

struct NAME(solver) {
  char nothing;
};

static void NAME(start)(struct NAME(solver) *d, const struct NAME(constants) *c,
                        void *const *functions, double iterations) {
  (void)d, (void)c, (void)functions, (void)iterations;
}

static void NAME(forget)(struct NAME(solver) *d, const struct NAME(constants) *c) {
  (void)d, (void)c;
}

static int NAME(solve)(struct NAME(solver) *d, const struct NAME(constants) *c, const block *v,
                       const block *l, const block *u, block *decision, int *row, double *price,
                       int64_t *iterations) {
  (void)d, (void)l, (void)u, (void)row, (void)price, (void)iterations;
  product(ZB, NZ, c->closed, (const double *)v, NULL, decision);
  return 0;
}
