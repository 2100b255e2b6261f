// How probable each choice of a fit's scales is, and how the errors are spread that the choices leave.
#include <cstring>

#include "equations.h"

namespace sunarc {

namespace {

constexpr size_t DECENTERINGS = 2, VARIED = RADIALS + DECENTERINGS;  // unknowns whose prior precisions are tried
constexpr double DIAGONAL = 1.0 + 1e-13;  // marginal_likelihood.RIDGE is added to it

// Eliminate the first `count` unknowns of a symmetric matrix (size, size), its upper half. Return the logarithm of their
// determinant, no pivot taken for less than `least`; not finite where it is not positive.
DISPATCHED double eliminate(double* matrix, size_t size, size_t count, double least) {
    double log_determinant = 0.0;
    for (size_t j = 0; j < count; ++j) {
        const double *row = matrix + j * size, pivot = std::max(row[j], least);  // NaN stays
        log_determinant += std::log(pivot);
        for (size_t i = j + 1; i < size; ++i) {
            double* left = matrix + i * size;
            const double share = row[i] / pivot;
#pragma omp simd
            for (size_t k = i; k < size; ++k) left[k] -= share * row[k];
        }
    }
    return log_determinant;
}

Result evidence_terms(In<double, -1, -1, -1> matrices, Matrix vectors, Numbers at, Numbers precision, Indices order,
                      In<double, -1, DECENTERINGS> pairs) {
    const size_t fields = matrices.shape(0), p = matrices.shape(1), k = pairs.shape(0), size = p + 1;
    require(p >= VARIED && matrices.shape(2) == p, "matrices that are not square, or too small");
    require(vectors.shape(0) == fields && vectors.shape(1) == p, "not a vector for each matrix");
    require(at.shape(0) == p && precision.shape(0) == p && order.shape(0) == p, "not a number for each unknown");
    const auto places = checked(order, p, "no such unknown");
    const size_t others = p - VARIED, left = VARIED + 1;
    Out<double> result({fields, k});
    {
        nb::gil_scoped_release unlocked;
        Table matrix(size * size), rest(left * left);
        for (size_t field = 0; field < fields; ++field) {
            const double *own = matrices.data() + field * p * p, *vector = vectors.data() + field * p;
            for (size_t i = 0; i < p; ++i) {
                const size_t a = places[i];
                for (size_t j = i; j < p; ++j) matrix[i * size + j] = own[a * p + places[j]];
                const double prior = i < others ? precision.data()[a] : 0.0;
                matrix[i * size + i] = DIAGONAL * (own[a * p + a] + prior);
                matrix[i * size + p] = vector[a] - prior * at.data()[a];
            }
            matrix[p * size + p] = 0.0;  // becomes minus the vector's square by the inverse
            const double of_others = eliminate(matrix.data(), size, others, 0.0);
            double of_radial = 0.0, eliminated = NAN;
            for (size_t pair = 0; pair < k; ++pair) {
                const double radial = pairs.data()[2 * pair], decentering = pairs.data()[2 * pair + 1];
                if (radial != eliminated) {
                    for (size_t i = 0; i < left; ++i)
                        std::copy_n(&matrix[(others + i) * size + others], left, &rest[i * left]);
                    for (size_t i = 0; i < RADIALS; ++i) {
                        rest[i * left + i] += DIAGONAL * radial;
                        rest[i * left + VARIED] -= radial * at.data()[places[others + i]];
                    }
                    // below the prior's precision is rounding: a lens that cannot show the sightings
                    of_radial = eliminate(rest.data(), left, RADIALS, radial);
                    eliminated = radial;
                }
                const double *x = &rest[RADIALS * left + RADIALS], *y = x + left, *square = y + left;
                const double xx = x[0] + DIAGONAL * decentering, xy = x[1], yy = y[1] + DIAGONAL * decentering;
                const double px = x[2] - decentering * at.data()[places[p - 2]];
                const double py = y[2] - decentering * at.data()[places[p - 1]], area = xx * yy - xy * xy;
                const double gained = (yy * px * px - 2.0 * xy * px * py + xx * py * py) / area - square[2];
                result.data[field * k + pair] = gained - of_others - of_radial - std::log(xx) - std::log(area / xx);
            }
        }
    }
    return result.array();
}

// Add what the row of a covariance makes of the right side, times the left one: xx, xy and yy, made symmetric.
DISPATCHED void add_row(const double* row, size_t q, size_t n, size_t i, const double* left, const double* right,
                        double* x, double* y, double* sums) {
    std::fill_n(x, n, 0.0), std::fill_n(y, n, 0.0);
    for (size_t j = 0; j < q; ++j) {
        const double share = row[j], *right_x = right + j * n, *right_y = right + (q + j) * n;
#pragma omp simd
        for (size_t place = 0; place < n; ++place)
            x[place] += share * right_x[place], y[place] += share * right_y[place];
    }
    const double *left_x = left + i * n, *left_y = left + (q + i) * n;
#pragma omp simd
    for (size_t place = 0; place < n; ++place) {
        sums[place] += left_x[place] * x[place];
        sums[n + place] += 0.5 * (left_x[place] * y[place] + left_y[place] * x[place]);
        sums[2 * n + place] += left_y[place] * y[place];
    }
}

Result moments_of(In<double, -1, -1, -1> covariances, Indices field, In<double, -1, 2, -1, -1> left,
                  In<double, -1, 2, -1, -1> right, In<double, -1, 3, -1> beside, In<double, 2, -1, -1> shift) {
    const size_t k = covariances.shape(0), q = covariances.shape(1), fields = left.shape(0), n = left.shape(3);
    require(covariances.shape(2) == q && left.shape(2) == q && right.shape(2) == q, "not a row for each unknown");
    require(right.shape(0) == fields && right.shape(3) == n, "not as many places on both sides");
    require(beside.shape(0) == fields && beside.shape(2) == n, "not as many moments as places");
    require(shift.shape(1) == k && shift.shape(2) == n, "not as many shifts as places");
    require(field.shape(0) == k, "not a field for each covariance");
    const auto places = checked(field, fields, "no such field");
    Out<double> result({k, 3, n});
    {
        nb::gil_scoped_release unlocked;
        Table x(n), y(n);
        for (size_t choice = 0; choice < k; ++choice) {
            double* sums = result.data + 3 * n * choice;
            const double *own = beside.data() + 3 * n * places[choice], *off = shift.data() + n * choice;
            for (size_t place = 0; place < n; ++place) {
                const double by_x = off[place], by_y = off[n * k + place];
                sums[place] = own[place] + by_x * by_x;
                sums[n + place] = own[n + place] + by_x * by_y;
                sums[2 * n + place] = own[2 * n + place] + by_y * by_y;
            }
            for (size_t i = 0; i < q; ++i)
                add_row(covariances.data() + (choice * q + i) * q, q, n, i, left.data() + 2 * q * n * places[choice],
                        right.data() + 2 * q * n * places[choice], x.data(), y.data(), sums);
        }
    }
    return result.array();
}

struct Weighed {
    double value, weight;
};

// Octaves of the values are cut into so many equal parts, from 2^-LOWEST on: only in the parts that hold a bound are
// values sorted.
constexpr int BITS = 5, LOWEST = 24, OCTAVES = 48, N_PARTS = OCTAVES << BITS;

// The part of a positive value, by its exponent and the first bits behind it: of infinity and of NaN the last.
INLINED size_t part_of(double value) {
    uint64_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    constexpr int64_t first = static_cast<int64_t>(1023 - LOWEST) << BITS;
    return std::clamp<int64_t>(static_cast<int64_t>(bits >> (52 - BITS)) - first, 0, N_PARTS - 1);
}

bool before(const Weighed& one, const Weighed& other) {  // NaN comes last
    return std::isnan(other.value) ? !std::isnan(one.value) : one.value < other.value;
}

Result moments_below(In<double, -1, 3, -1> moments, Numbers share, Matrix stated, Numbers cosines, Numbers bounds,
                     double smallest) {
    const size_t k = moments.shape(0), n = moments.shape(2), around = cosines.shape(0), m = bounds.shape(0);
    require(share.shape(0) == k, "not a share for each choice");
    require(stated.shape(0) == 3 && stated.shape(1) == n, "not a stated covariance for each place");
    Out<double> result({n, m});
    {
        nb::gil_scoped_release unlocked;
        std::vector<Weighed> every(k * around), inside;
        std::vector<uint32_t> part(k * around);
        Table weights(N_PARTS), sums(N_PARTS);
        for (size_t place = 0; place < n; ++place) {
            const double a = stated.data()[place], b = stated.data()[n + place], d = stated.data()[2 * n + place];
            const double inverse = 1.0 / (a * d - b * b);
            std::fill(weights.begin(), weights.end(), 0.0), std::fill(sums.begin(), sums.end(), 0.0);
            for (size_t choice = 0, i = 0; choice < k; ++choice) {
                const double* one = moments.data() + 3 * n * choice + place;
                const double xx = one[0], xy = one[n], yy = one[2 * n];
                const double half = 0.5 * inverse * (d * xx - 2.0 * b * xy + a * yy);
                const double gap = std::sqrt(std::max(half * half - inverse * (xx * yy - xy * xy), 0.0));
                for (size_t c = 0; c < around; ++c, ++i) {
                    // below 0 is rounding, of choices whose lens and field take nearly all from one another
                    every[i] = {std::max(half + gap * cosines.data()[c], smallest), share.data()[choice] / around};
                    part[i] = static_cast<uint32_t>(part_of(every[i].value));
                    weights[part[i]] += every[i].weight, sums[part[i]] += every[i].weight * every[i].value;
                }
            }
            size_t here = 0, sorted = N_PARTS;
            double below = 0.0, moment = 0.0;  // of the parts before this one
            for (size_t at = 0; at < m; ++at) {
                const double bound = bounds.data()[at];
                while (here + 1 < N_PARTS && below + weights[here] < bound)
                    below += weights[here], moment += sums[here], ++here;
                if (sorted != here) {
                    inside.clear();
                    for (size_t i = 0; i < every.size(); ++i)
                        if (part[i] == here) inside.push_back(every[i]);
                    std::sort(inside.begin(), inside.end(), before);
                    sorted = here;
                }
                double rest = bound - below, total = moment;
                for (const Weighed& one : inside) {
                    if (rest <= 0.0) break;  // what has no share may be no number
                    total += std::min(one.weight, rest) * one.value;
                    rest -= std::min(one.weight, rest);
                }
                result.data[place * m + at] = total;
            }
        }
    }
    return result.array();
}

}  // namespace

void add_posterior(nb::module_& module) {
    module.def("evidence_terms", &evidence_terms, named("matrices"), named("vectors"), named("at"), named("precision"),
               named("order"), named("pairs"));
    module.def("moments_of", &moments_of, named("covariances"), named("field"), named("left"), named("right"),
               named("beside"), named("shift"));
    module.def("moments_below", &moments_below, named("moments"), named("share"), named("stated"), named("cosines"),
               named("bounds"), nb::arg("smallest"));
}

}  // namespace sunarc
