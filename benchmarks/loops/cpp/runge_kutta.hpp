// An explicit Runge-Kutta method with two estimates of the error, as Hairer's DOP853 combines them; steps adapt.
//
// The caller gives the coefficients. y' = f(y), autonomous. Tolerances are equal, absolute and relative.
#ifndef BENCHMARKS_RUNGE_KUTTA_HPP
#define BENCHMARKS_RUNGE_KUTTA_HPP

#include <algorithm>
#include <cmath>
#include <vector>

#include <Eigen/Core>

struct Tableau {
    int stages;
    const double *A, *b, *e3, *e5; // A: stages x stages, row by row; e3, e5: stages + 1
};

// Integrate y over a span; return the number of calls of f, or -1 where steps become too short.
template <typename Function>
long long integrate(const Tableau &tableau, Function &&f, double span, double tolerance, Eigen::VectorXd &y)
{
    const int s = tableau.stages, n = y.size();
    Eigen::MatrixXd K(n, s + 1);
    Eigen::VectorXd stage(n), next(n), scale(n);
    long long calls = 1;
    f(y, K.col(0));
    double t = 0, h = 1e-3 * span;
    while (t < span) {
        h = std::min(h, span - t);
        for (int i = 1; i < s; ++i) {
            stage = y;
            for (int j = 0; j < i; ++j)
                if (tableau.A[i * s + j] != 0) stage += h * tableau.A[i * s + j] * K.col(j);
            f(stage, K.col(i));
        }
        next = y;
        for (int j = 0; j < s; ++j)
            if (tableau.b[j] != 0) next += h * tableau.b[j] * K.col(j);
        f(next, K.col(s));
        calls += s;
        scale = tolerance * (1 + y.cwiseAbs().cwiseMax(next.cwiseAbs()).array());
        double e3 = 0, e5 = 0;
        for (int i = 0; i < n; ++i) {
            double a = 0, b = 0;
            for (int j = 0; j <= s; ++j) a += tableau.e3[j] * K(i, j), b += tableau.e5[j] * K(i, j);
            e3 += a * a / (scale[i] * scale[i]), e5 += b * b / (scale[i] * scale[i]);
        }
        const double error = e5 == 0 ? 0 : h * e5 / std::sqrt((e5 + 0.01 * e3) * n);
        if (!std::isfinite(error) || h < 1e-14 * span) return -1;
        if (error < 1) {
            t += h;
            y = next;
            K.col(0) = K.col(s);
        }
        h *= std::clamp(0.9 * std::pow(std::max(error, 1e-10), -1.0 / 8), 0.2, 10.0);
    }
    return calls;
}

#endif
