// Motions of a mechanism by Pinocchio's accelerations and DOP853, without projection; of trees by articulated bodies.
//
// Pinocchio brings no integrator; this is what its users write around it.
#include <ctime>
#include <memory>

#include <pinocchio/algorithm/aba.hpp>
#include <pinocchio/algorithm/constrained-dynamics.hpp>

#include "pinocchio_loops.hpp"
#include "runge_kutta.hpp"

extern "C" int pinm_simulate(const char *path, double mu, double accuracy, int iterations, int stages, const double *A,
                             const double *b, const double *e3, const double *e5, double span, double tolerance,
                             double *q, double *qd, double *seconds, long long *calls)
{
    try {
        State state(path, mu, accuracy, iterations);
        const int n = state.mechanism.model.nv;
        Eigen::VectorXd y(2 * n), position(n), velocity(n);
        for (int i = 0; i < n; ++i) y[i] = q[i], y[n + i] = qd[i];
        const auto accelerate = [&](const Eigen::VectorXd &x, Eigen::Ref<Eigen::VectorXd> rate) {
            position = x.head(n);
            velocity = x.tail(n);
            rate.head(n) = velocity;
            const Eigen::VectorXd &Q = state.torques(position.data(), nullptr);
            if (state.constraints.empty())
                rate.tail(n) = pinocchio::aba(state.mechanism.model, state.data, position, velocity, Q,
                                              pinocchio::Convention::LOCAL);
            else
                rate.tail(n) = pinocchio::constraintDynamics(state.mechanism.model, state.data, position, velocity, Q,
                                                             state.constraints, state.datas, state.settings);
        };
        const std::clock_t begin = std::clock();
        *calls = integrate({stages, A, b, e3, e5}, accelerate, span, tolerance, y);
        *seconds = double(std::clock() - begin) / CLOCKS_PER_SEC;
        for (int i = 0; i < n; ++i) q[i] = y[i], qd[i] = y[n + i];
    } catch (const std::exception &) {
        return 1;
    }
    return *calls < 0;
}
