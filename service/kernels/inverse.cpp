// The exact inverse of the lens: from pixels to directions.
//
// The forward model splits in two, so that its inverse is two small Newton iterations: in the plane for the decentering,
// then in one dimension for the angle.
#include <algorithm>

#include "lens.h"

namespace sunarc {

namespace {

constexpr int BATCH = 256;        // pixels taken together
constexpr int ITERATIONS = 30;    // of Newton's method, at most
constexpr double LAST_STEP = 1e-8;  // a step this small leaves an error of its square
constexpr int KNOTS = 257;  // of the table that the angle's steps begin at: it leaves 1e-11 of an angle

// Radius of Eq. 9 at an angle, in focal lengths, and its derivative.
INLINED void radius_and_slope(int code, const double* radial, double theta, double& radius, double& slope) {
    constexpr double SHAPES[PROJECTIONS] = {1.0, 0.0, -0.5, 0.5, -1.0};  // of sunarc.optics.projections, by code
    const double shape = SHAPES[code];
    if (shape > 0.0) {
        const double cosine = std::cos(shape * theta);
        radius = std::tan(shape * theta) / shape, slope = 1.0 / (cosine * cosine);
    } else if (shape < 0.0) {
        radius = std::sin(shape * theta) / shape, slope = std::cos(shape * theta);
    } else {
        radius = theta, slope = 1.0;
    }
    double distortion, rise;
    distortion_and_slope(radial, theta, distortion, rise);
    radius += distortion, slope += rise;
}

// Replace points, in focal lengths, by those q with q + shift(q) at them: Eq. 12 taken out.
INLINED void remove_decentering(const double* p, double* __restrict x_hat, double* __restrict y_hat, int n) {
    const double p1 = p[0], p2 = p[1], p3 = p[2], p4 = p[3];
    double x[BATCH], y[BATCH];
    std::copy_n(x_hat, n, x), std::copy_n(y_hat, n, y);
    for (int round = 0; round < ITERATIONS; ++round) {
        int moving = 0;
#pragma omp simd reduction(+ : moving)
        for (int i = 0; i < n; ++i) {
            const double px = x[i], py = y[i], xx = px * px, yy = py * py, xy = 2.0 * px * py, square = xx + yy;
            const double profile = 1.0 + square * (p3 + square * p4), rise = 2.0 * (p3 + 2.0 * square * p4);
            const double a = p1 * (square + 2.0 * xx) + p2 * xy, b = p1 * xy + p2 * (square + 2.0 * yy);
            const double both = 2.0 * (p1 * py + p2 * px);
            const double jxx = 1.0 + rise * px * a + profile * (6.0 * p1 * px + 2.0 * p2 * py);
            const double jyy = 1.0 + rise * py * b + profile * (2.0 * p1 * px + 6.0 * p2 * py);
            const double jxy = rise * py * a + profile * both, jyx = rise * px * b + profile * both;
            const double fx = px + profile * a - x_hat[i], fy = py + profile * b - y_hat[i];
            const double per_determinant = 1.0 / (jxx * jyy - jxy * jyx);
            const double dx = (jyy * fx - jxy * fy) * per_determinant, dy = (jxx * fy - jyx * fx) * per_determinant;
            x[i] = px - dx, y[i] = py - dy;
            moving += std::fabs(dx) + std::fabs(dy) > LAST_STEP;
        }
        if (moving == 0) break;
    }
    std::copy_n(x, n, x_hat), std::copy_n(y, n, y_hat);
}

// The angle at a share, 0 to 1, of the largest radius from the table's cubic pieces.
INLINED double first_angle(const double* table, double share) {
    const double position = share > 0.0 ? share * (KNOTS - 1) : 0.0;  // 0 for NaN, too
    const int piece = std::min(static_cast<int>(position), KNOTS - 2);
    const double s = position - piece, low = table[2 * piece], high = table[2 * piece + 2], rise = high - low;
    const double first = table[2 * piece + 1], second = table[2 * piece + 3];
    const double angle = low + s * (first + s * (3.0 * rise - 2.0 * first - second + s * (first + second - 2.0 * rise)));
    // where the lens hardly rises the slopes are no help
    return low <= angle && angle <= high ? angle : low + s * rise;
}

// One step of Newton's method for the angles, their sines and cosines after it; return how many moved.
template <int CODE>
INLINED int step_angles(const double* radial, double limit, const double* __restrict radius, double* __restrict theta,
                        double* __restrict sine, double* __restrict cosine, int n) {
    int moving = 0;
#pragma omp simd reduction(+ : moving)
    for (int i = 0; i < n; ++i) {
        double s, c, ideal, slope;
        sine_and_cosine_of_half(theta[i], s, c);
        const double whole = 2.0 * s * c, across = 1.0 - 2.0 * s * s;
        if constexpr (CODE == PERSPECTIVE) ideal = whole / across, slope = 1.0 / (across * across);
        if constexpr (CODE == EQUIDISTANT) ideal = theta[i], slope = 1.0;
        if constexpr (CODE == EQUISOLID) ideal = 2.0 * s, slope = c;
        if constexpr (CODE == STEREOGRAPHIC) ideal = 2.0 * s / c, slope = 1.0 / (c * c);
        if constexpr (CODE == ORTHOGRAPHIC) ideal = whole, slope = across;
        double distortion, rise;
        distortion_and_slope(radial, theta[i], distortion, rise);
        const double next = theta[i] - (ideal + distortion - radius[i]) / (slope + rise);
        const double after = std::min(std::max(next, 0.0), limit), step = after - theta[i];
        // a last step is so small that its square does not matter
        sine[i] = whole + step * across, cosine[i] = across - step * whole;
        theta[i] = after;
        moving += std::fabs(step) > LAST_STEP;
    }
    return moving;
}

struct InverseLens {
    int code;
    double mirror;
    const double *plane, *radial, *decentering, *table;
};

template <int CODE>
INLINED void directions_of_batch(const InverseLens& lens, double edge, const double* r, const double* pixels, int n,
                                 double* result) {
    const double fx = lens.plane[0], fy = lens.plane[1], skew = lens.plane[2], x0 = lens.plane[3], y0 = lens.plane[4];
    double x[BATCH], y[BATCH], radius[BATCH], theta[BATCH], sine[BATCH], cosine[BATCH];
    for (int k = 0; k < n; ++k) {
        const double column = lens.mirror >= 0.0 ? lens.mirror - pixels[2 * k] : pixels[2 * k];
        y[k] = (pixels[2 * k + 1] - y0) / fy;
        x[k] = (column - x0 - skew * y[k]) / fx;
    }
    if (lens.decentering[0] != 0.0 || lens.decentering[1] != 0.0) remove_decentering(lens.decentering, x, y, n);
    for (int k = 0; k < n; ++k) {
        radius[k] = std::sqrt(x[k] * x[k] + y[k] * y[k]);
        // no direction, and nothing to wait for
        if (!(radius[k] <= edge * (1.0 + 1e-12))) x[k] = __builtin_nan(""), radius[k] = 0.0;
        theta[k] = first_angle(lens.table, std::min(radius[k] / edge, 1.0));
    }
    const double limit = lens.table[2 * (KNOTS - 1)];
    for (int round = 0; round < ITERATIONS; ++round)
        if (step_angles<CODE>(lens.radial, limit, radius, theta, sine, cosine, n) == 0) break;
    for (int k = 0; k < n; ++k) {
        const double scale = sine[k] / std::max(radius[k], 1e-300);
        const double across = scale * x[k], down = scale * y[k], along = cosine[k] + 0.0 * x[k];
        for (int c = 0; c < 3; ++c) result[3 * k + c] = r[c] * across + r[3 + c] * down + r[6 + c] * along;
    }
}

DISPATCHED void write_directions(const InverseLens& lens, const double* rotation, const double* pixels, size_t n,
                                 double* result) {
    double edge, slope;
    radius_and_slope(lens.code, lens.radial, lens.table[2 * (KNOTS - 1)], edge, slope);
    for (size_t begin = 0; begin < n; begin += BATCH) {
        const int size = static_cast<int>(std::min<size_t>(BATCH, n - begin));
        const double* from = pixels + 2 * begin;
        double* to = result + 3 * begin;
        switch (lens.code) {
        case PERSPECTIVE: directions_of_batch<PERSPECTIVE>(lens, edge, rotation, from, size, to); break;
        case EQUIDISTANT: directions_of_batch<EQUIDISTANT>(lens, edge, rotation, from, size, to); break;
        case EQUISOLID: directions_of_batch<EQUISOLID>(lens, edge, rotation, from, size, to); break;
        case STEREOGRAPHIC: directions_of_batch<STEREOGRAPHIC>(lens, edge, rotation, from, size, to); break;
        default: directions_of_batch<ORTHOGRAPHIC>(lens, edge, rotation, from, size, to);
        }
    }
}

// Angles at radii spread evenly from 0 to that of the limit, and their slopes a piece.
void write_angle_table(int code, const double* radial, double limit, double* table) {
    double found, slope, theta = 0.0;
    radius_and_slope(code, radial, limit, found, slope);
    const double step = found / (KNOTS - 1);
    for (int k = 0; k < KNOTS; ++k) {
        for (int round = 0; round < ITERATIONS; ++round) {
            radius_and_slope(code, radial, theta, found, slope);
            const double after = std::min(std::max(theta - (found - k * step) / slope, 0.0), limit);
            const double moved = std::fabs(after - theta);
            theta = after;
            if (!(moved > LAST_STEP)) break;
        }
        table[2 * k] = theta, table[2 * k + 1] = slope > 0.0 ? step / slope : INFINITY;
    }
    table[2 * (KNOTS - 1)] = limit;
}

Result directions_of(int code, double mirror, double limit, In<double, 5> plane, In<double, RADIALS> radial,
                     In<double, 4> decentering, Rotation rotation, Places pixels) {
    require_projection(code);
    Out<double> result({pixels.shape(0), 3});
    {
        nb::gil_scoped_release unlocked;
        double table[2 * KNOTS];
        write_angle_table(code, radial.data(), limit, table);
        write_directions({code, mirror, plane.data(), radial.data(), decentering.data(), table}, rotation.data(),
                         pixels.data(), pixels.shape(0), result.data);
    }
    return result.array();
}

}  // namespace

void add_inverse(nb::module_& module) {
    module.def("directions_of", &directions_of, nb::arg("code"), nb::arg("mirror"), nb::arg("limit"), named("plane"),
               named("radial"), named("decentering"), named("rotation"), named("pixels"));
}

}  // namespace sunarc
