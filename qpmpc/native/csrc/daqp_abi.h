/* How DAQP 0.11 lays out its memory, as far as a caller has to know: the library that pip installs
   brings no headers. Facts from include/types.h and src/api.c of that release (MIT licence,
   Copyright (c) 2020 Daniel Arnström); `probe` compares them with the library that is there. */

struct daqp_settings {
  double primal_tol, dual_tol, zero_tol, pivot_tol, progress_tol;
  int cycle_tol, iter_limit;
  double fval_bound, eps_prox, eta_prox, rho_soft, rel_subopt, abs_subopt;
  double sing_tol, refactor_tol, time_limit, w_soft;
  int eq_reduction, presolve;
};

struct daqp_workspace {
  void *qp;
  int n, m, ms;
  double *M, *dupper, *dlower, *Rinv, *v;
  int *sense;
  double *scaling, *RinvD;
  double *x, *xold, *lam, *lam_star, *u;
  double fval;
  double *L, *D, *xldl, *zldl;
  int reuse_ind;
  int *WS;
  int n_active, iterations, sing_ind;
  int *prox_mask;
  int n_prox;
  double soft_slack;
  struct daqp_settings *settings;
  void *bnb;
  int outer_iter;
  void *hierarchy, *avi, *eq, *timer;
  double *Mu;
  double *rho_ls, *rho_us, *w_ls, *w_us;
  int state;
};

enum { DAQP_NONE = -1, DAQP_ACTIVE = 1, DAQP_LOWER = 2, DAQP_IGNORED = 4, DAQP_SOFT = 8,
       DAQP_SLACK_FIXED = 32 };
enum { DAQP_OPTIMAL = 1, DAQP_GAVE_WAY = 2 };

/* The functions that are called, in the order of DaqpForm.functions. */
enum { CALL_LDP, CALL_REFINE, CALL_SETTINGS, CALL_WORKSPACE, CALL_PROBLEM, CALL_WEIGHTS,
       CALL_FREE_PROBLEM, CALL_FREE_WORKSPACE, CALL_REFRESH };
typedef int (*daqp_solve_call)(struct daqp_workspace *);
typedef void (*daqp_call)(struct daqp_workspace *);
typedef void (*daqp_workspace_call)(struct daqp_workspace *, int, int);
typedef void (*daqp_problem_call)(struct daqp_workspace *, int, int, int, int, int);
