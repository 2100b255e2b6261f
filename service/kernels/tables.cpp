// Many pixels at once from tables: cubic pieces over the lens's radius, cubic splines over the image.
#include <algorithm>

#include "lens.h"

namespace sunarc {

namespace {

constexpr int BATCH = 512;  // pixels taken together
constexpr double NOT_A_NUMBER = __builtin_nan("");

// sunarc.optics.inverse_table.InverseConstants, in its order.
struct Constants {
    double per_fx, per_fy, skew, x0, y0, mirror, p1, p2, p3, p4, per_radius, limit, exact_from;
};
using ConstantNumbers = In<double, 13>;
static_assert(sizeof(Constants) == 13 * sizeof(double));

Constants constants_of(ConstantNumbers numbers) {
    Constants result;
    std::copy_n(numbers.data(), 13, reinterpret_cast<double*>(&result));
    return result;
}

// (x̂, ŷ) of a pixel: in focal lengths from the axis, the decentering still in it.
INLINED void calibrated(const Constants& c, double x, double y, double& x_hat, double& y_hat) {
    y_hat = (y - c.y0) * c.per_fy;
    const double column = c.mirror >= 0.0 ? c.mirror - x : x;
    x_hat = (column - c.x0 - c.skew * y_hat) * c.per_fx;
}

// The shift of Eq. 12 at a point in focal lengths.
INLINED void decentering(const Constants& c, double x, double y, double& shift_x, double& shift_y) {
    const double xx = x * x, yy = y * y, xy = 2.0 * x * y, square = xx + yy;
    const double profile = 1.0 + square * (c.p3 + square * c.p4);
    shift_x = profile * (c.p1 * (square + 2.0 * xx) + c.p2 * xy);
    shift_y = profile * (c.p1 * xy + c.p2 * (square + 2.0 * yy));
}

DISPATCHED bool write_from_table(const Constants& c, const double* r, const double* table, size_t pieces, int rounds,
                                 const double* pixels, size_t n, double* result) {
    bool coarse = false;
    const double last = static_cast<double>(pieces - 1);
    for (size_t begin = 0; begin < n; begin += BATCH) {
        const int size = static_cast<int>(std::min<size_t>(BATCH, n - begin));
        double x_hat[BATCH], y_hat[BATCH], x[BATCH], y[BATCH], radius[BATCH];
        for (int k = 0; k < size; ++k) {
            calibrated(c, pixels[2 * (begin + k)], pixels[2 * (begin + k) + 1], x_hat[k], y_hat[k]);
            x[k] = x_hat[k], y[k] = y_hat[k];
        }
        for (int round = 0; round < rounds; ++round)
#pragma omp simd
            for (int k = 0; k < size; ++k) {
                double shift_x, shift_y;
                decentering(c, x[k], y[k], shift_x, shift_y);
                x[k] = x_hat[k] - shift_x, y[k] = y_hat[k] - shift_y;
            }
#pragma omp simd
        for (int k = 0; k < size; ++k) radius[k] = std::sqrt(x[k] * x[k] + y[k] * y[k]);
        for (int k = 0; k < size; ++k) {
            double* to = result + 3 * (begin + k);
            if (!(radius[k] <= c.limit)) {
                to[0] = to[1] = to[2] = NOT_A_NUMBER;
                continue;
            }
            if (radius[k] > c.exact_from) {
                to[0] = INFINITY, coarse = true;
                continue;
            }
            const double position = radius[k] * c.per_radius;
            const size_t piece = position > 0.0 ? static_cast<size_t>(std::min(position, last)) : 0;
            const double s = position - static_cast<double>(piece), *t = table + 8 * piece;
            const double scale = t[0] + s * (t[1] + s * (t[2] + s * t[3]));
            const double z = t[4] + s * (t[5] + s * (t[6] + s * t[7]));
            for (int a = 0; a < 3; ++a) to[a] = scale * (r[a] * x[k] + r[3 + a] * y[k]) + r[6 + a] * z;
        }
    }
    return coarse;
}

nb::tuple directions_from_table(ConstantNumbers constants, Rotation rotation, In<double, -1, 8> table, int rounds,
                                Places pixels) {
    require(table.shape(0) > 0 && rounds >= 0, "a table has at least one piece, and no rounds below 0");
    Out<double> result({pixels.shape(0), 3});
    bool coarse;
    {
        nb::gil_scoped_release unlocked;
        coarse = write_from_table(constants_of(constants), rotation.data(), table.data(), table.shape(0), rounds,
                                  pixels.data(), pixels.shape(0), result.data);
    }
    return nb::make_tuple(result.array(), coarse);
}

// The first of four nodes, and their weights, of a cubic spline.
struct Weights {
    size_t node;
    double of[4];
};

INLINED Weights spline_weights(double position, double last) {
    // NaN takes the first node, and stays in the weights
    const double node = position > 0.0 ? std::min(std::floor(position), last) : 0.0, s = position - node, t = 1.0 - s;
    return {static_cast<size_t>(node),
            {t * t * t / 6.0, (3.0 * s * s * s - 6.0 * s * s + 4.0) / 6.0,
             (-3.0 * s * s * s + 3.0 * s * s + 3.0 * s + 1.0) / 6.0, s * s * s / 6.0}};
}

// A spline's sums (depth,) at a place in its grid (rows, columns, depth).
template <int DEPTH>
INLINED void spline_at(const double* grid, size_t columns, const Weights& down, const Weights& across, double* sums) {
    for (int d = 0; d < DEPTH; ++d) sums[d] = 0.0;
    for (int k = 0; k < 4; ++k)
        for (int m = 0; m < 4; ++m) {
            const double weight = down.of[k] * across.of[m];
            const double* node = grid + ((down.node + k) * columns + across.node + m) * DEPTH;
            for (int d = 0; d < DEPTH; ++d) sums[d] += weight * node[d];
        }
}

nb::tuple pixels_from_grid(In<double, -1, -1, 2> grid, In<double, 2> origin, In<double, 2> step, Places pixels) {
    const size_t rows = grid.shape(0), columns = grid.shape(1), n = pixels.shape(0);
    require(rows >= 4 && columns >= 4, "a cubic spline has at least four nodes a side");
    Out<double> result({n, 2});
    bool beyond = false;
    {
        nb::gil_scoped_release unlocked;
        for (size_t i = 0; i < n; ++i) {
            const double x = pixels.data()[2 * i], y = pixels.data()[2 * i + 1];
            const double across = (x - origin.data()[0]) / step.data()[0] - 1.0;
            const double down = (y - origin.data()[1]) / step.data()[1] - 1.0;
            double* to = result.data + 2 * i;
            if (std::isnan(across) || std::isnan(down)) {
                to[0] = to[1] = NOT_A_NUMBER;
            } else if (!(0.0 <= across && across < columns - 3.0 && 0.0 <= down && down < rows - 3.0)) {
                to[0] = INFINITY, beyond = true;
            } else {
                double shift[2];
                spline_at<2>(grid.data(), columns, spline_weights(down, rows - 4.0),
                             spline_weights(across, columns - 4.0), shift);
                to[0] = x - shift[0], to[1] = y - shift[1];
            }
        }
    }
    return nb::make_tuple(result.array(), beyond);
}

// Splines in polar coordinates, by the radius or by the angle off the axis: rings -1 … n and spokes -1 … m + 1 of a grid (n + 2, m + 3).
struct Polar {
    const double* grid;
    size_t columns;
    double rings, spokes, per_unit;

