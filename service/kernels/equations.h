// What fits share: sums over a block of sightings, small symmetric matrices, the damped step.
#pragma once

#include <vector>

#include "lens.h"

namespace sunarc {

constexpr double CUT = 5.0;          // sigmas beyond which a sighting counts nothing: Tukey's biweight
constexpr double UNSEEN_PX = 1e4;    // residual of a direction that the lens does not show: beyond any cut
constexpr double FIRST_DAMPING = 1e-3, LARGEST_DAMPING = 1e8;
constexpr double SMALLEST_DAMPING = 1e-12;  // a floor that keeps the damping of good steps from underflowing
constexpr double RIDGE = 1e-14;  // share of the diagonal that is always added: below the rounding of the sums

using Table = std::vector<double>;  // a matrix, row by row

// Residuals beside the derivatives of a block, all by the roots of the sightings' weights; return the loss: Tukey's for
// a sigma in px, half the plain squares for 0. `pixels` and `information` are those of the block's sightings.
double weigh(Block& block, const double* pixels, const double* information, int size, double sigma);

// Add the products of the first `count` columns (an even number) with one another: the lower half of (count, count).
void add_products(const Block& block, double* products, int count);

// Replace a vector by the solution; false where the matrix (lower half; its factor afterwards) is not positive.
bool solve(double* matrix, double* vector, int size);

// Write the Levenberg-Marquardt step, scaled by the diagonal; zeros where the equations cannot be solved, so that the
// cost stays and the steps end as they do at a minimum.
void damped_step(const Table& normal, const Table& gradient, const std::vector<size_t>& moving, double damping,
                 Table& work, Table& step);

void add_fit(nb::module_& module);
void add_paper(nb::module_& module);

}  // namespace sunarc
