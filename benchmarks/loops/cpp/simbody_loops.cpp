// Simbody's dynamics with closed loops, in CasADi's contract, and motions by its own integrators, which project.
//
// sbl_load(MECHANISM) comes first. A point that two bodies share is Simbody's ball constraint; an axis a ball and two
// right angles; a frame a weld; a rod its rod. Joints are pins and sliders, coordinates are internal: Simbody's
// articulated bodies.
#include <ctime>
#include <fstream>
#include <memory>

#include <Simbody.h>

#include "loops.hpp"

namespace {
using SimTK::Real;
using SimTK::Vec3;

class Laws : public SimTK::Force::Custom::Implementation {
public:
    Laws(std::vector<Law> laws, const std::vector<SimTK::MobilizedBody> &bodies) : laws(std::move(laws)), bodies(bodies) {}
    void calcForce(const SimTK::State &state, SimTK::Vector_<SimTK::SpatialVec> &, SimTK::Vector_<Vec3> &,
                   SimTK::Vector &forces) const override
    {
        for (const Law &law : laws) {
            const SimTK::MobilizedBody &body = bodies[law.joint + 1];
            body.applyOneMobilityForce(state, 0, law(body.getOneQ(state, 0)), forces);
        }
    }
    Real calcPotentialEnergy(const SimTK::State &) const override { return 0; }

private:
    std::vector<Law> laws;
    const std::vector<SimTK::MobilizedBody> &bodies;
};

SimTK::Rotation rotation(const Eigen::Matrix3d &m)
{
    return SimTK::Rotation(SimTK::Mat33(m(0, 0), m(0, 1), m(0, 2), m(1, 0), m(1, 1), m(1, 2), m(2, 0), m(2, 1), m(2, 2)));
}

Vec3 vector(const Eigen::Vector3d &v) { return Vec3(v[0], v[1], v[2]); }

// The rotation that takes the joint's axis of Simbody, z of a pin and x of a slider, to a coordinate axis.
SimTK::Rotation turn(const std::string &joint)
{
    const SimTK::CoordinateAxis axis(joint[1] - 'X');
    return SimTK::Rotation(SimTK::UnitVec3(axis), SimTK::CoordinateAxis(joint[0] == 'R' ? 2 : 0));
}

struct State {
    SimTK::MultibodySystem system;
    SimTK::SimbodyMatterSubsystem matter{system};
    SimTK::GeneralForceSubsystem forces{system};
    SimTK::Force::DiscreteForces given{forces, matter};
    std::vector<SimTK::MobilizedBody> bodies{matter.updGround()};
    std::vector<int> actuated;
    SimTK::State state;

    explicit State(const std::string &path)
    {
        std::ifstream file(path);
        int size = 0;
        Vec3 gravity;
        file >> size >> gravity[0] >> gravity[1] >> gravity[2];
        SimTK::Force::UniformGravity(forces, matter, gravity);
        for (int i = 0; i < size; ++i) add_body(file, i);
        for (const Loop &loop : read_loops(file)) add_loop(loop);
        const std::vector<Law> laws = read_laws(file);
        if (!laws.empty()) SimTK::Force::Custom(forces, new Laws(laws, bodies));
        for (const Spring &spring : read_springs(file)) {
            SimTK::MobilizedBody &first = bodies[spring.bodies[0]], &second = bodies[spring.bodies[1]];
            const Vec3 p = vector(spring.points[0]), q = vector(spring.points[1]);
            SimTK::Force::TwoPointLinearSpring(forces, first, p, second, q, spring.stiffness, spring.slack);
            SimTK::Force::TwoPointLinearDamper(forces, first, p, second, q, spring.damping);
        }
        state = system.realizeTopology();
        system.realizeModel(state);
    }

    void add_body(std::istream &file, int number)
    {
        int parent = 0, is_actuated = 0;
        std::string joint;
        double position[3], axes[9], mass, com[3], I[6];
        file >> parent >> joint >> is_actuated;
        for (double &x : position) file >> x;
        for (double &x : axes) file >> x;
        file >> mass;
        for (double &x : com) file >> x;
        for (double &x : I) file >> x;
        if (!file) throw std::runtime_error("not a mechanism");
        const SimTK::Inertia central(I[0], I[2], I[5], I[1], I[3], I[4]);
        const Vec3 centre(com[0], com[1], com[2]);
        const SimTK::Body::Rigid body(SimTK::MassProperties(mass, centre, central.shiftFromMassCenter(-centre, mass)));
        const SimTK::Rotation axis = turn(joint);
        const SimTK::Rotation frame(SimTK::Mat33(axes[0], axes[1], axes[2], axes[3], axes[4], axes[5], axes[6], axes[7], axes[8]));
        const SimTK::Transform inboard(frame * axis, Vec3(position[0], position[1], position[2])), outboard(axis);
        if (joint[0] == 'R')
            bodies.push_back(SimTK::MobilizedBody::Pin(bodies[parent], inboard, body, outboard));
        else
            bodies.push_back(SimTK::MobilizedBody::Slider(bodies[parent], inboard, body, outboard));
        if (is_actuated) actuated.push_back(number);
    }

