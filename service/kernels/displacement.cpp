// A smooth displacement of the image as sums of sine waves on a box: sunarc.optics.displacement.Displacement.
#include <algorithm>

#include "lens.h"

namespace sunarc {

namespace {

constexpr int BATCH = 128;  // pixels taken together
constexpr int ROUNDS = 60;
constexpr double TOLERANCE_PX = 1e-10;
constexpr double PI = 2.0 * RIGHT_ANGLE;

using Row = double[BATCH];

// Coefficients (2, nx, ny), px, of waves on a box: centre (x, y), half-widths (x, y), px.
struct Waves {
    const double *box, *coefficients;
    int nx, ny;
};

// The numbers of a batch: sines, and slopes by the pixel, of each order along x and y; 2 nx sums over y.
struct Room {
    std::unique_ptr<Row[]> rows;
    Row *sines_x, *sines_y, *slopes_x, *slopes_y, *sums;
    Row angles[2];
    double shift[2][BATCH], slopes[2][2][BATCH];  // last axis but one: the pixel's

    Room(int nx, int ny) : rows(new Row[4 * nx + 2 * ny]) {
        sines_x = rows.get(), slopes_x = sines_x + nx, sums = slopes_x + nx, sines_y = sums + 2 * nx;
        slopes_y = sines_y + ny;
        for (auto& row : angles) std::fill_n(row, BATCH, 0.0);
    }
};

// The angles of the lowest waves: 0 to pi within the box.
INLINED void write_angles(const double* box, const double* pixels, int n, Room& room) {
    for (int i = 0; i < n; ++i)
        for (int a = 0; a < 2; ++a)
            room.angles[a][i] = 0.5 * PI * ((pixels[2 * i + a] - box[a]) / box[2 + a] + 1.0);
}

// sin(k a), k = 1 … n: sin((k + 1) a) = 2 cos(a) sin(k a) - sin((k - 1) a).
INLINED void write_sines(const Row& angles, int n, Row* sines) {
    Row twice;
#pragma omp simd
    for (int i = 0; i < BATCH; ++i) {
        double sine, cosine;
        sine_and_cosine_of_half(angles[i], sine, cosine);
        sines[0][i] = 2.0 * sine * cosine, twice[i] = 2.0 - 4.0 * sine * sine;
    }
    for (int k = 1; k < n; ++k)
#pragma omp simd
        for (int i = 0; i < BATCH; ++i)
            sines[k][i] = twice[i] * sines[k - 1][i] - (k > 1 ? sines[k - 2][i] : 0.0);
}

// Their derivatives by the pixel: k cos(k a) times that of the angle.
INLINED void write_slopes(const Row& angles, double per_px, int n, Row* slopes) {
    Row twice;
#pragma omp simd
    for (int i = 0; i < BATCH; ++i) {
        double sine, cosine;
        sine_and_cosine_of_half(angles[i], sine, cosine);
        slopes[0][i] = 1.0 - 2.0 * sine * sine, twice[i] = 2.0 - 4.0 * sine * sine;
    }
    for (int k = 1; k < n; ++k)
#pragma omp simd
        for (int i = 0; i < BATCH; ++i)
            slopes[k][i] = twice[i] * slopes[k - 1][i] - (k > 1 ? slopes[k - 2][i] : 1.0);
    for (int k = 0; k < n; ++k)
#pragma omp simd
        for (int i = 0; i < BATCH; ++i) slopes[k][i] *= (k + 1) * per_px;
}

// Sums over the orders along y for each component and order along x; four rows of these at a time.
INLINED void add_along_y(const Waves& waves, const Row* along_y, Row* sums) {
    for (int j = 0; j < 2 * waves.nx; ++j) {
        const double* of = waves.coefficients + static_cast<size_t>(j) * waves.ny;
        Row total = {};
        for (int k = 0; k < waves.ny; ++k)
#pragma omp simd
            for (int i = 0; i < BATCH; ++i) total[i] += of[k] * along_y[k][i];
        std::copy_n(total, BATCH, sums[j]);
    }
}

INLINED void add_along_x(const Waves& waves, const Row* along_x, const Row* sums, double (*total)[BATCH]) {
    for (int c = 0; c < 2; ++c) {
        std::fill_n(total[c], BATCH, 0.0);
        for (int j = 0; j < waves.nx; ++j)
#pragma omp simd
            for (int i = 0; i < BATCH; ++i) total[c][i] += along_x[j][i] * sums[c * waves.nx + j][i];
    }
}

// 0 beyond the box, NaN at what is no pixel.
INLINED void keep_within(const Room& room, double (*total)[BATCH]) {
    for (int i = 0; i < BATCH; ++i) {
        const double x = room.angles[0][i], y = room.angles[1][i];
        if (std::isnan(x) || std::isnan(y))
            total[0][i] = total[1][i] = __builtin_nan("");
        else if (!(0.0 < x && x < PI && 0.0 < y && y < PI))
            total[0][i] = total[1][i] = 0.0;
    }
}

DISPATCHED void write_shift(const Waves& waves, const double* pixels, int n, Room& room) {
    write_angles(waves.box, pixels, n, room);
    write_sines(room.angles[0], waves.nx, room.sines_x);
    write_sines(room.angles[1], waves.ny, room.sines_y);
    add_along_y(waves, room.sines_y, room.sums);
    add_along_x(waves, room.sines_x, room.sums, room.shift);
    keep_within(room, room.shift);
}

// The shift, and its slopes.
DISPATCHED void write_shift_and_slopes(const Waves& waves, const double* pixels, int n, Room& room) {
    write_angles(waves.box, pixels, n, room);
    write_sines(room.angles[0], waves.nx, room.sines_x);
    write_sines(room.angles[1], waves.ny, room.sines_y);
    write_slopes(room.angles[0], 0.5 * PI / waves.box[2], waves.nx, room.slopes_x);
    write_slopes(room.angles[1], 0.5 * PI / waves.box[3], waves.ny, room.slopes_y);
    add_along_y(waves, room.sines_y, room.sums);
    add_along_x(waves, room.sines_x, room.sums, room.shift);
    add_along_x(waves, room.slopes_x, room.sums, room.slopes[0]);
    add_along_y(waves, room.slopes_y, room.sums);
    add_along_x(waves, room.sines_x, room.sums, room.slopes[1]);
    for (auto* total : {room.shift, room.slopes[0], room.slopes[1]}) keep_within(room, total);
}

// A step of Newton's method with each pixel that has not converged; return whether all have. `largest` is the size of
// the last step, px, and 0 where the pixel has converged.
bool step(const Room& room, const double* given, int n, double* found, double* largest) {
    bool all = true;
    for (int i = 0; i < n; ++i) {
        if (largest[i] == 0.0) continue;
        const double x = found[2 * i] + room.shift[0][i] - given[2 * i];
        const double y = found[2 * i + 1] + room.shift[1][i] - given[2 * i + 1];
        const double xx = 1.0 + room.slopes[0][0][i], xy = room.slopes[1][0][i];
        const double yx = room.slopes[0][1][i], yy = 1.0 + room.slopes[1][1][i];
        const double folded = xx * yy - xy * yx, determinant = folded == 0.0 ? __builtin_nan("") : folded;
        const double step_x = (yy * x - xy * y) / determinant, step_y = (xx * y - yx * x) / determinant;
        found[2 * i] -= step_x, found[2 * i + 1] -= step_y;
        const double size = std::fabs(step_x) >= std::fabs(step_y) ? std::fabs(step_x) : std::fabs(step_y);
        const double expected = largest[i] < INFINITY ? size * size / largest[i] : size;
        if (expected <= TOLERANCE_PX) {
            largest[i] = 0.0;
        } else {
            largest[i] = size;
            all = all && std::isnan(size);
        }
    }
    return all;
}

void write_inverse(const Waves& waves, const double* given, int n, Room& room, double* found) {
    double largest[BATCH];
    std::fill_n(largest, n, INFINITY);
    std::copy_n(given, 2 * n, found);
    write_shift_and_slopes(waves, given, n, room);
    for (int round = 0; round < ROUNDS; ++round) {
        if (step(room, given, n, found, largest)) break;
        write_shift(waves, found, n, room);
    }
    for (int i = 0; i < n; ++i)
        if (!(largest[i] <= 0.0)) found[2 * i] = found[2 * i + 1] = __builtin_nan("");
}

using Coefficients = In<double, 2, -1, -1>;

// Do something with each batch of pixels, without the interpreter's lock.
template <typename Action>
void in_batches(In<double, 4> box, Coefficients coefficients, Places pixels, Action action) {
    const int nx = static_cast<int>(coefficients.shape(1)), ny = static_cast<int>(coefficients.shape(2));
    require(nx > 0 && ny > 0, "a displacement has at least one order along x and y");
    const Waves waves{box.data(), coefficients.data(), nx, ny};
    nb::gil_scoped_release unlocked;
    Room room(nx, ny);
    for (size_t begin = 0; begin < pixels.shape(0); begin += BATCH) {
        const int size = static_cast<int>(std::min<size_t>(BATCH, pixels.shape(0) - begin));
        action(waves, pixels.data() + 2 * begin, begin, size, room);
    }
}

Result displacement_at(In<double, 4> box, Coefficients coefficients, Places pixels) {
    Out<double> result({pixels.shape(0), 2});
    in_batches(box, coefficients, pixels, [&](const Waves& waves, const double* at, size_t begin, int n, Room& room) {
        write_shift(waves, at, n, room);
        for (int i = 0; i < n; ++i)
            for (int c = 0; c < 2; ++c) result.data[2 * (begin + i) + c] = room.shift[c][i];
    });
    return result.array();
}

nb::tuple displacement_and_slopes(In<double, 4> box, Coefficients coefficients, Places pixels) {
    Out<double> result({pixels.shape(0), 2}), slopes({pixels.shape(0), 2, 2});
    in_batches(box, coefficients, pixels, [&](const Waves& waves, const double* at, size_t begin, int n, Room& room) {
        write_shift_and_slopes(waves, at, n, room);
        for (int i = 0; i < n; ++i)
            for (int c = 0; c < 2; ++c) {
                result.data[2 * (begin + i) + c] = room.shift[c][i];
                for (int a = 0; a < 2; ++a) slopes.data[4 * (begin + i) + 2 * c + a] = room.slopes[a][c][i];
            }
    });
    return nb::make_tuple(result.array(), slopes.array());
}

Result displacement_inverse(In<double, 4> box, Coefficients coefficients, Places pixels) {
    Out<double> result({pixels.shape(0), 2});
    in_batches(box, coefficients, pixels, [&](const Waves& waves, const double* at, size_t begin, int n, Room& room) {
        write_inverse(waves, at, n, room, result.data + 2 * begin);
    });
    return result.array();
}

// scale · sin(k · phase), k = 0, 1, …, by their recurrence, which loses 1e-14 over twenty of them.
void write_waves(double phase, double scale, std::vector<double>& result) {
    const double twice = 2.0 * std::cos(phase);
    result[0] = 0.0;
    if (result.size() > 1) result[1] = scale * std::sin(phase);
    for (size_t k = 2; k < result.size(); ++k) result[k] = twice * result[k - 1] - result[k - 2];
}

Result waves_at(Places pixels, In<double, 4> box, In<int64_t, -1, 2> orders) {
    const size_t n = pixels.shape(0), m = orders.shape(0);
    const auto order = checked(orders, 1'000'001, "an order is out of bounds");
    size_t highest[2] = {0, 0};
    for (size_t i = 0; i < 2 * m; ++i) highest[i % 2] = std::max(highest[i % 2], order[i]);
    Out<double> result({n, m});
    {
        nb::gil_scoped_release unlocked;
        std::vector<double> along(highest[0] + 1), down(highest[1] + 1);
        const double* b = box.data();
        for (size_t k = 0; k < n; ++k) {
            const double x = pixels.data()[2 * k] - b[0], y = pixels.data()[2 * k + 1] - b[1];
            double* row = result.data + k * m;
            if (!(std::fabs(x) < b[2] && std::fabs(y) < b[3])) {
                std::fill_n(row, m, 0.0);
                continue;
            }
            write_waves(0.5 * PI * (x / b[2] + 1.0), 1.0 / std::sqrt(b[2]), along);
            write_waves(0.5 * PI * (y / b[3] + 1.0), 1.0 / std::sqrt(b[3]), down);
            for (size_t i = 0; i < m; ++i) row[i] = along[order[2 * i]] * down[order[2 * i + 1]];
        }
    }
    return result.array();
}

}  // namespace

void add_displacement(nb::module_& module) {
    module.def("displacement_at", &displacement_at, named("box"), named("coefficients"), named("pixels"));
    module.def("displacement_and_slopes", &displacement_and_slopes, named("box"), named("coefficients"),
               named("pixels"));
    module.def("displacement_inverse", &displacement_inverse, named("box"), named("coefficients"), named("pixels"));
    module.def("waves_at", &waves_at, named("pixels"), named("box"), named("orders"));
}

}  // namespace sunarc
