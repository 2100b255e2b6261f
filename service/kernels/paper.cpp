// The fit of Urquhart et al. 2016 (Eq. 26): plain squares of the residuals, and its penalties.
#include <algorithm>

#include "equations.h"

namespace sunarc {

namespace {

// The penalties c1, c2, c3 as numbers: sunarc.calibration.paper.PenaltyArrays. Their weights are in them.
struct Penalties {
    const double *orthogonality, *edge_powers, *cosine, *sine, *ideal_slope, *slope_by_radial;
    double circularity, edge_radius, monotony;
    bool with_decentering;
    size_t azimuths, angles;
};

using Line = double[PARAMETERS];

class Equations {
  public:
    Table normal = Table(PARAMETERS * PARAMETERS), gradient = Table(PARAMETERS);

    Equations(Optics optics, const Penalties& penalties, Vectors directions, Places pixels, Numbers information)
        : optics_(optics), penalties_(penalties), n_(directions.shape(0)), directions_(directions.data()),
          pixels_(pixels.data()), information_(information.data()), block_(new Block) {}

    // About some parameters; return the sum of squares.
    double write(const Table& vector) {
        std::fill(normal.begin(), normal.end(), 0.0);
        std::fill(gradient.begin(), gradient.end(), 0.0);
        double rotation[9], jacobian[9], products[N_COLUMNS * N_COLUMNS] = {}, cost = 0.0;
        write_rotation(&vector[ROTATION], rotation, jacobian);
        for (size_t begin = 0; begin < n_; begin += BLOCK) {
            const int size = static_cast<int>(std::min<size_t>(BLOCK, n_ - begin));
            write_block(vector.data(), optics_, rotation, jacobian, directions_ + 3 * begin, size, *block_);
            cost += 2.0 * weigh(*block_, pixels_ + 2 * begin, information_ + begin, size, 0.0);
            add_products(*block_, products, N_COLUMNS);
        }
        by_parameters(products);
        cost += orthogonality(vector) + circularity(vector) + monotony(vector);
        for (int i = 0; i < PARAMETERS; ++i)
            for (int j = 0; j < i; ++j) normal[j * PARAMETERS + i] = normal[i * PARAMETERS + j];
        return std::isfinite(cost) ? cost : INFINITY;
    }

  private:
    Optics optics_;
    const Penalties& penalties_;
    size_t n_;
    const double *directions_, *pixels_, *information_;
    std::unique_ptr<Block> block_;

    // The products of a block's columns, lower half, in the order of the parameters.
    void by_parameters(const double* products) {
        for (int a = 0; a < N_COLUMNS; ++a)
            for (int b = 0; b <= a; ++b) {
                const int i = std::max(PARAMETER_OF[a], PARAMETER_OF[b]), j = std::min(PARAMETER_OF[a], PARAMETER_OF[b]);
                if (j >= 0)
                    normal[i * PARAMETERS + j] = products[a * N_COLUMNS + b];
                else if (i >= 0)
                    gradient[i] = products[a * N_COLUMNS + b];
            }
    }

    // Add one penalty's row and value; return its square.
    double add(const Line& row, double value) {
        for (int i = 0; i < PARAMETERS; ++i) {
            if (row[i] == 0.0) continue;
            gradient[i] -= row[i] * value;
            for (int j = 0; j <= i; ++j) normal[i * PARAMETERS + j] += row[i] * row[j];
        }
        return value * value;
    }

    double orthogonality(const Table& vector) {
        Line row = {};
        double value = 0.0;
        for (int k = 0; k < RADIALS; ++k) {
            row[RADIAL + k] = penalties_.orthogonality[k];
            value += penalties_.orthogonality[k] * vector[RADIAL + k];
        }
        return add(row, value);
    }

    // The deviations of the edge's distance from its mean.
    double circularity(const Table& vector) {
        const size_t count = penalties_.azimuths;
        std::vector<std::array<double, PARAMETERS>> rows(count);
        Table distances(count);
        double radius = penalties_.edge_radius, mean = 0.0, cost = 0.0;
        for (int k = 0; k < RADIALS; ++k) radius += penalties_.edge_powers[k] * vector[RADIAL + k];
        std::array<double, PARAMETERS> mean_row{};
        for (size_t i = 0; i < count; ++i) {
            rows[i].fill(0.0);
            distances[i] = edge(vector, radius, penalties_.cosine[i], penalties_.sine[i], rows[i].data());
            mean += distances[i] / count;
            for (int j = 0; j < PARAMETERS; ++j) mean_row[j] += rows[i][j] / count;
        }
        for (size_t i = 0; i < count; ++i) {
            Line row;
            for (int j = 0; j < PARAMETERS; ++j) row[j] = penalties_.circularity * (rows[i][j] - mean_row[j]);
            cost += add(row, penalties_.circularity * (distances[i] - mean));
        }
        return cost;
    }

