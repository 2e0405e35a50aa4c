// The rest of a mechanism's text: what closes loops between its bodies, and forces in its joints.
//
// After the bodies of mechanism.hpp: the number of loops; a line for each: its kind (point, axis, frame, rod); twice the
// body (0 is the base), the frame's origin, 3, and its axes as columns, row by row, 9; of a rod its length. Then the
// number of forces; for each the joint, from 0, and six numbers f, k, slack, a, b, rest: f - k (1 - slack / r) (b cos q - a sin q) with
// r = sqrt(rest + 2 (a cos q + b sin q)). Then the number of springs between points of bodies; for each twice the body
// and the point, 3; stiffness, damping and length without force.
#ifndef BENCHMARKS_LOOPS_HPP
#define BENCHMARKS_LOOPS_HPP

#include <cmath>
#include <istream>
#include <string>
#include <vector>

#include <Eigen/Core>

struct End {
    int body;
    Eigen::Vector3d position;
    Eigen::Matrix3d axes;
};

struct Loop {
    std::string kind;
    End ends[2];
    double length; // of a rod
};

struct Law {
    int joint;
    double f, k, slack, a, b, rest;
    double operator()(double q) const
    {
        if (k == 0) return f;
        const double c = std::cos(q), s = std::sin(q);
        return f - k * (1 - slack / std::sqrt(rest + 2 * (a * c + b * s))) * (b * c - a * s);
    }
};

inline std::vector<Loop> read_loops(std::istream &file)
{
    int size = 0;
    file >> size;
    std::vector<Loop> loops(size);
    for (Loop &loop : loops) {
        file >> loop.kind;
        for (End &end : loop.ends) {
            file >> end.body;
            for (int k = 0; k < 3; ++k) file >> end.position[k];
            for (int k = 0; k < 9; ++k) file >> end.axes(k / 3, k % 3);
        }
        loop.length = 0;
        if (loop.kind == "rod") file >> loop.length;
    }
    return loops;
}

struct Spring {
    int bodies[2];
    Eigen::Vector3d points[2];
    double stiffness, damping, slack;
};

inline std::vector<Spring> read_springs(std::istream &file)
{
    int size = 0;
    file >> size;
    std::vector<Spring> springs(size);
    for (Spring &spring : springs) {
        for (int end = 0; end < 2; ++end) {
            file >> spring.bodies[end];
            for (int k = 0; k < 3; ++k) file >> spring.points[end][k];
        }
        file >> spring.stiffness >> spring.damping >> spring.slack;
    }
    return springs;
}

inline std::vector<Law> read_laws(std::istream &file)
{
    int size = 0;
    file >> size;
    std::vector<Law> laws(size);
    for (Law &law : laws) file >> law.joint >> law.f >> law.k >> law.slack >> law.a >> law.b >> law.rest;
    return laws;
}

#endif
