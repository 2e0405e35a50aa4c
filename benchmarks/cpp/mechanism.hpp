// A mechanism as the harness writes it -> Pinocchio's model. One text file feeds every program that links Pinocchio.
//
// The file: the number of bodies; gravity, 3; then a line for each body: its parent (0 is the base), its joint
// (RX RY RZ PX PY PZ), whether it is actuated (0, 1); the joint's point on the parent, 3; the body's axes at q = 0 as
// columns in the parent's frame, row by row, 9; mass; centre of mass, 3; inertia about it: xx xy yy xz yz zz.
#ifndef BENCHMARKS_MECHANISM_HPP
#define BENCHMARKS_MECHANISM_HPP

#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

#include <pinocchio/multibody.hpp>

// The joints of the compared mechanisms alone: Pinocchio's own collection has 25, and takes minutes to compile.
template <typename Scalar_, int Options_>
struct ElementaryJoints {
    typedef Scalar_ Scalar;
    static constexpr int Options = Options_;
    typedef pinocchio::JointModelRevoluteTpl<Scalar, Options, 0> JointModelRX;
    typedef pinocchio::JointModelRevoluteTpl<Scalar, Options, 1> JointModelRY;
    typedef pinocchio::JointModelRevoluteTpl<Scalar, Options, 2> JointModelRZ;
    typedef pinocchio::JointModelPrismaticTpl<Scalar, Options, 0> JointModelPX;
    typedef pinocchio::JointModelPrismaticTpl<Scalar, Options, 1> JointModelPY;
    typedef pinocchio::JointModelPrismaticTpl<Scalar, Options, 2> JointModelPZ;
    typedef boost::variant<JointModelRX, JointModelRY, JointModelRZ, JointModelPX, JointModelPY, JointModelPZ>
        JointModelVariant;
    typedef pinocchio::JointDataRevoluteTpl<Scalar, Options, 0> JointDataRX;
    typedef pinocchio::JointDataRevoluteTpl<Scalar, Options, 1> JointDataRY;
    typedef pinocchio::JointDataRevoluteTpl<Scalar, Options, 2> JointDataRZ;
    typedef pinocchio::JointDataPrismaticTpl<Scalar, Options, 0> JointDataPX;
    typedef pinocchio::JointDataPrismaticTpl<Scalar, Options, 1> JointDataPY;
    typedef pinocchio::JointDataPrismaticTpl<Scalar, Options, 2> JointDataPZ;
    typedef boost::variant<JointDataRX, JointDataRY, JointDataRZ, JointDataPX, JointDataPY, JointDataPZ>
        JointDataVariant;
};

template <typename Scalar>
using ModelOf = pinocchio::ModelTpl<Scalar, 0, ElementaryJoints>;
template <typename Scalar>
using DataOf = pinocchio::DataTpl<Scalar, 0, ElementaryJoints>;

struct Mechanism {
    ModelOf<double> model;
    std::vector<int> actuated; // the joints that are driven, from 0, in the order of u
};

inline pinocchio::JointIndex add_joint(ModelOf<double> &model, pinocchio::JointIndex parent, const std::string &joint,
                                       const pinocchio::SE3 &placement, const std::string &name)
{
    typedef ElementaryJoints<double, 0> Joints;
    if (joint == "RX") return model.addJoint(parent, Joints::JointModelRX(), placement, name);
    if (joint == "RY") return model.addJoint(parent, Joints::JointModelRY(), placement, name);
    if (joint == "RZ") return model.addJoint(parent, Joints::JointModelRZ(), placement, name);
    if (joint == "PX") return model.addJoint(parent, Joints::JointModelPX(), placement, name);
    if (joint == "PY") return model.addJoint(parent, Joints::JointModelPY(), placement, name);
    if (joint == "PZ") return model.addJoint(parent, Joints::JointModelPZ(), placement, name);
    throw std::runtime_error("no such joint: " + joint);
}

inline Mechanism read_mechanism(const std::string &path)
{
    std::ifstream file(path);
    Mechanism mechanism;
    Eigen::Vector3d gravity;
    int bodies = 0;
    file >> bodies >> gravity[0] >> gravity[1] >> gravity[2];
    mechanism.model.gravity.linear() = gravity;
    for (int i = 0; i < bodies; ++i) {
        int parent = 0, actuated = 0;
        double mass = 0, I[6];
        std::string joint;
        Eigen::Vector3d position, com;
        Eigen::Matrix3d axes;
        file >> parent >> joint >> actuated;
        for (int k = 0; k < 3; ++k) file >> position[k];
        for (int k = 0; k < 9; ++k) file >> axes(k / 3, k % 3);
        file >> mass;
        for (int k = 0; k < 3; ++k) file >> com[k];
        for (double &entry : I) file >> entry;
        if (!file) throw std::runtime_error(path + " is not a mechanism");
        Eigen::Matrix3d inertia;
        inertia << I[0], I[1], I[3], I[1], I[2], I[4], I[3], I[4], I[5];
        const auto id = add_joint(mechanism.model, parent, joint, pinocchio::SE3(axes, position), "j" + std::to_string(i));
        mechanism.model.appendBodyToJoint(id, pinocchio::Inertia(mass, com, inertia), pinocchio::SE3::Identity());
        if (actuated) mechanism.actuated.push_back(i);
    }
    return mechanism;
}

#endif