    // Distance of the edge's image from the principal point, px, and its derivatives.
    double edge(const Table& vector, double radius, double u, double v, double* row) const {
        const double fx = vector[FX], fy = vector[FY], skew = vector[SKEW], square = radius * radius;
        double gx = u, gy = v, x_hat = radius * u, y_hat = radius * v, bx = 0.0, by = 0.0, profile = 0.0;
        if (penalties_.with_decentering) {
            const double* p = &vector[DECENTERING];
            bx = p[0] * (1.0 + 2.0 * u * u) + 2.0 * p[1] * u * v, by = 2.0 * p[0] * u * v + p[1] * (1.0 + 2.0 * v * v);
            profile = square * (1.0 + square * (p[2] + square * p[3]));
            const double rise = radius * (2.0 + square * (4.0 * p[2] + square * 6.0 * p[3]));
            gx += rise * bx, gy += rise * by, x_hat += profile * bx, y_hat += profile * by;
        }
        const double x = fx * x_hat + skew * y_hat, y = fy * y_hat, distance = std::hypot(x, y);
        const double ax = x / distance * fx, ay = (x * skew + y * fy) / distance;  // by x̂ and ŷ
        row[FX] = x / distance * x_hat, row[FY] = y / distance * y_hat, row[SKEW] = x / distance * y_hat;
        for (int k = 0; k < RADIALS; ++k) row[RADIAL + k] = (ax * gx + ay * gy) * penalties_.edge_powers[k];
        if (penalties_.with_decentering) {
            const double both = 2.0 * u * v;
            row[DECENTERING] = profile * (ax * (1.0 + 2.0 * u * u) + ay * both);
            row[DECENTERING + 1] = profile * (ax * both + ay * (1.0 + 2.0 * v * v));
            row[DECENTERING + 2] = square * square * (ax * bx + ay * by);
            row[DECENTERING + 3] = square * square * square * (ax * bx + ay * by);
        }
        return distance;
    }

    // The radius's slope where it falls.
    double monotony(const Table& vector) {
        double cost = 0.0;
        for (size_t i = 0; i < penalties_.angles; ++i) {
            const double* by = penalties_.slope_by_radial + RADIALS * i;
            double slope = penalties_.ideal_slope[i];
            for (int k = 0; k < RADIALS; ++k) slope += by[k] * vector[RADIAL + k];
            if (!(slope < 0.0)) continue;
            Line row = {};
            for (int k = 0; k < RADIALS; ++k) row[RADIAL + k] = penalties_.monotony * by[k];
            cost += add(row, penalties_.monotony * slope);
        }
        return cost;
    }
};

// Levenberg-Marquardt until a step gains less than a share of the cost; return the sum of squares.
double minimise(Equations& here, Equations& there, const std::vector<size_t>& moving, int most_steps, double least_gain,
              double damping, Table& at) {
    const size_t f = moving.size();
    Table work(f * f), step(f), trial;
    double cost = here.write(at);
    for (int number = 0; number < most_steps; ++number) {
        damped_step(here.normal, here.gradient, moving, damping, work, step);
        trial = at;
        for (size_t i = 0; i < f; ++i) trial[moving[i]] += step[i];
        const double next = there.write(trial);
        if (!(next <= cost)) {
            damping *= 10.0;
            if (damping > LARGEST_DAMPING) break;
            continue;
        }
        const double gained = cost - next;
        cost = next;
        at.swap(trial);
        here.normal.swap(there.normal), here.gradient.swap(there.gradient);
        damping = std::max(damping * 0.1, SMALLEST_DAMPING);
        if (gained <= least_gain * cost) break;
    }
    return cost;
}

nb::tuple paper_fit(int code, double mirror, double max_angle, Vectors directions, Places pixels, Numbers information,
                    In<double, RADIALS> orthogonality, double circularity, double edge_radius,
                    In<double, RADIALS> edge_powers, Numbers cosine, Numbers sine, bool with_decentering,
                    double monotony, Numbers ideal_slope, In<double, -1, RADIALS> slope_by_radial,
                    In<double, PARAMETERS> start, Indices moving, int most_steps, double least_gain,
                    double first_damping) {
    require_projection(code);
    require(pixels.shape(0) == directions.shape(0), "not as many pixels as directions");
    require(information.shape(0) == directions.shape(0), "not as many weights as directions");
    require(sine.shape(0) == cosine.shape(0), "not as many sines as cosines");
    require(slope_by_radial.shape(0) == ideal_slope.shape(0), "not as many rows as slopes");
    const auto free = checked(moving, PARAMETERS, "a parameter that moves is none");
    Out<double> result({PARAMETERS});
    double cost;
    {
        nb::gil_scoped_release unlocked;
        const Penalties penalties{orthogonality.data(), edge_powers.data(), cosine.data(), sine.data(),
                                  ideal_slope.data(), slope_by_radial.data(), circularity, edge_radius, monotony,
                                  with_decentering, cosine.shape(0), ideal_slope.shape(0)};
        const Optics optics{code, mirror, max_angle};
        Equations here(optics, penalties, directions, pixels, information);
        Equations there(optics, penalties, directions, pixels, information);
        Table at(start.data(), start.data() + PARAMETERS);
        cost = minimise(here, there, free, most_steps, least_gain, first_damping, at);
        std::copy(at.begin(), at.end(), result.data);
    }
    return nb::make_tuple(result.array(), cost);
}

}  // namespace

void add_paper(nb::module_& module) {
    module.def("paper_fit", &paper_fit, nb::arg("code"), nb::arg("mirror"), nb::arg("max_angle"), named("directions"),
               named("pixels"), named("information"), named("orthogonality"), nb::arg("circularity"),
               nb::arg("edge_radius"), named("edge_powers"), named("cosine"), named("sine"),
               nb::arg("with_decentering"), nb::arg("monotony"), named("ideal_slope"), named("slope_by_radial"),
               named("start"), named("moving"), nb::arg("most_steps"), nb::arg("least_gain"),
               nb::arg("first_damping"));
}

}  // namespace sunarc
