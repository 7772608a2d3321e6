/* The whole step: all groups, in the order of the interpreted path. The generator writes before it
   `struct memory` with one member for each group, and EACH(action), which names them all. */

size_t memory_size(void) { return sizeof(struct memory); }
int values_size(void) { return VALUES; }

void begin(struct memory *m, void *const *pointers, void *const *constants, void *const *maps,
           void *const *functions, double iterations) {
  memset(m, 0, sizeof *m);
  memcpy(&m->shared, pointers, sizeof m->shared);
#define BEGIN(kind, i)                          \
  m->group_##i.constants = constants[i];        \
  m->group_##i.maps = maps[i];                  \
  start_##kind(&m->group_##i.solver, m->group_##i.constants, functions, iterations);
  EACH(BEGIN)
}

void forget(struct memory *m) {
#define FORGET(kind, i) forget_##kind(&m->group_##i.solver, m->group_##i.constants);
  EACH(FORGET)
}

void prepare(struct memory *m) {
  if (*m->shared.prepared) return;
#define PREPARE(kind, i) prepare_##kind(&m->group_##i, &m->shared, 1);
  EACH(PREPARE)
  *m->shared.prepared = 1;
}

int step(struct memory *m) {
  const struct shared *s = &m->shared;
  const double began = seconds();
  struct findings found = {0};
  double measured = 0;
  int odd = 0, failed = 0;
  prepare(m);
#define FRESHEN(kind, i) \
  if (!fresh_##kind(&m->group_##i, s)) prepare_##kind(&m->group_##i, s, 0);
  EACH(FRESHEN)
  for (int i = 0; i < MEASURED; i++) measured += s->measurement[i];
  if (!isfinite(measured)) return NOT_MEASURED;
  if (!*s->settled) return NOT_STEADY;
#define UPDATE(kind, i) odd |= update_##kind(&m->group_##i, s);
  EACH(UPDATE)
  if (odd & REFUSED) return NOT_STEADY;
  if (odd) return NOT_FINITE;
  const double updated = seconds();
#define SOLVE(kind, i) failed |= answer_##kind(&m->group_##i, &found.iterations);
  EACH(SOLVE)
  if (failed) return HANDED_OVER;
  const double solved = seconds();
#define CONCLUDE(kind, i) conclude_##kind(&m->group_##i, s, &found);
  EACH(CONCLUDE)
  if (found.lost) return NOT_CHECKED;
  double scaled = larger(larger(found.infeasible, found.steep), found.unpaid);
#if HEEDED
  if (!(scaled <= TOLERANCE)) return NOT_CHECKED;
#else
  if (scaled > TOLERANCE) { /* relative to the size of the problem, as qpmpc/residuals.py has it */
#define SIZE(kind, i) size_##kind(&m->group_##i, &found);
    EACH(SIZE)
    found.level += 1.0;
    found.reach += 1.0;
    const double both = larger(found.level, found.reach);
    if (found.unpaid > TOLERANCE) {
      found.unpaid = 0;
#define RELATE(kind, i) relate_##kind(&m->group_##i, &found);
      EACH(RELATE)
      found.unpaid *= both;
    }
    scaled = larger(found.infeasible, larger(found.steep, found.unpaid));
    if (scaled > TOLERANCE)
      scaled = larger(found.infeasible / found.reach,
                      larger(found.steep / found.level, found.unpaid / both));
  }
#endif
  if (isfinite(*s->remaining) && !(seconds() - began <= *s->remaining)) return TOO_LATE;
#define COMMIT(kind, i) commit_##kind(&m->group_##i, s);
  EACH(COMMIT)
  for (int i = 0; i < MEASURED; i++) s->missing[i] = 0;
  *s->cursor = 1;
  *s->prepared = 0;
  *s->counts = found.iterations;
  s->values[AT_RESIDUALS] = found.primal;
  s->values[AT_RESIDUALS + 1] = found.dual;
  s->values[AT_RESIDUALS + 2] = fabs(found.gap);
  s->values[AT_RESIDUALS + 3] = scaled;
  s->values[AT_TIMES] = updated - began;
  s->values[AT_TIMES + 1] = solved - updated;
  return found.clipped ? CLIPPED : DECIDED;
}
