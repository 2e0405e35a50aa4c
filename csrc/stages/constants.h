/* Numbers that the solver's parts decide by, and that are no options.
 *
 * Those of the first group depend on the precision; errors and steps are scaled, as the solver sees them. */
#ifndef MBS_STAGES_CONSTANTS_H
#define MBS_STAGES_CONSTANTS_H

#include <float.h>

#ifdef MBS_STAGES_FLOAT
#define MBS_STAGES_EPSILON FLT_EPSILON
#define MBS_STAGES_LARGEST FLT_MAX
#define MBS_STAGES_TOLERANCE 1e-4f /* of the scaled optimality conditions, by default */
#define MBS_STAGES_LOW 1e-5f       /* a barrier parameter to begin with near a solution */
#define MBS_STAGES_REFINED 1.5e-5f /* residual of a step beside its right-hand side */
#define MBS_STAGES_SOFT 4.9e-3f    /* compliance of softened rows, beside the inverse of the curvature */
#define MBS_STAGES_SOFTER 4e-2f    /* the same, where rows that give as little take digits */
#define MBS_STAGES_EXACT 1e-4f     /* compliance, beside the inverse of the curvature, that takes digits */
#define MBS_STAGES_ZERO 3.2e-5f    /* pivots that count as 0, beside the largest entry of their row */
#define MBS_STAGES_GROWTH 300.0f   /* of inner variables with outer ones that may take digits */
#define MBS_STAGES_OVERGROWN 3     /* times as much that takes them anyway */
#define MBS_STAGES_SMALL 1e-2f     /* pivots that stages use only if they must, where digits were lost */
#define MBS_STAGES_SHARP 1e-5f     /* share of the cost that bounds that give, and the barrier, may decide: polished once, */
#define MBS_STAGES_DULL 1e-4f      /* and polished again */
#define MBS_STAGES_FALL 0.1f       /* that both fall by, when a solution is polished, */
#define MBS_STAGES_LITTLE 1e-6f    /* but the barrier no farther than here, */
#define MBS_STAGES_WORTH 1e-4f     /* or than the square of the tolerance over this */
#define MBS_STAGES_SIZABLE 0.1f    /* share of the cost that a solution decides at least: see `is_decided` of finish.c, */
#define MBS_STAGES_DECIDED 0.1f    /* and that a solve goes on for */
#define MBS_STAGES_FINEST 1e-5f    /* tolerance that a solve may go on with */
#define MBS_STAGES_APART 6.4e-6f   /* how far a bound is moved from a variable that reached it */
#else
#define MBS_STAGES_EPSILON DBL_EPSILON
#define MBS_STAGES_LARGEST DBL_MAX
#define MBS_STAGES_TOLERANCE 1e-8
#define MBS_STAGES_LOW 1e-7
#define MBS_STAGES_REFINED 1e-4
#define MBS_STAGES_SOFT 6e-8
#define MBS_STAGES_SOFTER 1e-5
#define MBS_STAGES_EXACT 1e-10
#define MBS_STAGES_ZERO 1.5e-8
#define MBS_STAGES_GROWTH 5e4
#define MBS_STAGES_OVERGROWN 40
#define MBS_STAGES_SMALL 1e-4
#define MBS_STAGES_SHARP 1e-12
#define MBS_STAGES_DULL 1e-8
#define MBS_STAGES_LITTLE 1e-12
#define MBS_STAGES_WORTH 1e-4
#define MBS_STAGES_FALL 1e-3
#define MBS_STAGES_SIZABLE 1e-4
#define MBS_STAGES_DECIDED 1e-6
#define MBS_STAGES_FINEST 1e-12
#define MBS_STAGES_APART 1.8189894035458565e-12
#endif
#define MBS_STAGES_INFINITE ((real)1e19)
#define MBS_STAGES_ENTRIES 64 /* of a filter */

/* the barrier parameter: see `is_followed` of iterate.c */
#define CONVEX_FACTOR ((real)3)     /* where a step needed no curvature, larger errors lower it, by this factor */
#define FOLLOWED_FROM ((real)0.8)   /* a step of this length followed the barrier problem, */
#define FOLLOWED_BELOW ((real)3e-2) /* of a barrier parameter as small as this, */
#define FOLLOWED_WITHIN ((real)100) /* with errors of as many times the parameter, */
#define FOLLOWED_ANYHOW ((real)1e-2) /* or with any errors from here on */
#define WARM_STEP ((real)0.5)       /* the first step of a warm start that is near its solution, at least */
#define WARM_BARRIER ((real)2e-4)   /* the most that a warm start needs for its violation: larger ones leave the plan */
#define WARM_REST ((real)1e-2)      /* of the square of a violation: a step leaves as much of it */

