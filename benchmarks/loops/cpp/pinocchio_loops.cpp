// Pinocchio's dynamics with closed loops over doubles, in CasADi's contract, and motions by explicit Runge-Kutta steps.
//
// pinl_load(MECHANISM, mu, accuracy, iterations) comes first, with the settings of the proximal method. A point that two bodies
// share is Pinocchio's 3-D constraint; an axis that they share is two of these, 1 m apart; a frame is its 6-D one.
#include <fstream>
#include <memory>

#include <pinocchio/algorithm/constrained-dynamics-derivatives.hpp>
#include <pinocchio/algorithm/constrained-dynamics.hpp>

#include "../../cpp/mechanism.hpp"
#include "loops.hpp"

namespace {
typedef pinocchio::RigidConstraintModelTpl<double, 0> Constraint;
typedef pinocchio::RigidConstraintDataTpl<double, 0> ConstraintData;

struct State {
    Mechanism mechanism;
    std::vector<Law> laws;
    std::vector<Constraint> constraints;
    std::vector<ConstraintData> datas;
    DataOf<double> data;
    pinocchio::ProximalSettings settings;
    Eigen::VectorXd Q;
    int rows = 0;

    State(const std::string &path, double mu, double accuracy, int iterations)
        : mechanism(read_mechanism(path)), settings(accuracy, mu, iterations),
          Q(Eigen::VectorXd::Zero(mechanism.model.nv))
    {
        std::ifstream file(path);
        int bodies = 0;
        file >> bodies;
        std::string line;
        for (int k = 0; k <= bodies; ++k) std::getline(file, line);
        for (const Loop &loop : read_loops(file)) {
            if (loop.kind == "frame") {
                add(pinocchio::CONTACT_6D, loop, 0);
            } else {
                add(pinocchio::CONTACT_3D, loop, 0);
                if (loop.kind == "axis") add(pinocchio::CONTACT_3D, loop, 1);
            }
        }
        laws = read_laws(file);
        for (const Constraint &constraint : constraints) {
            datas.emplace_back(constraint);
            rows += constraint.residualSize();
        }
        data = DataOf<double>(mechanism.model);
        pinocchio::initConstraintDynamics(mechanism.model, data, constraints, datas);
    }

    void add(pinocchio::ContactType type, const Loop &loop, double along)
    {
        const auto place = [&](const End &end) {
            return pinocchio::SE3(end.axes, end.position + along * end.axes.col(2));
        };
        constraints.emplace_back(type, mechanism.model, loop.ends[0].body, place(loop.ends[0]), loop.ends[1].body,
                                 place(loop.ends[1]), pinocchio::LOCAL);
    }
};

std::unique_ptr<State> state;

typedef Eigen::Map<const Eigen::VectorXd> Given;
typedef Eigen::Map<Eigen::VectorXd> Wanted;
typedef Eigen::Map<Eigen::MatrixXd> WantedMatrix;

Given given(const double *x) { return Given(x, state->mechanism.model.nv); }

const Eigen::VectorXd &torques(const double *q, const double *u)
{
    for (const Law &law : state->laws) state->Q[law.joint] = law(q[law.joint]);
    if (u)
        for (const int joint : state->mechanism.actuated) state->Q[joint] = *u++;
    return state->Q;
}

const Eigen::VectorXd &accelerate(const double *q, const double *qd, const double *u)
{
    State &s = *state;
    return pinocchio::constraintDynamics(s.mechanism.model, s.data, given(q), given(qd), torques(q, u), s.constraints,
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
