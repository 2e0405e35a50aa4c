/* The functions that IPOPT calls to solve its linear systems.
 *
 * IPOPT loads linear solvers from a library of the user's choice (option `hsllib`), by the names of solvers that it
 * knows. These functions have the names of `ma97`, whose interface passes the state of an analysis and a factorisation.
 * mbs_plan.h and mbs_ldl.h do the work, and contain nothing of HSL. They share no state, so threads may call them at
 * once.
 *
 * The structures have the layout of version 2.8 of that interface, which IPOPT 3.14.11 to 3.14.19 use. A caller must
 * check IPOPT's version before it loads these functions: of a structure with another layout they would read and write
 * the wrong numbers. */
#ifndef MBS_IPOPT_H
#define MBS_IPOPT_H

typedef struct {
    int one_based, keep_on, least_front;
    double spare_room;
    int ordering, print_level, scaling;
    double zero, threshold;
    int diagnostics, errors, warnings;
    long parallel_from;
    int blas3;
    long parallel_solve_from;
    int multifrontal_solve;
    double consistency;
    int spare[5];
    double spare_numbers[10];
} ipopt_settings;

typedef struct {
    int flag, flag68, flag77, duplicates, rank, outside, no_diagonal, depth, front, delayed;
    long entries, products;
    int negative, fronts, pairs, ordering, status, widest;
    int spare[4];
    double spare_numbers[10];
} ipopt_report;

void ma97_default_control_d(ipopt_settings *settings);

/* Keep the pattern of a system of n unknowns, in `*kept`: by columns, the lower triangle or the upper one, each entry
 * once. It is ordered when it is factorised, since then it is known which diagonal entries are pivots. */
void ma97_analyse_d(int check, int n, const int *start, const int *row, const double *value, void **kept,
                    const ipopt_settings *settings, ipopt_report *report, int *order);

/* Factorise; `report->flag` is -7 for a singular system, and else negative if that failed. */
void ma97_factor_d(int type, const int *start, const int *row, const double *value, void **pattern_kept,
                   void **factors_kept, const ipopt_settings *settings, ipopt_report *report, double *scale);

/* Solve for `count` right-hand sides, `stride` apart, in place. */
void ma97_solve_d(int job, int count, double *x, int stride, void **pattern_kept, void **factors_kept,
                  const ipopt_settings *settings, ipopt_report *report);
void ma97_factor_solve_d(int type, const int *start, const int *row, const double *value, int count, double *x,
                         int stride, void **pattern_kept, void **factors_kept, const ipopt_settings *settings,
                         ipopt_report *report, double *scale);

/* Free what was kept. */
void ma97_free_akeep_d(void **kept);
void ma97_free_fkeep_d(void **kept);
void ma97_finalise_d(void **pattern_kept, void **factors_kept);

#endif
