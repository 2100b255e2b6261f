// Stars: sums of the least squares of a point spread over the pixels about each, and the votes of pairs of stars and
// detections for the angle about the axis.
#include <algorithm>
#include <cmath>

#include "arrays.h"

namespace sunarc {

namespace {

// sunarc.detection.stars.detect: x, y, height, level; then xx, xy, yy of the inverse covariance
constexpr size_t SHAPE = 7, PLACE = 4;
constexpr double FARTHEST = 60.0;  // sigmas squared from the centre, where a Gaussian is 0

struct Stamp {
    size_t pixels;
    const double *x, *y, *value, *weight, *at;
};

// Return chi squared, and write the derivatives of the light by the first `free` parameters, then the residuals by their
// weights: each a row of as many numbers as there are pixels.
DISPATCHED double write_rows(const Stamp& stamp, size_t free, double* rows) {
    const size_t m = stamp.pixels;
    const double *at = stamp.at, height = at[2], level = at[3], xx = at[4], xy = at[5], yy = at[6];
    double chi2 = 0.0;
    for (size_t i = 0; i < m; ++i) {
        const double dx = stamp.x[i] - at[0], dy = stamp.y[i] - at[1];
        const double far = xx * dx * dx + 2.0 * xy * dx * dy + yy * dy * dy;
        const double bell = std::exp(-0.5 * std::min(std::max(far, 0.0), FARTHEST)), light = height * bell;
        const double residual = stamp.value[i] - light - level;
        chi2 += residual * residual * stamp.weight[i];
        rows[free * m + i] = residual * stamp.weight[i];
        if (free == 0) continue;
        rows[i] = light * (xx * dx + xy * dy);
        rows[m + i] = light * (xy * dx + yy * dy);
        rows[2 * m + i] = bell;
        rows[3 * m + i] = 1.0;
        if (free == PLACE) continue;
        rows[4 * m + i] = -0.5 * light * dx * dx;
        rows[5 * m + i] = -light * dx * dy;
        rows[6 * m + i] = -0.5 * light * dy * dy;
    }
    return chi2;
}

DISPATCHED void add_rows(const double* rows, const double* weight, size_t m, size_t free, double* normal,
                         double* gradient) {
    const double* residual = rows + free * m;
    for (size_t a = 0; a < free; ++a) {
        const double* first = rows + a * m;
        double sum = 0.0;
#pragma omp simd reduction(+ : sum)
        for (size_t i = 0; i < m; ++i) sum += first[i] * residual[i];
        gradient[a] = sum;
        for (size_t b = 0; b <= a; ++b) {
            const double* second = rows + b * m;
            double product = 0.0;
#pragma omp simd reduction(+ : product)
            for (size_t i = 0; i < m; ++i) product += first[i] * second[i] * weight[i];
            normal[a * free + b] = normal[b * free + a] = product;
        }
    }
}

nb::tuple point_spread_equations(Matrix x, Matrix y, Matrix value, Matrix weight, In<double, -1, SHAPE> at,
                                 size_t free) {
    require(free == 0 || free == PLACE || free == SHAPE, "free is not 0, 4 or 7");
    const size_t n = x.shape(0), m = x.shape(1);
    for (const Matrix& one : {y, value, weight})
        require(one.shape(0) == n && one.shape(1) == m, "pixels of another number");
    require(at.shape(0) == n, "not the parameters of each star");
    Out<double> chi2({n}), normal({n, free, free}), gradient({n, free});
    {
        nb::gil_scoped_release unlocked;
        std::vector<double> rows((free + 1) * m);
        for (size_t k = 0; k < n; ++k) {
            const Stamp stamp{m, x.data() + k * m, y.data() + k * m, value.data() + k * m, weight.data() + k * m,
                              at.data() + k * SHAPE};
            chi2.data[k] = write_rows(stamp, free, rows.data());
            add_rows(rows.data(), stamp.weight, m, free, normal.data + k * free * free, gradient.data + k * free);
        }
    }
    return nb::make_tuple(chi2.array(), normal.array(), gradient.array());
}

nb::ndarray<nb::numpy, int64_t> votes_of_pairs(Indices keys, Indices first, Indices last, Indices place, size_t tilts,
                                               size_t bins) {
    constexpr size_t MOST = 1 << 16;
    require(tilts <= MOST && bins > 0 && bins <= MOST, "too many tilts or bins, or no bin");
    const size_t n = place.size(), wide = 2 * bins;
    require(first.size() == n && last.size() == n, "not a run of keys for each detection");
    const auto key = checked(keys, tilts * wide, "a key beyond the tilts");
    const auto begin = checked(first, key.size() + 1, "no such key");
    const auto end = checked(last, key.size() + 1, "no such key");
    const auto moved = checked(place, bins, "no such bin");
    Out<int64_t> out({tilts, bins});
    {
        nb::gil_scoped_release unlocked;
        std::vector<int32_t> votes(tilts * wide + bins, 0), folded(bins);
        for (size_t k = 0; k < n; ++k) {
            int32_t* from = votes.data() + moved[k];
            for (size_t i = begin[k]; i < end[k]; ++i) ++from[key[i]];
        }
        for (size_t tilt = 0; tilt < tilts; ++tilt) {
            const int32_t* row = votes.data() + tilt * wide;
            for (size_t i = 0; i < bins; ++i) folded[i] = row[i] + row[bins + i];
            for (size_t i = 0; i < bins; ++i)
                out.data[tilt * bins + i] =
                    int64_t(folded[i]) + folded[(i + 1) % bins] + folded[(i + bins - 1) % bins];
        }
    }
    return out.array();
}

}  // namespace

void add_stars(nb::module_& module) {
    module.def("point_spread_equations", &point_spread_equations, named("x"), named("y"), named("value"),
               named("weight"), named("at"), nb::arg("free"));
    module.def("votes_of_pairs", &votes_of_pairs, named("keys"), named("first"), named("last"), named("place"),
               nb::arg("tilts"), nb::arg("bins"));
}

}  // namespace sunarc
