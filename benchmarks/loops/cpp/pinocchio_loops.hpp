// A mechanism with loops as Pinocchio's model, constraints and data.
//
// A point that two bodies share is Pinocchio's 3-D constraint; an axis that they share is two of these, 1 m apart; a
// frame is its 6-D one.
#ifndef BENCHMARKS_PINOCCHIO_LOOPS_HPP
#define BENCHMARKS_PINOCCHIO_LOOPS_HPP

#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

#include <pinocchio/algorithm/constrained-dynamics.hpp>

#include "../../cpp/mechanism.hpp"
#include "loops.hpp"

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
            if (loop.kind == "rod") throw std::runtime_error("Pinocchio has no distances");
            if (loop.kind == "frame") {
                add(pinocchio::CONTACT_6D, loop, 0);
            } else {
                add(pinocchio::CONTACT_3D, loop, 0);
                if (loop.kind == "axis") add(pinocchio::CONTACT_3D, loop, 1);
            }
        }
        laws = read_laws(file);
        for (const Constraint &constraint : constraints) datas.emplace_back(constraint);
        data = DataOf<double>(mechanism.model);
        pinocchio::initConstraintDynamics(mechanism.model, data, constraints, datas);
    }

    // The forces of the joints' laws, and u of the actuated joints; u may be NULL.
    const Eigen::VectorXd &torques(const double *q, const double *u)
    {
        for (const Law &law : laws) Q[law.joint] = law(q[law.joint]);
        if (u)
            for (const int joint : mechanism.actuated) Q[joint] = *u++;
        return Q;
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

#endif