/* steps, and their corrections */
#define FREE_COMPLIANCE ((real)1e20)  /* of an elastic variable without curvature */
#define MANY_REFINEMENTS 2            /* show a loss of digits */
#define MOST_UNHELPED 3               /* steps that have no digits whether rows give or not, before that is given up */
#define PIVOT_ROUNDING (1000 * MBS_STAGES_EPSILON) /* of a pivot beside its diagonal: as small, it shows no lack of curvature */
#define SUM_ROUNDING (100 * MBS_STAGES_EPSILON) /* of sums of products with a solution's numbers */
#define REFINED_SHARE ((real)1e-2)    /* of the tolerance, that no step needs to be refined to */
#define CORRECTED_BELOW ((real)1e-2)  /* the barrier parameter, at most, for corrections of products, */
#define CORRECTED_SHORT ((real)0.9)   /* and the length of the step, */
#define CORRECTION_GAIN ((real)0.1)   /* that a correction must lengthen by as much */
#define PRODUCT_LEAST ((real)0.1)     /* products beside mu that are good enough: from here */
#define PRODUCT_MOST ((real)10)       /* to here; and the most that is corrected */
#define POLISHING_STEPS 4             /* of Newton's method, in each of */
#define POLISHING_GAIN ((real)0.1)    /* that a further step must lower the errors to */
#define POLISHING_TRIES 6             /* falls of bounds that give and of the barrier, */
#define POLISHED_RIGHT ((real)0.1)    /* of the undecided cost: a change may differ as much from the one by multipliers, */
#define POLISHED_COST ((real)1e-2)    /* for a cost of this size at least */

/* scales */
#define SMALL_UNIT ((real)1e-3) /* of variables: rows may be flat for it */

/* the line search */
#define CUT_LENGTH ((real)0.02)       /* step lengths that show too little curvature, */
#define CUT_OFTEN 2                   /* as many of them in a row */
#define FOLLOWING_CORRECTIONS 8       /* of inner variables, at most, */
#define FOLLOWING_GAIN ((real)0.99)   /* of the violation, by each of them */
#define BOLD_GAIN ((real)0.5)         /* that a whole step must lower all errors to, where the filter refuses it */
#define RESTRAINED_AFTER 4            /* steps in a row that the search cut to CUT_LENGTH of the longest: curvature is added, */
#define RESTRAINT_RISE 8              /* more after each further one, */
#define RESTRAINT_FALL 3              /* less after each other one, */
#define RESTRAINT_LEAST ((real)1e-12) /* and none below this */
#define TINY_STEP (10 * MBS_STAGES_EPSILON)
#define TINY_VIOLATION ((real)1e-4)   /* with which a tiny step is taken as it is */
#define MOST_REFUSALS 5               /* of first trials by the filter alone, in a row, before it starts anew, */
#define MOST_RESETS 5                 /* which it does as often */

/* ends */
#define SHARPER ((real)1e-4)          /* of the tolerance: what a solve goes on with, */
#define FAR_BELOW ((real)1e-2)        /* until small changes lower the cost by this part of its undecided share */
#define ROUNDED ((real)1e-4)          /* of the acceptable tolerance: rows that may be rounding alone, */
#define MOST_ROUNDED 3                /* at as many iterates in a row, */
#define ROUNDED_GAIN ((real)0.1)      /* of which none lowers them to this part */
#define LEAST_FROM ((real)1e-2)       /* barrier parameters that a least violation is believed at, */
#define LEAST_BEYOND ((real)1000)     /* and how much larger than the parameter it must be */
#define MOST_FORGIVEN ((real)100)     /* that errors are scaled by: multipliers that diverge are no solution */
#define ROW_ROUNDING ((real)5000)     /* units of rounding in the residual of a row that is scaled */

/* control in real time */
#define REALTIME_BARRIER ((real)1e-4)
#define HOPELESS_VIOLATION ((real)10) /* beside the first plan: steps come back from 1.5 times its size */
#define CENTRAL_RATIO ((real)100)     /* of distance z and mu, either way, at most, that a step begins with */

/* pivots, and orders of elimination */
#define PIVOT_SHARE ((real)0.01)      /* of a pivot in its row, at least, when an order is chosen */
#define PIVOT_LOSS ((real)1e9)        /* how much larger the rest of its row may become later; h^2 is a pivot */
#define CLEAR_PIVOT ((real)0.25)      /* share of a pivot in its row that needs no better one */
#define BALANCING_PASSES 3
#define BALANCING_SMALL ((real)1e-5)  /* entries beside the largest that rows are not balanced by */
#define FULL_BLOCK ((real)0.95)       /* nonzeros of a block that is taken as full */
#define FAILING_SHARE 4               /* an order that fails in one of as many stages is given up */
#define ORDER_TRIES 3
#define FILL 4                        /* nonzeros that factors may have for one of the inner equations */
#define SPARE 8 /* inner variables that the recursion has room for, where inner equations do not determine them */

#endif
