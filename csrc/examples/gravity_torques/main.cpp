// The torques that hold the arm at rest, stretched out at several angles of the shoulder: the residual of its equations
// of motion without velocities and accelerations.
#include <array>
#include <cstdio>
#include <optional>

#include "arm_pendulum.h"

using Joints = std::array<mbs_real, arm_pendulum_impl_NNZ_q>;
using Inputs = std::array<mbs_real, arm_pendulum_impl_NNZ_u>;

static std::optional<Joints> hold(const Joints &q)
{
    const Joints rest{};
    const Inputs none{};
    Joints Phi;
    if (arm_pendulum_compute_impl(q.data(), rest.data(), rest.data(), none.data(), Phi.data()))
        return std::nullopt;
    return Phi;
}

int main()
{
    for (const double angle : {-1.0, -0.5, 0.0, 0.5, 1.0}) {
        const auto torques = hold({0, angle, 0, 0, 0, 0});
        if (!torques)
            return 1;
        std::printf("q2 = %4.1f rad:", angle);
        for (const double torque : *torques)
            std::printf(" %.10g", torque);
        std::printf(" N m\n");
    }
}
