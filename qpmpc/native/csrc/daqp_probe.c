/* Whether the library lays its memory out as daqp_abi.h says: let it fill a workspace, and look. */

#define PROBE_MARK 0xA5

static int marked(const void *at, size_t size) {
  const unsigned char *byte = at;
  for (size_t i = 0; i < size; i++)
    if (byte[i] != PROBE_MARK) return 0;
  return 1;
}

/* Return 0, or the number of the first thing that is not as it should be. */
int probe(void *const *call) {
  static union {
    struct daqp_workspace work;
    unsigned char bytes[4096];
  } memory;
  struct daqp_workspace *w = &memory.work;
  memset(&memory, PROBE_MARK, sizeof memory);
  w->settings = NULL;
  ((daqp_call)call[CALL_SETTINGS])(w);
  const struct daqp_settings *o = w->settings;
  if (o == NULL || marked(&w->settings, sizeof w->settings)) return 1;
  if (!marked(&memory, offsetof(struct daqp_workspace, settings)) || !marked(&w->bnb, 512)) return 2;
  if (o->primal_tol != 1e-6 || o->dual_tol != 1e-12 || o->zero_tol != 1e-11 ||
      o->pivot_tol != 1e-8 || o->progress_tol != 1e-14 || o->cycle_tol != 10 ||
      o->iter_limit != 10000 || o->fval_bound != 1e30 || o->eps_prox != -1e-6 ||
      o->eta_prox != -1.0 || o->rho_soft != 1e-6 || o->rel_subopt != 0 || o->abs_subopt != 0 ||
      o->sing_tol != 3.7e-11 || o->refactor_tol != 1e-9 || o->time_limit != 0 || o->w_soft != 0 ||
      o->eq_reduction != 0 || o->presolve != 1)
    return 3;
  ((daqp_workspace_call)call[CALL_WORKSPACE])(w, 3, 2);
  if (w->n != 3 || w->Rinv || w->RinvD || w->v || w->scaling || w->Mu || w->x != w->u ||
      w->sing_ind != DAQP_NONE || w->n_active != 0 || w->reuse_ind != 0 || w->n_prox != 0 ||
      w->state != 0 || w->soft_slack != 0 || w->rho_ls || w->rho_us || w->w_ls || w->w_us ||
      w->bnb || w->outer_iter != 1 || w->hierarchy || w->avi || w->eq || w->timer)
    return 4;
  if (w->u == NULL || marked(&w->u, sizeof w->u) || marked(&w->prox_mask, sizeof w->prox_mask))
    return 5;
  for (int i = 0; i < 3; i++)
    if (w->u[i] != 0 || w->prox_mask[i] != 0) return 5;
  if (!marked(&w->m, 2 * sizeof(int)) || !marked(&w->M, 3 * sizeof(void *)) ||
      !marked(&w->sense, sizeof(void *)) || !marked(&w->fval, sizeof(double)) ||
      !marked(&w->iterations, sizeof(int)) ||
      !marked(memory.bytes + sizeof(struct daqp_workspace), 512))
    return 6;
  double *const vectors[] = {w->lam, w->lam_star, w->D, w->xldl, w->zldl, w->L, w->xold};
  for (int i = 0; i < 7; i++)
    if (vectors[i] == NULL || marked(&vectors[i], sizeof(void *))) return 7;
  if (w->WS == NULL || marked(&w->WS, sizeof(void *))) return 7;
  w->m = 5;
  w->ms = 0;
  ((daqp_problem_call)call[CALL_PROBLEM])(w, 3, 5, 0, 0, 0);
  double *const rows[] = {w->scaling, w->M, w->Mu, w->dupper, w->dlower};
  for (int i = 0; i < 5; i++)
    if (rows[i] == NULL || marked(&rows[i], sizeof(void *))) return 8;
  if (w->sense == NULL || marked(&w->sense, sizeof(void *)) || w->Rinv || w->v) return 8;
  if (((daqp_solve_call)call[CALL_WEIGHTS])(w) != 1 || w->rho_us != w->rho_ls + 5 ||
      w->w_ls != w->rho_ls + 10 || w->w_us != w->rho_ls + 15)
    return 9;
  ((daqp_call)call[CALL_FREE_WORKSPACE])(w);
  ((daqp_call)call[CALL_FREE_PROBLEM])(w);
  return 0;
}
