// Trace Pinocchio's algorithms with CasADi's symbols, and save them: trace MECHANISM OUTPUT.casadi
//
// The functions have the names and arguments of the generated kernels; what differs is how they are computed:
//   impl      recursive Newton-Euler                 (rnea)
//   semi      composite bodies and bias              (crba, nonLinearEffects)
//   semi_res  M qdd + c - Q of these
//   exp1      factorisation of M, by joints          (crba, cholesky)
//   exp2      articulated bodies                     (aba)
//   jac_impl_analytic, jac_exp_analytic              (computeRNEADerivatives, computeABADerivatives)
#include <pinocchio/autodiff/casadi.hpp>

#include <casadi/casadi.hpp>
#include <pinocchio/algorithm/aba-derivatives.hpp>
#include <pinocchio/algorithm/aba.hpp>
#include <pinocchio/algorithm/cholesky.hpp>
#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/rnea-derivatives.hpp>
#include <pinocchio/algorithm/rnea.hpp>

#include <iostream>

#include "mechanism.hpp"

using casadi::Slice;
using casadi::SX;
using SxModel = ModelOf<SX>;
using SxData = DataOf<SX>;
using SxVector = Eigen::Matrix<SX, Eigen::Dynamic, 1>;
using SxMatrix = Eigen::Matrix<SX, Eigen::Dynamic, Eigen::Dynamic>;

static SxVector to_eigen(const SX &x)
{
    SxVector copy(x.numel());
    for (casadi_int i = 0; i < x.numel(); ++i) copy[i] = x(i);
    return copy;
}

template <typename Derived>
static SX to_casadi(const Eigen::MatrixBase<Derived> &x)
{
    SX copy(x.rows(), x.cols()); // sparse: what is zero as a symbol has no place
    for (Eigen::Index r = 0; r < x.rows(); ++r)
        for (Eigen::Index c = 0; c < x.cols(); ++c)
            if (!x(r, c).is_zero()) copy(r, c) = x(r, c);
    return copy;
}

static SxMatrix symmetric(const SxMatrix &upper)
{
    SxMatrix full = upper;
    full.triangularView<Eigen::StrictlyLower>() = upper.transpose().triangularView<Eigen::StrictlyLower>();
    return full;
}

static void trace(const Mechanism &mechanism, const std::string &path)
{
    const SxModel model = mechanism.model.cast<SX>();
    const int n = model.nv, m = static_cast<int>(mechanism.actuated.size());
    const SX q = SX::sym("q", n), qd = SX::sym("qd", n), qdd = SX::sym("qdd", n), u = SX::sym("u", m);
    SX Q(n, 1);
    for (int i = 0; i < m; ++i) Q(mechanism.actuated[i]) = u(i);
    Q = densify(Q);
    const SxVector eq = to_eigen(q), eqd = to_eigen(qd), eqdd = to_eigen(qdd), eQ = to_eigen(Q);
    const std::vector<SX> inverse{q, qd, qdd, u}, forward{q, qd, u};
    const std::vector<std::string> inverse_names{"q", "qd", "qdd", "u"}, forward_names{"q", "qd", "u"};

    SxData rnea(model), crba(model), bias(model), aba(model), inverse_data(model), forward_data(model);
    const SX Phi = to_casadi(pinocchio::rnea(model, rnea, eq, eqd, eqdd)) - Q;

    pinocchio::crba(model, crba, eq, pinocchio::Convention::LOCAL);
    const SxMatrix M = symmetric(crba.M);
    const SxVector c = pinocchio::nonLinearEffects(model, bias, eq, eqd);
    const SX c_sx = to_casadi(c), M_sx = to_casadi(M);

    crba.M = M;
    pinocchio::cholesky::decompose(model, crba);
    SxVector accelerations = eQ - c;
    pinocchio::cholesky::solve(model, crba, accelerations);

    const SX exp2 = to_casadi(pinocchio::aba(model, aba, eq, eqd, eQ, pinocchio::Convention::LOCAL));

    pinocchio::computeRNEADerivatives(model, inverse_data, eq, eqd, eqdd);
    pinocchio::computeABADerivatives(model, forward_data, eq, eqd, eQ);
    std::vector<casadi_int> driven(mechanism.actuated.begin(), mechanism.actuated.end());
    const SX Minv = to_casadi(symmetric(forward_data.Minv));

    casadi::FileSerializer file(path);
    file.pack(std::vector<casadi::Function>{
        {"impl", inverse, {Phi}, inverse_names, {"Phi"}},
        {"semi", {q, qd}, {M_sx, c_sx}, {"q", "qd"}, {"M", "c"}},
        {"semi_res", inverse, {mtimes(M_sx, qdd) + c_sx - Q}, inverse_names, {"Phi"}},
        {"exp1", forward, {to_casadi(accelerations)}, forward_names, {"qdd"}},
        {"exp2", forward, {exp2}, forward_names, {"qdd"}},
        {"jac_impl_analytic", inverse,
         {to_casadi(inverse_data.dtau_dq), to_casadi(inverse_data.dtau_dv), to_casadi(symmetric(inverse_data.M))},
         inverse_names, {"jac_Phi_q", "jac_Phi_qd", "jac_Phi_qdd"}},
        {"jac_exp_analytic", forward,
         {to_casadi(forward_data.ddq_dq), to_casadi(forward_data.ddq_dv), Minv(Slice(), driven)},
         forward_names, {"jac_qdd_q", "jac_qdd_qd", "jac_qdd_u"}},
    });
}

int main(int argc, char **argv)
{
    if (argc != 3) {
        std::cerr << "usage: trace MECHANISM OUTPUT\n";
        return 2;
    }
    try {
        trace(read_mechanism(argv[1]), argv[2]);
    } catch (const std::exception &error) {
        std::cerr << error.what() << '\n';
        return 1;
    }
    return 0;
}
