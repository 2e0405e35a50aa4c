// Pinocchio's dynamics with closed loops over doubles, in CasADi's contract.
//
// pinl_load(MECHANISM, mu, accuracy, iterations) comes first, with the settings of the proximal method.
#include <memory>

#include <pinocchio/algorithm/constrained-dynamics-derivatives.hpp>

#include "pinocchio_loops.hpp"

namespace {
std::unique_ptr<State> state;

typedef Eigen::Map<const Eigen::VectorXd> Given;
typedef Eigen::Map<Eigen::VectorXd> Wanted;
typedef Eigen::Map<Eigen::MatrixXd> WantedMatrix;

Given given(const double *x) { return Given(x, state->mechanism.model.nv); }

const Eigen::VectorXd &accelerate(const double *q, const double *qd, const double *u)
{
    State &s = *state;
    return pinocchio::constraintDynamics(s.mechanism.model, s.data, given(q), given(qd), s.torques(q, u), s.constraints,
                                         s.datas, s.settings);
}
} // namespace

extern "C" {
int pinl_load(const char *path, double mu, double accuracy, int iterations)
{
    try {
        state = std::make_unique<State>(path, mu, accuracy, iterations);
    } catch (const std::exception &) {
        return 1;
    }
    return 0;
}

#define KERNEL(name) int name(const double **arg, double **res, long long *, double *, int)

KERNEL(pinl_exp1)
{
    Wanted(res[0], state->mechanism.model.nv) = accelerate(arg[0], arg[1], arg[2]);
    return 0;
}

KERNEL(pinl_jac_exp1)
{
    State &s = *state;
    const int n = s.mechanism.model.nv;
    accelerate(arg[0], arg[1], arg[2]);
    pinocchio::computeConstraintDynamicsDerivatives(s.mechanism.model, s.data, s.constraints, s.datas, s.settings);
    WantedMatrix(res[0], n, n) = s.data.ddq_dq;
    WantedMatrix(res[1], n, n) = s.data.ddq_dv;
    return 0;
}
}