    void add_loop(const Loop &loop)
    {
        const End &a = loop.ends[0], &b = loop.ends[1];
        SimTK::MobilizedBody &first = bodies[a.body], &second = bodies[b.body];
        const Vec3 p = vector(a.position), q = vector(b.position);
        if (loop.kind == "frame") {
            SimTK::Constraint::Weld(first, {rotation(a.axes), p}, second, {rotation(b.axes), q});
            return;
        }
        if (loop.kind == "rod") {
            SimTK::Constraint::Rod(first, p, second, q, loop.length);
            return;
        }
        SimTK::Constraint::Ball(first, p, second, q);
        if (loop.kind == "axis")
            for (int k = 0; k < 2; ++k)
                SimTK::Constraint::ConstantAngle(first, SimTK::UnitVec3(vector(a.axes.col(k))), second,
                                                 SimTK::UnitVec3(vector(b.axes.col(2))));
    }

    void set(const double *q, const double *qd)
    {
        for (size_t i = 1; i < bodies.size(); ++i) {
            bodies[i].setOneQ(state, 0, q[i - 1]);
            bodies[i].setOneU(state, 0, qd[i - 1]);
        }
    }
};

std::unique_ptr<State> loaded;

std::unique_ptr<SimTK::Integrator> make_integrator(int kind, const SimTK::System &system)
{
    switch (kind) {
    case 0: return std::make_unique<SimTK::RungeKuttaMersonIntegrator>(system);
    case 1: return std::make_unique<SimTK::RungeKuttaFeldbergIntegrator>(system);
    case 2: return std::make_unique<SimTK::CPodesIntegrator>(system, SimTK::CPodes::BDF);
    default: return std::make_unique<SimTK::RungeKutta3Integrator>(system);
    }
}
} // namespace

extern "C" {
int sbl_load(const char *path)
{
    try {
        loaded = std::make_unique<State>(path);
    } catch (const std::exception &) {
        return 1;
    }
    return 0;
}

int sbl_exp2(const double **arg, double **res, long long *, double *, int)
{
    State &s = *loaded;
    s.set(arg[0], arg[1]);
    for (size_t k = 0; k < s.actuated.size(); ++k)
        s.given.setOneMobilityForce(s.state, s.bodies[s.actuated[k] + 1], SimTK::MobilizerUIndex(0), arg[2][k]);
    s.system.realize(s.state, SimTK::Stage::Acceleration);
    for (size_t i = 1; i < s.bodies.size(); ++i) res[0][i - 1] = s.bodies[i].getOneUDot(s.state, 0);
    return 0;
}

// Integrate from q, qd to the end of a span and write the state there; counts: steps, realizations.
int sbl_simulate(int kind, double accuracy, double tolerance, double span, double *q, double *qd, double *seconds,
                 long long *counts)
{
    try {
        State &s = *loaded;
        s.set(q, qd);
        s.state.setTime(0);
        const auto integrator = make_integrator(kind, s.system);
        integrator->setAccuracy(accuracy);
        integrator->setConstraintTolerance(tolerance);
        integrator->setFinalTime(span);
        const std::clock_t begin = std::clock();
        integrator->initialize(s.state);
        while (integrator->getTime() < span) {
            const auto status = integrator->stepTo(span, span);
            if (status == SimTK::Integrator::EndOfSimulation) break;
        }
        *seconds = double(std::clock() - begin) / CLOCKS_PER_SEC;
        const SimTK::State &end = integrator->getState();
        for (size_t i = 1; i < s.bodies.size(); ++i) {
            q[i - 1] = s.bodies[i].getOneQ(end, 0);
            qd[i - 1] = s.bodies[i].getOneU(end, 0);
        }
        counts[0] = integrator->getNumStepsTaken();
        counts[1] = integrator->getNumRealizations();
    } catch (const std::exception &) {
        return 1;
    }
    return 0;
}
}
