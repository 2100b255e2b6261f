// What fits share: sums over a block of sightings, small symmetric matrices, the damped step.
#pragma once

#include <algorithm>
#include <vector>

#include "lens.h"

namespace sunarc {

constexpr double CUT = 5.0;          // sigmas beyond which a sighting counts nothing: Tukey's biweight
constexpr double UNSEEN_PX = 1e4;    // residual of a direction that the lens does not show: beyond any cut
constexpr double FIRST_DAMPING = 1e-3, LARGEST_DAMPING = 1e8;
constexpr double SMALLEST_DAMPING = 1e-12;  // a floor that keeps the damping of good steps from underflowing
// By what the damping grows after a step that loses, and falls after one that gains all that was predicted: chosen so
// that a day's fit takes the fewest steps; 10 and 0.1 take a quarter more.
constexpr double DAMPING_GROWS = 4.0, DAMPING_FALLS = 0.03;
constexpr double RIDGE = 1e-14;  // share of the diagonal that is always added: below the rounding of the sums

using Table = std::vector<double>;  // a matrix, row by row

// Residuals beside the derivatives of a block, all by the roots of the sightings' weights; return the loss: Tukey's for
// a sigma in px, half the plain squares for 0. `pixels` and `information` are those of the block's sightings.
double weigh(Block& block, const double* pixels, const double* information, int size, double sigma);

// Add the products of the first `count` columns (an even number) with one another: the lower half of (count, count).
void add_products(const Block& block, double* products, int count);

// The upper half of a symmetric matrix from its lower one.
void fill_upper(double* matrix, size_t size);

// Replace a vector by the solution; false where the matrix (lower half; its factor afterwards) is not positive.
bool solve(double* matrix, double* vector, int size);

// Write the Levenberg-Marquardt step, scaled by the diagonal; zeros where the equations cannot be solved, so that the
// cost stays and the steps end as they do at a minimum.
void damped_step(const Table& normal, const Table& gradient, const std::vector<size_t>& moving, double damping,
                 Table& work, Table& step);

// What a damped step takes from the cost where the residuals are linear.
double predicted_gain(const Table& normal, const Table& gradient, const std::vector<size_t>& moving, double damping,
                      const Table& step);

// What the damping is multiplied by after a step: the better the prediction, the more it is trusted.
double trust_factor(double gain, double predicted);

// Levenberg-Marquardt: the unknowns that `moving` names, until a step gains less than a share of the cost. Equations have
// `write(at)`, which makes their `cost`, `normal` (lower half) and `gradient` (downwards) about some unknowns. Return the
// cost; `here` holds the equations there.
template <typename Equations>
double minimise(Equations& here, Equations& there, const std::vector<size_t>& moving, int most_steps, double least_gain,
                double damping, Table& at) {
    const size_t f = moving.size();
    Table work(f * f), step(f), trial;
    here.write(at);
    double cost = here.cost;
    for (int number = 0; number < most_steps; ++number) {
        bool moved = false;
        double gain = 0.0;
        const double used = damping;
        while (damping < LARGEST_DAMPING) {
            damped_step(here.normal, here.gradient, moving, damping, work, step);
            trial = at;
            for (size_t i = 0; i < f; ++i) trial[moving[i]] += step[i];
            there.write(trial);
            gain = cost - there.cost;
            // equal costs are taken: at the minimum rounding decides, and a refusal would only raise the damping
            if (gain >= 0.0) {
                moved = true;
                break;
            }
            damping *= DAMPING_GROWS;
        }
        if (!moved) break;
        if (damping == used) {  // one that has just been raised was needed
            damping *= trust_factor(gain, predicted_gain(here.normal, here.gradient, moving, damping, step));
            damping = std::max(damping, SMALLEST_DAMPING);
        }
        at.swap(trial);
        here.normal.swap(there.normal), here.gradient.swap(there.gradient);
        cost -= gain;
        if (gain <= least_gain * std::max(cost, 1e-12)) break;
    }
    return cost;
}

void add_fit(nb::module_& module);
void add_paper(nb::module_& module);
void add_posterior(nb::module_& module);

}  // namespace sunarc
