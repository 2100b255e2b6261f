#include "lens.h"

#include <algorithm>
#include <cstring>

namespace sunarc {

namespace {

constexpr double ON_AXIS = 1e-12;
constexpr double NOT_A_NUMBER = __builtin_nan("");

// The lens's numbers as they enter the pixel: of a mirrored image the signs of x are turned round.
struct Lens {
    double sign, ax, ay, skew, x0, y0;
    double k[RADIALS], p1, p2, p3, p4;

    Lens(const double* vector, double mirror)
        : sign(mirror >= 0.0 ? -1.0 : 1.0), ax(sign * vector[FX]), ay(vector[FY]), skew(sign * vector[SKEW]),
          x0((mirror >= 0.0 ? mirror : 0.0) + sign * vector[X0]), y0(vector[Y0]), p1(vector[DECENTERING]),
          p2(vector[DECENTERING + 1]), p3(vector[DECENTERING + 2]), p4(vector[DECENTERING + 3]) {
        std::copy_n(vector + RADIAL, RADIALS, k);
    }
};

INLINED void place(const double* translation, const double* rotation, const double* directions, size_t n, Block& b) {
    for (int i = 0; i < BLOCK; ++i) {
        const double* of = directions + 3 * std::min<size_t>(i, n - 1);
        b.east[i] = of[0], b.north[i] = of[1], b.up[i] = of[2];
    }
    double* targets[3] = {b.x, b.y, b.z};
    for (int row = 0; row < 3; ++row) {
        const double by_e = rotation[3 * row], by_n = rotation[3 * row + 1], by_u = rotation[3 * row + 2];
        const double shift = translation[row];
        double* target = targets[row];
#pragma omp simd
        for (int i = 0; i < BLOCK; ++i) target[i] = by_e * b.east[i] + by_n * b.north[i] + by_u * b.up[i] + shift;
    }
}

// atan(t) / t by powers of t² up to t = tan(pi / 8), to 1e-16: Chebyshev's interpolation of degree 13.
constexpr double ARCTANGENT[] = {1.000000000000004,     -0.3333333333373617,  0.20000000087291692, -0.14285722637914194,
                                 0.11111552128379867,   -0.09105215348635907, 0.07995068649310043, -0.1098913496718915,
                                 0.481231864693773,     -2.8708012035868613,  12.597895270496196,  -35.440188782223075,
                                 56.53451539482917,     -38.13466074637002};

// The angle off the axis, the tangent of its half, and the azimuth's cosine and sine.
INLINED void write_angles(Block& b) {
#pragma omp simd
    for (int i = 0; i < BLOCK; ++i) {
        const double x = b.x[i], y = b.y[i], z = b.z[i], flat = x * x + y * y;
        const double square = flat + z * z, across = std::sqrt(flat);
        const double acute = across / (std::sqrt(square) + std::fabs(z));
        const double quarter = acute / (1.0 + std::sqrt(1.0 + acute * acute)), argument = quarter * quarter;
        double total = 0.0;
        for (int n = 13; n >= 0; --n) total = total * argument + ARCTANGENT[n];
        const double angle = 4.0 * quarter * total;
        b.theta[i] = z >= 0.0 ? angle : 2.0 * RIGHT_ANGLE - angle;
        b.half[i] = z >= 0.0 ? acute : 1.0 / acute;
        b.across[i] = across, b.square[i] = square;
        const bool off_axis = across > ON_AXIS;
        b.u[i] = off_axis ? x / across : 1.0;
        b.v[i] = off_axis ? y / across : 0.0;
    }
}

// The ideal radius, in focal lengths, and its derivative by the angle.
INLINED void write_ideal(int code, Block& b) {
    switch (code) {
    case PERSPECTIVE:
#pragma omp simd
        for (int i = 0; i < BLOCK; ++i)
            b.radius[i] = b.across[i] / b.z[i], b.slope[i] = b.square[i] / (b.z[i] * b.z[i]);
        break;
    case EQUIDISTANT:
#pragma omp simd
        for (int i = 0; i < BLOCK; ++i) b.radius[i] = b.theta[i], b.slope[i] = 1.0;
        break;
    case EQUISOLID:
#pragma omp simd
        for (int i = 0; i < BLOCK; ++i) {
            const double cosine = 1.0 / std::sqrt(1.0 + b.half[i] * b.half[i]);
            b.radius[i] = 2.0 * b.half[i] * cosine, b.slope[i] = cosine;
        }
        break;
    case STEREOGRAPHIC:
#pragma omp simd
        for (int i = 0; i < BLOCK; ++i) b.radius[i] = 2.0 * b.half[i], b.slope[i] = 1.0 + b.half[i] * b.half[i];
        break;
    default:  // ORTHOGRAPHIC: `require_projection` has refused any other
#pragma omp simd
        for (int i = 0; i < BLOCK; ++i) {
            const double per_length = 1.0 / std::sqrt(b.square[i]);
            b.radius[i] = b.across[i] * per_length, b.slope[i] = b.z[i] * per_length;
        }
    }
}

// Eq. 9's polynomial, the decentering's profile and bracket, x̂, ŷ and their slopes by r̂.
INLINED void distort(const Lens& l, Block& b) {
    const double k2 = l.k[0], k3 = l.k[1], k4 = l.k[2], k5 = l.k[3], k6 = l.k[4], k7 = l.k[5], k8 = l.k[6], k9 = l.k[7];
#pragma omp simd
    for (int i = 0; i < BLOCK; ++i) {
        const double tau = b.theta[i] / RIGHT_ANGLE;
        const double value = k2 + tau * (k3 + tau * (k4 + tau * (k5 + tau * (k6 + tau * (k7 + tau * (k8 + tau * k9))))));
        const double last = 6.0 * k6 + tau * (7.0 * k7 + tau * (8.0 * k8 + tau * 9.0 * k9));
        const double rise = 2.0 * k2 + tau * (3.0 * k3 + tau * (4.0 * k4 + tau * (5.0 * k5 + tau * last)));
        const double radius = b.radius[i] + tau * tau * value;
        b.radius[i] = radius;
        b.slope[i] += tau * rise / RIGHT_ANGLE;
        const double u = b.u[i], v = b.v[i], square = radius * radius;
        const double bx = l.p1 * (1.0 + 2.0 * u * u) + 2.0 * l.p2 * u * v;
        const double by = 2.0 * l.p1 * u * v + l.p2 * (1.0 + 2.0 * v * v);
        const double profile = square * (1.0 + square * (l.p3 + square * l.p4));
        b.x_hat[i] = radius * u + profile * bx, b.y_hat[i] = radius * v + profile * by;
        const double growth = radius * (2.0 + square * (4.0 * l.p3 + square * 6.0 * l.p4));
        b.profile[i] = profile, b.bx[i] = bx, b.by[i] = by;
        b.gx[i] = u + growth * bx, b.gy[i] = v + growth * by;
    }
}

INLINED void pixels_of_block(const Lens& l, Optics optics, const double* translation, const double* rotation,
                             const double* directions, size_t n, Block& b) {
    place(translation, rotation, directions, n, b);
    write_angles(b);
    write_ideal(optics.code, b);
    distort(l, b);
#pragma omp simd
    for (int i = 0; i < BLOCK; ++i) {
        const bool shown = b.theta[i] <= optics.max_angle;
        const double x = l.ax * b.x_hat[i] + l.skew * b.y_hat[i] + l.x0, y = l.ay * b.y_hat[i] + l.y0;
        b.pixel[0][i] = shown ? x : NOT_A_NUMBER;
        b.pixel[1][i] = shown ? y : NOT_A_NUMBER;
    }
}

// The derivatives by K, k and p.
INLINED void write_lens(const Lens& l, Block& b) {
    auto& c = b.columns;
#pragma omp simd
    for (int i = 0; i < BLOCK; ++i) {
        c[FX][0][i] = l.sign * b.x_hat[i], c[FX][1][i] = 0.0;
        c[FY][0][i] = 0.0, c[FY][1][i] = b.y_hat[i];
        c[SKEW][0][i] = l.sign * b.y_hat[i], c[SKEW][1][i] = 0.0;
        c[X0][0][i] = l.sign, c[X0][1][i] = 0.0;
        c[Y0][0][i] = 0.0, c[Y0][1][i] = 1.0;
    }
#pragma omp simd
    for (int i = 0; i < BLOCK; ++i) {
        const double tau = b.theta[i] / RIGHT_ANGLE;
        double along = tau * tau * (l.ax * b.gx[i] + l.skew * b.gy[i]), down = tau * tau * l.ay * b.gy[i];
        for (int k = 0; k < RADIALS; ++k) {
            c[5 + k][0][i] = along, c[5 + k][1][i] = down;
            along *= tau, down *= tau;
        }
    }
#pragma omp simd
    for (int i = 0; i < BLOCK; ++i) {
        const double radius = b.radius[i], u = b.u[i], v = b.v[i], profile = b.profile[i];
        const double both = profile * 2.0 * u * v, first = profile * (1.0 + 2.0 * u * u);
        const double second = profile * (1.0 + 2.0 * v * v), square = radius * radius;
        c[13][0][i] = l.ax * first + l.skew * both, c[13][1][i] = l.ay * both;
        c[14][0][i] = l.ax * both + l.skew * second, c[14][1][i] = l.ay * second;
        const double along = square * square * (l.ax * b.bx[i] + l.skew * b.by[i]);
        const double down = square * square * l.ay * b.by[i];
        c[15][0][i] = along, c[15][1][i] = down;
        c[16][0][i] = square * along, c[16][1][i] = square * down;
    }
}

// The derivatives by the vector in the camera's frame, which are those by the translation.
INLINED void write_vector(const Lens& l, Block& b) {
    auto& c = b.columns;
#pragma omp simd
    for (int i = 0; i < BLOCK; ++i) {
        const double z = b.z[i], across = b.across[i], slope = b.slope[i], u = b.u[i], v = b.v[i];
        const double gx = b.gx[i], gy = b.gy[i];
        const bool on_axis = across <= ON_AXIS;
        const double per_norm = on_axis ? slope / z : b.radius[i] / across;
        const double twist = on_axis ? 0.0 : b.profile[i] / across;
        const double sin2 = 2.0 * u * v, cos2 = u * u - v * v;
        const double hx = -v * per_norm + twist * (-2.0 * l.p1 * sin2 + 2.0 * l.p2 * cos2);
        const double hy = u * per_norm + twist * (2.0 * l.p1 * cos2 + 2.0 * l.p2 * sin2);
        const double tilt = slope / b.square[i], by_x = tilt * z * u, by_y = tilt * z * v, by_z = -tilt * across;
        const double cx = gx * by_x - hx * v, cy = gy * by_x - hy * v, dx = gx * by_y + hx * u, dy = gy * by_y + hy * u;
        c[21][0][i] = l.ax * cx + l.skew * cy, c[21][1][i] = l.ay * cy;
        c[22][0][i] = l.ax * dx + l.skew * dy, c[22][1][i] = l.ay * dy;
        c[23][0][i] = (l.ax * gx + l.skew * gy) * by_z, c[23][1][i] = l.ay * gy * by_z;
    }
}

// The derivatives by the rotation vector: d(R w) = R (J dr × w).
INLINED void write_pose(const double* r, const double* j, Block& b) {
    for (int axis = 0; axis < 2; ++axis) {
        const double *by_x = b.columns[21][axis], *by_y = b.columns[22][axis], *by_z = b.columns[23][axis];
        double *first = b.columns[17][axis], *second = b.columns[18][axis], *third = b.columns[19][axis];
#pragma omp simd
        for (int i = 0; i < BLOCK; ++i) {
            const double vx = by_x[i], vy = by_y[i], vz = by_z[i], e = b.east[i], north = b.north[i], up = b.up[i];
            const double wx = vx * r[0] + vy * r[3] + vz * r[6], wy = vx * r[1] + vy * r[4] + vz * r[7];
            const double wz = vx * r[2] + vy * r[5] + vz * r[8];
            const double mx = north * wz - up * wy, my = up * wx - e * wz, mz = e * wy - north * wx;
            first[i] = mx * j[0] + my * j[3] + mz * j[6];
            second[i] = mx * j[1] + my * j[4] + mz * j[7];
            third[i] = mx * j[2] + my * j[5] + mz * j[8];
        }
    }
}

// 0 for the derivatives where there is no finite pixel.
INLINED void blank(Block& b) {
    for (int i = 0; i < BLOCK; ++i) {
        if (std::fabs(b.pixel[0][i]) + std::fabs(b.pixel[1][i]) < INFINITY) continue;
        for (auto& column : b.columns) column[0][i] = column[1][i] = 0.0;
    }
}

void take_pixels(const Block& block, size_t n, double* pixels) {
    for (size_t i = 0; i < n; ++i) pixels[2 * i] = block.pixel[0][i], pixels[2 * i + 1] = block.pixel[1][i];
}

Result pixels_of(In<double, PARAMETERS> vector, int code, double mirror, double max_angle, Rotation rotation,
                 Vectors directions) {
    require_projection(code);
    const size_t n = directions.shape(0);
    Out<double> pixels({n, 2});
    {
        nb::gil_scoped_release unlocked;
        auto block = std::make_unique<Block>();
        for (size_t begin = 0; begin < n; begin += BLOCK) {
            const size_t size = std::min<size_t>(BLOCK, n - begin);
            write_pixels(vector.data(), {code, mirror, max_angle}, rotation.data(), directions.data() + 3 * begin, size,
                         *block);
            take_pixels(*block, size, pixels.data + 2 * begin);
        }
    }
    return pixels.array();
}

nb::tuple pixels_and_rows_of(In<double, PARAMETERS> vector, int code, double mirror, double max_angle,
                             Rotation rotation, Rotation jacobian, Vectors directions) {
    require_projection(code);
    const size_t n = directions.shape(0);
    Out<double> pixels({n, 2}), rows({n, 2, PARAMETERS});
    {
        nb::gil_scoped_release unlocked;
        auto block = std::make_unique<Block>();
        for (size_t begin = 0; begin < n; begin += BLOCK) {
            const size_t size = std::min<size_t>(BLOCK, n - begin);
            write_block(vector.data(), {code, mirror, max_angle}, rotation.data(), jacobian.data(),
                        directions.data() + 3 * begin, size, *block);
            take_pixels(*block, size, pixels.data + 2 * begin);
            for (size_t i = 0; i < size; ++i)
                for (int c = 0; c < 2; ++c) {
                    double* row = rows.data + (2 * (begin + i) + c) * PARAMETERS;
                    for (int k = 0; k < N_COLUMNS; ++k)
                        if (k != RESIDUAL) row[PARAMETER_OF[k]] = block->columns[k][c][i];
                }
        }
    }
    return nb::make_tuple(pixels.array(), rows.array());
}

nb::tuple rotation_and_jacobian(In<double, 3> vector) {
    Out<double> rotation({3, 3}), jacobian({3, 3});
    write_rotation(vector.data(), rotation.data, jacobian.data);
    return nb::make_tuple(rotation.array(), jacobian.array());
}

}  // namespace

void require_projection(int code) {
    require(code >= 0 && code < PROJECTIONS, "no projection has this code");
}

DISPATCHED void write_pixels(const double* vector, Optics optics, const double* rotation, const double* directions,
                             size_t n, Block& block) {
    pixels_of_block(Lens(vector, optics.mirror), optics, vector + TRANSLATION, rotation, directions, n, block);
}

DISPATCHED void write_block(const double* vector, Optics optics, const double* rotation, const double* jacobian,
                            const double* directions, size_t n, Block& block) {
    const Lens lens(vector, optics.mirror);
    pixels_of_block(lens, optics, vector + TRANSLATION, rotation, directions, n, block);
    write_lens(lens, block);
    write_vector(lens, block);
    write_pose(rotation, jacobian, block);
    blank(block);
}

void write_rotation(const double* w, double* rotation, double* jacobian) {
    constexpr double SMALL_ANGLE = 1e-3;  // rad; below it the first term left out of the series is 1e-14
    const double square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2], angle = std::sqrt(square);
    double first, second, third;
    if (angle < SMALL_ANGLE) {  // series: the quotients lose their digits near 0
        first = 1.0 - square / 6.0, second = 0.5 - square / 24.0, third = 1.0 / 6.0 - square / 120.0;
    } else {
        first = std::sin(angle) / angle, second = (1.0 - std::cos(angle)) / square, third = (1.0 - first) / square;
    }
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            const double same = i == j ? 1.0 : 0.0, twice = w[i] * w[j] - same * square;  // square of the skew matrix
            rotation[3 * i + j] = same + second * twice;
            jacobian[3 * i + j] = same + third * twice;
        }
    for (int i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        rotation[3 * i + j] -= first * w[k], rotation[3 * j + i] += first * w[k];
        jacobian[3 * i + j] += second * w[k], jacobian[3 * j + i] -= second * w[k];
    }
}

void add_lens(nb::module_& module) {
    module.def("pixels_of", &pixels_of, named("vector"), nb::arg("code"), nb::arg("mirror"), nb::arg("max_angle"),
               named("rotation"), named("directions"));
    module.def("pixels_and_rows_of", &pixels_and_rows_of, named("vector"), nb::arg("code"), nb::arg("mirror"),
               nb::arg("max_angle"), named("rotation"), named("jacobian"), named("directions"));
    module.def("rotation_and_jacobian", &rotation_and_jacobian, named("vector"));
}

}  // namespace sunarc
