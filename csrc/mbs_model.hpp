/* C++ on top of generated C: vectors with their sizes, matrices with their patterns, failures as exceptions.
 *
 * C++17. -DMBS_WITH_EIGEN adds conversions of matrices to Eigen's. Nothing here allocates, except a failure's message.
 */
#ifndef MBS_MODEL_HPP
#define MBS_MODEL_HPP

#include <array>
#include <cstddef>
#include <stdexcept>
#include <string>

#ifdef MBS_WITH_EIGEN
#include <Eigen/Core>
#endif

#include "mbs_abi.h"

namespace mbs {
inline namespace MBS_PASTE(of_, MBS_REAL) { /* inline functions of another precision are other ones */

/* A function that failed at a state: `status` is the joint, from 1, or a loop beyond the joints. */
class failure : public std::runtime_error {
public:
    failure(const char *function, int found)
        : std::runtime_error(std::string(function) + " failed with status " + std::to_string(found)), status(found)
    {
    }
    const int status;
};

/* Check a function's status. */
inline void check(const char *function, int status)
{
    if (status)
        throw failure(function, status);
}

/* Return the numbers of a vector of any type with data() and size(), such as std::array, std::vector or Eigen's. */
template <std::size_t Size, class Vector> const mbs_real *read(const Vector &vector, const char *name)
{
    if (static_cast<std::size_t>(vector.size()) != Size)
        throw std::invalid_argument(
            std::string(name) + " has " + std::to_string(vector.size()) + " entries, not " + std::to_string(Size));
    return vector.data();
}

template <std::size_t Size> using vector = std::array<mbs_real, Size>;

/* A matrix by its nonzeros, column by column; `pattern` gives their places. */
template <std::size_t Rows, std::size_t Columns, std::size_t Nonzeros> struct matrix {
    std::array<mbs_real, Nonzeros> nonzeros;
    const casadi_int *pattern;

    static constexpr std::size_t rows = Rows, columns = Columns;

    /* Return all entries, column by column. */
    std::array<mbs_real, Rows * Columns> full() const
    {
        std::array<mbs_real, Rows * Columns> entries;
        mbs_fill_columns(pattern, nonzeros.data(), entries.data());
        return entries;
    }

#ifdef MBS_WITH_EIGEN
    Eigen::Matrix<mbs_real, static_cast<int>(Rows), static_cast<int>(Columns),
        (Rows == 1 && Columns != 1) ? Eigen::RowMajor : Eigen::ColMajor>
    eigen() const
    {
        Eigen::Matrix<mbs_real, static_cast<int>(Rows), static_cast<int>(Columns),
            (Rows == 1 && Columns != 1) ? Eigen::RowMajor : Eigen::ColMajor>
            entries;
        mbs_fill_columns(pattern, nonzeros.data(), entries.data());
        return entries;
    }
#endif
};

} // namespace of the precision
} // namespace mbs

#endif