    template <typename Grid>
    Polar(const Grid& of, double rings_per_unit)
        : grid(of.data()), columns(of.shape(1)), rings(of.shape(0) - 2.0), spokes(of.shape(1) - 3.0),
          per_unit(rings_per_unit) {
        require(of.shape(0) >= 4 && of.shape(1) >= 4, "a cubic spline has at least four nodes a side");
    }

    // The sums at a ring and a turn in radians.
    template <int DEPTH>
    void at(double ring, double turn, double* sums) const {
        const double spoke = turn * (spokes / (4.0 * RIGHT_ANGLE));
        spline_at<DEPTH>(grid, columns, spline_weights(ring, rings - 2.0),
                         spline_weights(spoke < 0.0 ? spoke + spokes : spoke, spokes - 1.0), sums);
    }

    // The sums at a pixel, the decentering taken out to first order.
    template <int DEPTH>
    void at(const Constants& constants, double x, double y, double* sums) const {
        double x_hat, y_hat, shift_x, shift_y;
        calibrated(constants, x, y, x_hat, y_hat);
        decentering(constants, x_hat, y_hat, shift_x, shift_y);
        x_hat -= shift_x, y_hat -= shift_y;
        at<DEPTH>(std::min(std::sqrt(x_hat * x_hat + y_hat * y_hat) * per_unit, rings - 1.0),
                  std::atan2(y_hat, x_hat), sums);
    }
};

// The angle off the optical axis and the turn about it of a direction, in radians.
struct AboutAxis {
    double angle, turn;
    AboutAxis(const double* to_camera, const double* direction) {
        double ray[3];
        for (int k = 0; k < 3; ++k)
            ray[k] = to_camera[3 * k] * direction[0] + to_camera[3 * k + 1] * direction[1] +
                     to_camera[3 * k + 2] * direction[2];
        angle = std::atan2(std::sqrt(ray[0] * ray[0] + ray[1] * ray[1]), ray[2]);
        turn = std::atan2(ray[1], ray[0]);
    }
};

struct Size {
    double width, height;
    double holds(double x, double y) const {
        return -0.5 <= x && x <= width - 0.5 && -0.5 <= y && y <= height - 0.5 ? 1.0 : 0.0;
    }
};

Result back_projected(Rotation rotation, Matrix sheet, Numbers slope, double rings_per_radian, double width,
                      double height, Places pixels, Vectors directions) {
    constexpr double DEGREES = 90.0 / RIGHT_ANGLE;
    const size_t n = pixels.shape(0);
    require(directions.shape(0) == n, "not as many directions as pixels");
    require(slope.shape(0) == sheet.shape(0), "not as many slopes as rings");
    const Polar polar(sheet, rings_per_radian);
    Out<double> result({n, 7});
    {
        nb::gil_scoped_release unlocked;
        for (size_t i = 0; i < n; ++i) {
            const double x = pixels.data()[2 * i], y = pixels.data()[2 * i + 1], *of = directions.data() + 3 * i;
            double* to = result.data + 7 * i;
            if (std::isnan(of[2]) || std::isnan(x) || std::isnan(y)) {
                std::fill_n(to, 6, NOT_A_NUMBER);
                to[6] = 0.0;
                continue;
            }
            const AboutAxis place(rotation.data(), of);
            const double ring = std::min(place.angle * rings_per_radian, polar.rings - 1.0);
            double log_sigma, stretch = 0.0;
            polar.at<1>(ring, place.turn, &log_sigma);
            const Weights along = spline_weights(ring, polar.rings - 2.0);
            for (int k = 0; k < 4; ++k) stretch += along.of[k] * slope.data()[along.node + k];
            const double azimuth = std::atan2(of[0], of[1]) * DEGREES;
            to[0] = std::atan2(std::sqrt(of[0] * of[0] + of[1] * of[1]), of[2]) * DEGREES;
            to[1] = azimuth >= 0.0 ? azimuth : std::fmod(azimuth + 360.0, 360.0);
            std::copy_n(of, 3, to + 2);
            to[5] = std::exp(log_sigma) / stretch, to[6] = Size{width, height}.holds(x, y);
        }
    }
    return result.array();
}

Result projected(Rotation rotation, In<double, -1, -1, 3> sheets, double rings_per_radian, double width, double height,
                 Places pixels, Vectors directions) {
    const size_t n = pixels.shape(0);
    require(directions.shape(0) == n, "not as many directions as pixels");
    const Polar polar(sheets, rings_per_radian);
    Out<double> result({n, 7});
    {
        nb::gil_scoped_release unlocked;
        for (size_t i = 0; i < n; ++i) {
            const double x = pixels.data()[2 * i], y = pixels.data()[2 * i + 1];
            double* to = result.data + 7 * i;
            if (std::isnan(x) || std::isnan(y)) {
                std::fill_n(to, 6, NOT_A_NUMBER);
                to[6] = 0.0;
                continue;
            }
            const AboutAxis place(rotation.data(), directions.data() + 3 * i);
            double factor[3];  // of the covariance, by Cholesky: log xx, yx / xx, log yy; then xx, yx, yy
            polar.at<3>(std::min(place.angle * rings_per_radian, polar.rings - 1.0), place.turn, factor);
            factor[0] = std::exp(factor[0]), factor[1] *= factor[0], factor[2] = std::exp(factor[2]);
            to[0] = x, to[1] = y;
            to[3] = factor[0] * factor[0], to[4] = factor[0] * factor[1];
            to[5] = factor[1] * factor[1] + factor[2] * factor[2];
            to[2] = std::sqrt(0.5 * (to[3] + to[5])), to[6] = Size{width, height}.holds(x, y);
        }
    }
    return result.array();
}

Result polar_values(ConstantNumbers constants, In<double, -1, -1, 2> sheets, double rings_per_radius, Places pixels) {
    const Polar polar(sheets, rings_per_radius);
    Out<double> result({pixels.shape(0), 2});
    {
        nb::gil_scoped_release unlocked;
        const Constants c = constants_of(constants);
        for (size_t i = 0; i < pixels.shape(0); ++i) {
            const double x = pixels.data()[2 * i], y = pixels.data()[2 * i + 1];
            double* to = result.data + 2 * i;
            if (std::isnan(x) || std::isnan(y))
                to[0] = to[1] = NOT_A_NUMBER;
            else
                polar.at<2>(c, x, y, to);
        }
    }
    return result.array();
}

}  // namespace

void add_tables(nb::module_& module) {
    module.def("directions_from_table", &directions_from_table, named("constants"), named("rotation"), named("table"),
               nb::arg("rounds"), named("pixels"));
    module.def("pixels_from_grid", &pixels_from_grid, named("grid"), named("origin"), named("step"), named("pixels"));
    module.def("back_projected", &back_projected, named("rotation"), named("sheet"), named("slope"),
               nb::arg("rings_per_radian"), nb::arg("width"), nb::arg("height"), named("pixels"), named("directions"));
    module.def("projected", &projected, named("rotation"), named("sheets"), nb::arg("rings_per_radian"),
               nb::arg("width"), nb::arg("height"), named("pixels"), named("directions"));
    module.def("polar_values", &polar_values, named("constants"), named("sheets"), nb::arg("rings_per_radius"),
               named("pixels"));
}

}  // namespace sunarc
