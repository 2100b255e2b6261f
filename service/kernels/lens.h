// The lens: directions to pixels and their derivatives, a block of directions at a time.
#pragma once

#include <cmath>
#include <cstddef>

#include "arrays.h"

namespace sunarc {

constexpr int BLOCK = 64;  // directions: their numbers stay within the processor's first cache
constexpr double RIGHT_ANGLE = 1.57079632679489661923;

// Place of each parameter in the paper's beta, as sunarc.optics.camera.Param has it.
enum Parameter { FX, FY, SKEW, X0, Y0, ROTATION, TRANSLATION = 8, RADIAL = 11, DECENTERING = 19, PARAMETERS = 23 };
constexpr int RADIALS = 8;

// As sunarc.optics.projections.PROJECTIONS numbers them.
enum Projection { PERSPECTIVE, EQUIDISTANT, EQUISOLID, STEREOGRAPHIC, ORTHOGRAPHIC, PROJECTIONS };

// Columns of a block: derivatives by the lens, by the pose, the residuals' place, and those by the translation.
constexpr int N_LENS = 17, N_NATIVE = 20, RESIDUAL = 20, N_COLUMNS = 24;
// The parameter of each column; -1: the residuals'.
constexpr int PARAMETER_OF[N_COLUMNS] = {0,  1,  2,  3,  4,  11, 12, 13, 14, 15, 16, 17,
                                         18, 19, 20, 21, 22, 5,  6,  7,  -1, 8,  9,  10};

// What the loops take of a camera beside its parameters: sunarc.optics.kernels.Optics.
struct Optics {
    int code;
    double mirror;     // width - 1 of a mirrored image, negative for one that is not
    double max_angle;  // rad off the axis up to which it shows anything
};

// Numbers of a block's directions, one array of them each, so that no two overlap.
struct alignas(64) Block {
    double columns[N_COLUMNS][2][BLOCK];  // derivatives of x, then of y
    double pixel[2][BLOCK];
    double east[BLOCK], north[BLOCK], up[BLOCK];
    double x[BLOCK], y[BLOCK], z[BLOCK], across[BLOCK], square[BLOCK], half[BLOCK], theta[BLOCK];
    double radius[BLOCK], slope[BLOCK], u[BLOCK], v[BLOCK], profile[BLOCK], bx[BLOCK], by[BLOCK];
    double gx[BLOCK], gy[BLOCK], x_hat[BLOCK], y_hat[BLOCK], weight[BLOCK];
};

void require_projection(int code);

// Rotation matrix (3, 3) and right Jacobian (3, 3) of a rotation vector (3,).
void write_rotation(const double* vector, double* rotation, double* jacobian);

// Pixels of n directions (n, 3), n from 1 to BLOCK; NaN where the lens shows nothing. Places beyond n repeat the last.
void write_pixels(const double* vector, Optics optics, const double* rotation, const double* directions, size_t n,
                  Block& block);

// The same, and the derivatives, 0 where there is no pixel. `jacobian`: right Jacobian of the rotation vector.
void write_block(const double* vector, Optics optics, const double* rotation, const double* jacobian,
                 const double* directions, size_t n, Block& block);

// The polynomial of Eq. 9 at an angle, rad, in focal lengths, and its derivative; `radial` (8,): k2 to k9.
INLINED void distortion_and_slope(const double* radial, double theta, double& distortion, double& slope) {
    const double tau = theta / RIGHT_ANGLE;
    double value = 0.0, derivative = 0.0;
    for (int i = RADIALS - 1; i >= 0; --i) {
        derivative = derivative * tau + value;
        value = value * tau + radial[i];
    }
    // value = sum of k_n tau^(n-2): the distortion is tau² value
    distortion = tau * tau * value;
    slope = (2.0 * tau * value + tau * tau * derivative) / RIGHT_ANGLE;
}

// Sine and cosine of half an angle from 0 to pi, to 2e-16, by series about its quarter: a loop over many runs in vector
// registers, which one that calls a library's does not.
INLINED void sine_and_cosine_of_half(double theta, double& sine, double& cosine) {
    constexpr double SINE[] = {1.0,
                               -1.0 / 6,
                               1.0 / 120,
                               -1.0 / 5040,
                               1.0 / 362880,
                               -1.0 / 39916800,
                               1.0 / 6227020800,
                               -1.0 / 1307674368000,
                               1.0 / 355687428096000};
    constexpr double COSINE[] = {1.0,           -1.0 / 2,        1.0 / 24,          -1.0 / 720,           1.0 / 40320,
                                 -1.0 / 3628800, 1.0 / 479001600, -1.0 / 87178291200, 1.0 / 20922789888000};
    constexpr double ROOT_HALF = 0.70710678118654752440;
    const double a = 0.5 * theta - 0.5 * RIGHT_ANGLE, square = a * a;
    double s = 0.0, c = 0.0;
    for (int n = 8; n >= 0; --n) {
        s = s * square + SINE[n];
        c = c * square + COSINE[n];
    }
    s *= a;
    sine = ROOT_HALF * (c + s);
    cosine = ROOT_HALF * (c - s);
}

void add_displacement(nb::module_& module);
void add_inverse(nb::module_& module);
void add_lens(nb::module_& module);
void add_tables(nb::module_& module);

}  // namespace sunarc
