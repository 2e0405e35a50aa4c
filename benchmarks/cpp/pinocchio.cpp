// Pinocchio's algorithms over doubles, in CasADi's contract, so that one loop times them and the kernels alike.
//
// pin_load(MECHANISM) comes first. Inputs and results are dense columns in the order of the generated kernels; the
// arm's passive joints have torque 0. Results in the data of Pinocchio stay there: they are not copied.
// -DMBS_SINES gives it the sine and cosine of csrc/mbs_sincos.h, one angle at a time, which is how it asks for them.
#include <cmath>
#include <memory>

#ifdef MBS_SINES
extern "C" {
#define MBS_SCALAR
#include "mbs_sincos.h"
}
#define sincos(angle, sine, cosine) mbs_sincos(1, &(angle), sine, cosine)
#endif

#include <pinocchio/algorithm/aba-derivatives.hpp>
#include <pinocchio/algorithm/aba.hpp>
#include <pinocchio/algorithm/cholesky.hpp>
#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/rnea-derivatives.hpp>
#include <pinocchio/algorithm/rnea.hpp>

#include "mechanism.hpp"

namespace {
struct State {
    Mechanism mechanism;
    DataOf<double> data;
    Eigen::VectorXd Q;
    explicit State(const std::string &path)
        : mechanism(read_mechanism(path)), data(mechanism.model), Q(Eigen::VectorXd::Zero(mechanism.model.nv))
    {
    }
};

std::unique_ptr<State> state;

typedef Eigen::Map<const Eigen::VectorXd> Given;
typedef Eigen::Map<Eigen::VectorXd> Wanted;
typedef Eigen::Map<Eigen::MatrixXd> WantedMatrix;

Given given(const double *x) { return Given(x, state->mechanism.model.nv); }
Wanted wanted(double *x) { return Wanted(x, state->mechanism.model.nv); }
WantedMatrix wanted_matrix(double *x)
{
    return WantedMatrix(x, state->mechanism.model.nv, state->mechanism.model.nv);
}

// Pinocchio leaves the lower triangle of M and of its inverse to the caller.
template <typename Matrix>
void complete(Matrix &&upper)
{
    upper.template triangularView<Eigen::StrictlyLower>() = upper.transpose().template triangularView<Eigen::StrictlyLower>();
}

const Eigen::VectorXd &torques(const double *u)
{
    for (const int joint : state->mechanism.actuated) state->Q[joint] = *u++;
    return state->Q;
}
} // namespace

extern "C" {
int pin_load(const char *path)
{
    try {
        state = std::make_unique<State>(path);
    } catch (const std::exception &) {
        return 1;
    }
    return 0;
}

#define KERNEL(name) int name(const double **arg, double **res, long long *, double *, int)

KERNEL(pin_impl)
{
    auto &[mechanism, data, Q] = *state;
    wanted(res[0]) = pinocchio::rnea(mechanism.model, data, given(arg[0]), given(arg[1]), given(arg[2])) - torques(arg[3]);
    return 0;
}

KERNEL(pin_semi)
{
    auto &[mechanism, data, Q] = *state;
    pinocchio::crba(mechanism.model, data, given(arg[0]), pinocchio::Convention::LOCAL);
    complete(data.M);
    wanted_matrix(res[0]) = data.M;
    wanted(res[1]) = pinocchio::nonLinearEffects(mechanism.model, data, given(arg[0]), given(arg[1]));
    return 0;
}

KERNEL(pin_exp1)
{
    auto &[mechanism, data, Q] = *state;
    pinocchio::crba(mechanism.model, data, given(arg[0]), pinocchio::Convention::LOCAL);
    pinocchio::cholesky::decompose(mechanism.model, data);
    auto qdd = wanted(res[0]);
    qdd = torques(arg[2]) - pinocchio::nonLinearEffects(mechanism.model, data, given(arg[0]), given(arg[1]));
    pinocchio::cholesky::solve(mechanism.model, data, qdd);
    return 0;
}

KERNEL(pin_exp2)
{
    auto &[mechanism, data, Q] = *state;
    wanted(res[0]) = pinocchio::aba(mechanism.model, data, given(arg[0]), given(arg[1]), torques(arg[2]),
                                    pinocchio::Convention::LOCAL);
    return 0;
}

KERNEL(pin_jac_impl)
{
    auto &[mechanism, data, Q] = *state;
    pinocchio::computeRNEADerivatives(mechanism.model, data, given(arg[0]), given(arg[1]), given(arg[2]),
                                      wanted_matrix(res[0]), wanted_matrix(res[1]), wanted_matrix(res[2]));
    complete(wanted_matrix(res[2]));
    return 0;
}

KERNEL(pin_jac_exp2)
{
    auto &[mechanism, data, Q] = *state;
    pinocchio::computeABADerivatives(mechanism.model, data, given(arg[0]), given(arg[1]), torques(arg[2]),
                                     wanted_matrix(res[0]), wanted_matrix(res[1]), wanted_matrix(res[2]));
    complete(wanted_matrix(res[2]));
    return 0;
}
}
