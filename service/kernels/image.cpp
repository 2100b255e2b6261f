// Images: the sun's disc and its likelihood, a plateau's rim, the merge of exposures, and what the simulated sky and sensor make.
// Compiled without contraction (CMakeLists.txt): the same counts on every processor.
#include <algorithm>
#include <cmath>

#include "equations.h"

namespace sunarc {

namespace {

using Plane = In<float, -1, -1>;
using Field = In<float, -1, -1, 4>;  // east, north, up of each pixel, and what it sees
constexpr size_t LONGEST = 1 << 16;  // px: a side

// The disc.

constexpr int PLANES = 11;  // sunarc.detection.disc.model: VALUE ... BY_S22
constexpr double REACH = 5.0;  // point-spread widths beyond which a source is dark
constexpr double STEPPED = 0.1;  // counts squared of noise below which it does not blur the steps of rounding

// Write for pixels first ... last the share of a source, and its derivatives by centre and psf.
void write_spread(size_t first, size_t last, double center, double psf, double* share, double* by_center,
                  double* by_psf) {
    constexpr double ROOT_HALF = 0.70710678118654752440, NORM = 0.39894228040143267794;
    double z = (double(first) - 0.5 - center) / psf;
    double below = std::erf(z * ROOT_HALF), density = NORM * std::exp(-0.5 * z * z);
    for (size_t i = first; i <= last; ++i) {
        const double z_next = (double(i) + 0.5 - center) / psf;
        const double above = std::erf(z_next * ROOT_HALF), density_next = NORM * std::exp(-0.5 * z_next * z_next);
        share[i] = 0.5 * (above - below);
        by_center[i] = (density - density_next) / psf;
        by_psf[i] = (z * density - z_next * density_next) / psf;
        z = z_next, below = above, density = density_next;
    }
}

struct Source {
    double u, v, uu, uv;
};

// Add one source's row, n pixels of it, to the planes, which are `apart` numbers from one another.
DISPATCHED void add_source_row(const double* across, size_t columns, const double* down, const Source& at, size_t n,
                               size_t apart, double* out) {
    const double d0 = down[0], d1 = down[1], d2 = down[2], u = at.u, v = at.v, uu = at.uu, uv = at.uv;
#pragma omp simd
    for (size_t i = 0; i < n; ++i) {
        const double value = d0 * across[i], by_x = d0 * across[columns + i], by_y = d1 * across[i];
        out[i] += value;
        out[apart + i] += by_x;
        out[2 * apart + i] += by_y;
        out[3 * apart + i] += d0 * across[2 * columns + i] + d2 * across[i];
        out[4 * apart + i] += u * value;
        out[5 * apart + i] += v * value;
        out[6 * apart + i] += uu * value;
        out[7 * apart + i] += uv * value;
        out[8 * apart + i] += u * by_x;
        out[9 * apart + i] += v * by_x + u * by_y;
        out[10 * apart + i] += v * by_y;
    }
}

Result render_disc(size_t rows, size_t columns, double x, double y, double psf, In<double, 2, 2> stretch,
                   Places positions, Numbers weights) {
    require(rows <= LONGEST && columns <= LONGEST, "a side of the window is too long");
    require(positions.shape(0) == weights.shape(0), "not one weight to each position");
    Out<double> out({PLANES, rows, columns});
    {
        nb::gil_scoped_release unlocked;
        const size_t apart = rows * columns;
        std::fill_n(out.data, PLANES * apart, 0.0);
        std::vector<double> across(3 * columns), down(3 * rows);
        const double *s = stretch.data(), right = double(columns) - 1.0, bottom = double(rows) - 1.0;
        // The half pixel keeps a pixel whose near edge is within reach though its centre is not.
        const double reach = REACH * psf + 0.5;
        for (size_t k = 0; k < weights.shape(0); ++k) {
            const double u = positions.data()[2 * k], v = positions.data()[2 * k + 1], weight = weights.data()[k];
            const double px = x + s[0] * u + s[1] * v, py = y + s[2] * u + s[3] * v;
            // NaN is within reach of all pixels
            const double i0 = std::max(0.0, std::ceil(px - reach)), i1 = std::min(right, std::floor(px + reach));
            const double j0 = std::max(0.0, std::ceil(py - reach)), j1 = std::min(bottom, std::floor(py + reach));
            if (i1 < i0 || j1 < j0) continue;
            const size_t left = size_t(i0), n = size_t(i1) - left + 1;
            write_spread(left, size_t(i1), px, psf, &across[0], &across[columns], &across[2 * columns]);
            write_spread(size_t(j0), size_t(j1), py, psf, &down[0], &down[rows], &down[2 * rows]);
            const Source at{u, v, u * u - v * v, u * v};
            for (size_t j = size_t(j0); j <= size_t(j1); ++j) {
                const double weighted[] = {weight * down[j], weight * down[rows + j], weight * down[2 * rows + j]};
                add_source_row(&across[left], columns, weighted, at, n, apart, out.data + j * columns + left);
            }
        }
    }
    return out.array();
}

nb::tuple likelihood_of(In<double, -1, -1, -1> planes, Indices moved, Numbers scale, In<double, 5> glare,
                        Indices places, Numbers counts, Indices colour, Places offset, Numbers flux,
                        Numbers background, In<double, 4> around, double noise, double gain, size_t binning,
                        double clip, bool by_counts) {
    const size_t n = places.shape(0), nonlinear = moved.shape(0), colours = flux.shape(0);
    const size_t first = nonlinear + 2 * colours, p = first + 4;
    require(binning > 0 && planes.shape(1) % binning == 0 && planes.shape(2) % binning == 0,
            "planes are no whole number of pixels");
    const size_t columns = planes.shape(2) / binning, pixels = planes.shape(1) / binning * columns;
    require(planes.shape(0) > 0 && scale.shape(0) == nonlinear && background.shape(0) == colours, "lengths differ");
    require(counts.shape(0) == n && colour.shape(0) == n && offset.shape(0) == n, "lengths differ");
    const auto planes_of = checked(moved, planes.shape(0), "no such plane");
    const auto place_of = checked(places, pixels, "a place outside of the planes");
    const auto colour_of = checked(colour, colours, "no such colour");
    Out<double> residual({n}), weight({n}), jacobian({n, p});
    double misfit = 0.0;
    {
        nb::gil_scoped_release unlocked;
        const size_t wide = planes.shape(2), apart = planes.shape(1) * wide;
        const double share = 1.0 / double(binning * binning), *light = planes.data(), *g = glare.data();
        std::vector<double> smear(columns, 0.0);
        for (size_t j = 0; j < planes.shape(1); ++j)
            for (size_t i = 0; i < wide; ++i) smear[i / binning] += light[j * wide + i] * share;
        std::fill_n(jacobian.data, n * p, 0.0);
        for (size_t i = 0; i < n; ++i) {
            const size_t channel = colour_of[i], row = place_of[i] / columns, column = place_of[i] % columns;
            double* by = jacobian.data + i * p;
            double* beside = by + first;
            const double dx = offset.data()[2 * i] - g[3], dy = offset.data()[2 * i + 1] - g[4];
            const double u = g[0] * dx - g[1] * dy, v = g[2] * dy - g[1] * dx;
            beside[0] = offset.data()[2 * i], beside[1] = offset.data()[2 * i + 1];
            beside[2] = smear[column], beside[3] = 1.0 / (1.0 + u * u + v * v);
            double level = background.data()[channel], model = 0.0, unclipped = 0.0;
            for (int m = 0; m < 4; ++m) level += around.data()[m] * beside[m];
            for (size_t y = row * binning; y < (row + 1) * binning; ++y)
                for (size_t x = column * binning; x < (column + 1) * binning; ++x) {
                    const double* at = light + y * wide + x;
                    const double value = flux.data()[channel] * at[0] + level;
                    if (value >= clip) {  // more light changes nothing
                        model += clip * share;
                        continue;
                    }
                    model += value * share, unclipped += share;
                    for (size_t m = 0; m < nonlinear; ++m)
                        by[m] += share * flux.data()[channel] * scale.data()[m] * at[planes_of[m] * apart];
                    by[nonlinear + channel] += share * at[0];
                }
            by[nonlinear + colours + channel] = unclipped;
            for (int m = 0; m < 4; ++m) beside[m] *= unclipped;
            double variance = noise * noise + std::max(by_counts ? counts.data()[i] : model, 0.0) / gain;
            variance = variance < STEPPED ? 0.25 : variance + 1.0 / 12.0;
            residual.data[i] = counts.data()[i] - model, weight.data[i] = 1.0 / variance;
            misfit += residual.data[i] * residual.data[i] / variance + std::log(variance);
        }
    }
    return nb::make_tuple(misfit, residual.array(), weight.array(), jacobian.array());
}

// The merge of exposures.

constexpr double SATURATED = 0.98;
constexpr size_t RUN = 256;  // pixels whose numbers stay within the processor's first cache

struct Merge {
    const double* exposures;
    size_t frames, apart;  // numbers from one frame to the next
    double black, saturated_from, top_rate, read_variance, counts_per_electron;
};

// Merge a run of n pixels; return how many are saturated in the first exposure.
template <typename T>
INLINED size_t merge_run(const Merge& by, const T* stack, size_t n, uint16_t* out) {
    double open[RUN], signal[RUN], time[RUN], photon[RUN], total[RUN], weights[RUN];
    for (size_t i = 0; i < n; ++i) open[i] = 1.0, signal[i] = time[i] = total[i] = weights[i] = 0.0;
    for (size_t k = 0; k < by.frames; ++k) {
        const T* frame = stack + k * by.apart;
        const double exposure = by.exposures[k];
#pragma omp simd
        for (size_t i = 0; i < n; ++i) {
            const double counts = frame[i];
            open[i] = counts >= by.saturated_from ? 0.0 : open[i];  // and longer exposures are saturated too
            signal[i] += open[i] * (counts - by.black);
            time[i] += open[i] * exposure;
        }
    }
#pragma omp simd
    for (size_t i = 0; i < n; ++i) {
        const double rate = signal[i] / time[i];
        photon[i] = (rate > 0.0 ? rate : 0.0) * by.counts_per_electron;
        open[i] = 1.0;
    }
    for (size_t k = 0; k < by.frames; ++k) {
        const T* frame = stack + k * by.apart;
        const double exposure = by.exposures[k];
#pragma omp simd
        for (size_t i = 0; i < n; ++i) {
            const double counts = frame[i];
            open[i] = counts >= by.saturated_from ? 0.0 : open[i];
            const double weight = open[i] * (exposure / (by.read_variance + photon[i] * exposure));
            total[i] += weight * (counts - by.black);
            weights[i] += weight * exposure;
        }
    }
    size_t lost = 0;
    for (size_t i = 0; i < n; ++i) {
        double share = total[i] / weights[i] / by.top_rate;
        share = time[i] == 0.0 ? 1.0 : share > 0.0 ? std::min(share, 1.0) : 0.0;
        out[i] = uint16_t(std::nearbyint(share * 65535.0));
        lost += time[i] == 0.0;
    }
    return lost;
}

DISPATCHED size_t merge_bytes(const Merge& by, const uint8_t* stack, size_t n, uint16_t* out) {
    return merge_run(by, stack, n, out);
}

DISPATCHED size_t merge_words(const Merge& by, const uint16_t* stack, size_t n, uint16_t* out) {
    return merge_run(by, stack, n, out);
}

template <typename T, size_t (*merge)(const Merge&, const T*, size_t, uint16_t*)>
nb::tuple merge_exposures(In<T, -1, -1, -1> stack, Numbers exposures, double black, double full_scale,
                          double read_variance, double counts_per_electron) {
    const size_t frames = stack.shape(0), rows = stack.shape(1), columns = stack.shape(2), pixels = rows * columns;
    require(frames > 0 && exposures.shape(0) == frames, "not one exposure to each frame");
    Out<uint16_t> out({rows, columns});
    size_t lost = 0;
    {
        nb::gil_scoped_release unlocked;
        const double* times = exposures.data();
        const Merge by{times, frames, pixels, black, SATURATED * full_scale, (full_scale - black) / times[0],
                       read_variance, counts_per_electron};
        for (size_t begin = 0; begin < pixels; begin += RUN)
            lost += merge(by, stack.data() + begin, std::min(RUN, pixels - begin), out.data + begin);
    }
    return nb::make_tuple(out.array(), lost);
}

// The rim of a plateau.

constexpr double CUT_OUTSIDE = 2.5, CUT_INSIDE = 4.0;  // scales: harder outside, where cloud and streaks are
constexpr double MAD_TO_SIGMA = 1.4826;                // sunarc.common.robust_statistics

// Tukey's weight of a distance from the rim, outwards positive, over the scale.
INLINED double rim_weight(double distance) {
    const double ratio = std::max(distance / CUT_OUTSIDE, -distance / CUT_INSIDE);
    const double weight = std::max(0.0, 1.0 - ratio * ratio);  // 0 where it is not a number
    return weight * weight;
}

// The sum of the weights of distances from a circle.
DISPATCHED double followed(const double* points, size_t n, const double* circle, double scale) {
    double total = 0.0;
#pragma omp simd reduction(+ : total)
    for (size_t i = 0; i < n; ++i) {
        const double dx = points[2 * i] - circle[0], dy = points[2 * i + 1] - circle[1];
        total += rim_weight((std::sqrt(dx * dx + dy * dy) - circle[2]) / scale);
    }
    return total;
}

size_t most_followed(Places points, Vectors circles, double scale) {
    nb::gil_scoped_release unlocked;
    size_t best = 0;
    double most = 0.0;
    for (size_t k = 0; k < circles.shape(0); ++k) {
        const double total = followed(points.data(), points.shape(0), circles.data() + 3 * k, scale);
        if (total > most) best = k, most = total;
    }
    return best;
}

constexpr int RIM = 5;      // unknowns: x, y, radius, and the cosine and sine of twice the angle
constexpr int ROUNDS = 20;  // at most
constexpr double SETTLED_PX = 1e-3;
constexpr double HELD = 1e-6;  // of x, y and radius: where few points follow, a step stays finite
constexpr double LEAST_RADIUS_PX = 1.0;

struct RimRows {
    size_t n;
    std::vector<double> residual, weight, design;  // px, (n,), and the derivatives (RIM, n)
    explicit RimRows(size_t points) : n(points), residual(n), weight(n), design(RIM * n) {}
};

// Write the points' distances from the rim, outwards positive, their weights, and the derivatives.
DISPATCHED void write_rim(const double* points, const double* state, double scale, RimRows& rows) {
    double *residual = rows.residual.data(), *weight = rows.weight.data();
    double *by_x = rows.design.data(), *by_y = by_x + rows.n, *by_radius = by_y + rows.n;
    double *by_cosine = by_radius + rows.n, *by_sine = by_cosine + rows.n;
#pragma omp simd
    for (size_t i = 0; i < rows.n; ++i) {
        double dx = points[2 * i] - state[0], dy = points[2 * i + 1] - state[1];
        const double length = std::max(1e-6, std::sqrt(dx * dx + dy * dy));
        dx /= length, dy /= length;
        by_x[i] = dx, by_y[i] = dy, by_radius[i] = 1.0;
        by_cosine[i] = dx * dx - dy * dy, by_sine[i] = 2.0 * dx * dy;
        residual[i] = length - state[2] - by_cosine[i] * state[3] - by_sine[i] * state[4];
        weight[i] = rim_weight(residual[i] / scale);
    }
}

// The sum of the weighted products of two rows.
DISPATCHED double product(const double* a, const double* b, const double* weight, size_t n) {
    double total = 0.0;
#pragma omp simd reduction(+ : total)
    for (size_t i = 0; i < n; ++i) total += a[i] * b[i] * weight[i];
    return total;
}

// Replace `step` by the step of Gauss and Newton; false where the equations have no solution.
bool rim_step(const RimRows& rows, const double* state, double held, double* step) {
    double normal[RIM * RIM] = {};
    const double* weight = rows.weight.data();
    for (int j = 0; j < RIM; ++j) {
        const double* row = rows.design.data() + j * rows.n;
        for (int k = 0; k <= j; ++k) normal[j * RIM + k] = product(row, rows.design.data() + k * rows.n, weight, rows.n);
        normal[j * RIM + j] += j < 3 ? HELD : held;
        step[j] = product(row, rows.residual.data(), weight, rows.n) - (j < 3 ? 0.0 : held * state[j]);
    }
    return solve(normal, step, RIM);
}

double median_of(std::vector<double>& values) {
    const auto middle = values.begin() + values.size() / 2;
    std::nth_element(values.begin(), middle, values.end());
    return values.size() % 2 ? *middle : 0.5 * (*middle + *std::max_element(values.begin(), middle));
}

nb::object fitted_rim(Places points, In<double, 3> start, double scale, double drawn_out, size_t least_points,
                      double least_scale_px, double least_scale) {
    const size_t n = points.shape(0);
    Out<double> fitted({RIM}), residual({n});
    bool found = true;
    {
        nb::gil_scoped_release unlocked;
        RimRows rows(n);
        std::vector<double> used;
        double *state = fitted.data, step[RIM];
        std::copy_n(start.data(), 3, state);
        state[3] = state[4] = 0.0;
        double largest = INFINITY;
        for (int round = 0; round < ROUNDS && found && !(largest < SETTLED_PX); ++round) {
            write_rim(points.data(), state, scale, rows);
            used.clear();
            for (size_t i = 0; i < n; ++i)
                if (rows.weight[i] > 0.0) used.push_back(std::fabs(rows.residual[i]));
            const double held = scale / (drawn_out * state[2]), most = 0.5 * state[2];
            found = !used.empty() && used.size() >= least_points && rim_step(rows, state, held * held, step);
            if (!found) break;
            largest = 0.0;
            for (int k = 0; k < RIM; ++k) {
                largest = std::max(largest, std::fabs(step[k]));
                state[k] += std::min(std::max(step[k], -most), most);
            }
            found = state[2] >= LEAST_RADIUS_PX;
            scale = std::max({MAD_TO_SIGMA * median_of(used), least_scale_px, least_scale * state[2]});
        }
        std::copy_n(rows.residual.data(), n, residual.data);
    }
    if (!found) return nb::none();
    return nb::make_tuple(fitted.array(), scale, residual.array());
}

Result crossings(Matrix light, double level, size_t lasting, Numbers radii) {
    const size_t rays = light.shape(0), samples = light.shape(1);
    require(lasting > 0 && samples > 1 && radii.shape(0) == samples, "not one radius to each of two samples or more");
    Out<double> out({rays});
    {
        nb::gil_scoped_release unlocked;
        const double *radius = radii.data(), step = radius[1] - radius[0];
        for (size_t ray = 0; ray < rays; ++ray) {
            const double* along = light.data() + ray * samples;
            size_t k = 0, run = 0;
            for (; k < samples && run < lasting && !std::isnan(along[k]); ++k) run = along[k] < level ? run + 1 : 0;
            const size_t first = k - run;  // sample of the fall
            out.data[ray] = NAN;
            if (run < lasting || first == 0) continue;
            const double before = along[first - 1];
            const double share = (before - level) / std::max(before - along[first], 1e-6);
            out.data[ray] = radius[first - 1] + std::min(std::max(share, 0.0), 1.0) * step;
        }
    }
    return out.array();
}

// The simulated sky and sensor.

constexpr float TEXELS_PER_HEIGHT = 200.0f;
constexpr float FLATTENING = 0.12f;  // keeps the far rim of the clouds at a finite distance, as the Earth's curvature
constexpr float FARTHEST = 1e9f;     // texels

struct Clouds {
    const float* layer;
    int size;  // a power of two
    float x, y;

    Clouds(const Plane& plane, float offset_x, float offset_y)
        : layer(plane.data()), size(int(plane.shape(0))), x(offset_x), y(offset_y) {
        require(size > 0 && plane.shape(0) <= LONGEST && plane.shape(1) == plane.shape(0) && !(size & (size - 1)),
                "a layer is no square of a power of two");
    }
};

// The layer's transmittance in one direction, 1 below the horizon (bilinear, periodic).
INLINED float transmittance(const Clouds& clouds, float east, float north, float up) {
    const float scale = TEXELS_PER_HEIGHT / (std::max(0.0f, up) + FLATTENING);
    const float x = std::min(std::max(0.0f, east * scale + clouds.x), FARTHEST);
    const float y = std::min(std::max(0.0f, north * scale + clouds.y), FARTHEST);
    const int column = int(x), row = int(y), last = clouds.size - 1;
    const float fx = x - float(column), fy = y - float(row);
    const int left = column & last, right = (column + 1) & last;
    const float *top = clouds.layer + (row & last) * clouds.size;
    const float *bottom = clouds.layer + ((row + 1) & last) * clouds.size;
    const float upper = top[left] + fx * (top[right] - top[left]);
    const float lower = bottom[left] + fx * (bottom[right] - bottom[left]);
    return up <= 0.0f ? 1.0f : upper + fy * (lower - upper);
}

DISPATCHED void write_transmittance(const Clouds& clouds, const float* directions, size_t n, float* out) {
    for (size_t i = 0; i < n; ++i)
        out[i] = transmittance(clouds, directions[3 * i], directions[3 * i + 1], directions[3 * i + 2]);
}

nb::ndarray<nb::numpy, float> cloud_transmittance(Plane layer, float offset_x, float offset_y,
                                                  In<float, -1, 3> directions) {
    const Clouds clouds(layer, offset_x, offset_y);
    Out<float> out({directions.shape(0)});
    {
        nb::gil_scoped_release unlocked;
        write_transmittance(clouds, directions.data(), directions.shape(0), out.data);
    }
    return out.array();
}

// `levels`: clear zenith, cloud, ground, glare (strength, core), forward scattering in cloud.
DISPATCHED void write_sky(const float* field, size_t n, const float* sun, const float* levels, const Clouds& clouds,
                          float* out) {
    const float zenith = levels[0], cloud = levels[1], ground = levels[2], glare = levels[3], core = levels[4];
    const float forward = levels[5];
    const bool cloudy = clouds.size > 1;
    for (size_t i = 0; i < n; ++i) {
        const float east = field[4 * i], north = field[4 * i + 1], up = field[4 * i + 2], sees = field[4 * i + 3];
        const float dx = east - sun[0], dy = north - sun[1], dz = up - sun[2];
        const float chord2 = dx * dx + dy * dy + dz * dz;  // the chord's square, exact also close to the sun
        const float near = chord2 + core, wide = chord2 + 0.02f, low = 1.0f - up, cosine = 1.0f - 0.5f * chord2;
        float light = zenith * (1.0f + 1.5f * low * low * low) * (0.8f + 0.4f * cosine * cosine), halo = 0.0f;
        if (cloudy) {
            const float through = transmittance(clouds, east, north, up);
            light = light * through + cloud * (0.5f + 0.5f * through) * (1.0f - through);
            halo = forward * through * (1.0f - through);
        }
        light = sees > 0.0f ? light * sees : -sees * ground;
        halo = sees > 0.0f ? halo : 0.0f;
        // glare / near + halo / wide, with one division
        const float all = light + std::abs(sees) * (glare * wide + halo * near) / (near * wide);
        out[i] = sees == 0.0f ? 0.0f : all;
    }
}

// `levels`: the dark zenith, the town's dome, the moonlit sky far from the moon, the glare one degree from the moon.
DISPATCHED void write_glow(const float* field, size_t n, const float* levels, const float* city, const float* moon,
                           const Clouds& clouds, float* out) {
    const float airglow = levels[0], dome = levels[1], moonlit = levels[2], glare = levels[3];
    for (size_t i = 0; i < n; ++i) {
        const float east = field[4 * i], north = field[4 * i + 1], up = field[4 * i + 2], sees = field[4 * i + 3];
        out[i] = 0.0f;
        if (!(sees > 0.0f)) continue;  // the ground is dark
        const float low = 1.0f - up, towards = std::max(east * city[0] + north * city[1], 0.0f);
        const float town = dome * (0.15f + 0.85f * towards * towards) * std::exp(-4.0f * up);
        const float dx = east - moon[0], dy = north - moon[1], dz = up - moon[2];
        const float chord2 = dx * dx + dy * dy + dz * dz;
        const float lit = moonlit * (1.0f + 0.1f / (chord2 + 0.05f));
        const float sky = airglow * (1.0f + low * low) + town + lit;
        const float through = clouds.size > 1 ? transmittance(clouds, east, north, up) : 1.0f;
        // a cloud takes away the airglow above it, and throws back the town's light and the moon's
        const float cloud = 0.2f * airglow + 3.0f * town + 2.0f * lit;
        out[i] = sees * (sky * through + cloud * (1.0f - through) + glare * through * 3.05e-4f / (chord2 + 8e-5f));
    }
}

nb::ndarray<nb::numpy, float> sky_light(Field field, In<float, 3> sun, In<float, 6> levels, Plane layer,
                                        float offset_x, float offset_y) {
    const Clouds clouds(layer, offset_x, offset_y);
    Out<float> out({field.shape(0), field.shape(1)});
    {
        nb::gil_scoped_release unlocked;
        write_sky(field.data(), field.shape(0) * field.shape(1), sun.data(), levels.data(), clouds, out.data);
    }
    return out.array();
}

nb::ndarray<nb::numpy, float> night_glow(Field field, In<float, 4> levels, In<float, 2> city, In<float, 3> moon,
                                         Plane layer, float offset_x, float offset_y) {
    const Clouds clouds(layer, offset_x, offset_y);
    Out<float> out({field.shape(0), field.shape(1)});
    {
        nb::gil_scoped_release unlocked;
        write_glow(field.data(), field.shape(0) * field.shape(1), levels.data(), city.data(), moon.data(), clouds,
                   out.data);
    }
    return out.array();
}

// `sensor`: electrons per light, most electrons, read noise squared (less than 0: no noise at all), counts per
// electron, black level, full scale.
DISPATCHED void write_counts(const float* light, const float* smear, const float* noise, size_t n, const float* sensor,
                             uint16_t* out) {
    const float per_light = sensor[0], most = sensor[1], read = sensor[2], per_electron = sensor[3];
    const float black = sensor[4], full = std::max(0.0f, std::min(65535.0f, sensor[5]));
    const float shot = read >= 0.0f ? 1.0f : 0.0f, floor = std::max(read, 0.0f);
#pragma omp simd
    for (size_t i = 0; i < n; ++i) {
        float electrons = std::min(light[i] * per_light + smear[i], most);
        electrons += noise[i] * std::sqrt(shot * electrons + floor);
        const float counts = black + electrons * per_electron + 0.5f;
        out[i] = uint16_t(int(std::min(std::max(0.0f, counts), full)));
    }
}

nb::ndarray<nb::numpy, uint16_t> count_light(Plane light, In<float, -1> smear, In<float, -1> noise, Indices starts,
                                             In<float, 6> sensor) {
    const size_t rows = light.shape(0), columns = light.shape(1);
    require(smear.shape(0) == columns && starts.shape(0) == rows, "lengths differ");
    require(noise.shape(0) >= columns, "a row ends beyond the noise");
    const auto from = checked(starts, noise.shape(0) - columns + 1, "a row ends beyond the noise");
    Out<uint16_t> out({rows, columns});
    {
        nb::gil_scoped_release unlocked;
        for (size_t row = 0; row < rows; ++row)
            write_counts(light.data() + row * columns, smear.data(), noise.data() + from[row], columns,
                         sensor.data(), out.data + row * columns);
    }
    return out.array();
}

nb::ndarray<nb::numpy, float> image_of_points(size_t rows, size_t columns, In<double, -1, 4> points) {
    constexpr double WIDEST = 4.0;  // radius of a point's image in units of its sigma
    require(rows <= LONGEST && columns <= LONGEST, "a side of the image is too long");
    Out<float> out({rows, columns});
    {
        nb::gil_scoped_release unlocked;
        std::fill_n(out.data, rows * columns, 0.0f);
        std::vector<double> across(columns);
        for (size_t k = 0; k < points.shape(0); ++k) {
            const double *at = points.data() + 4 * k, x = at[0], y = at[1], flux = at[2];
            const double reach = WIDEST * at[3] + 1.0, scale = 1.0 / (std::sqrt(2.0) * at[3]);
            const double left = std::max(0.0, std::floor(x - reach)), top = std::max(0.0, std::floor(y - reach));
            const double right = std::min(double(columns) - 1.0, std::ceil(x + reach));
            const double bottom = std::min(double(rows) - 1.0, std::ceil(y + reach));
            for (double i = left; i <= right; ++i)
                across[size_t(i)] = 0.5 * (std::erf((i + 0.5 - x) * scale) - std::erf((i - 0.5 - x) * scale));
            for (double j = top; j <= bottom; ++j) {
                const double down = 0.5 * (std::erf((j + 0.5 - y) * scale) - std::erf((j - 0.5 - y) * scale));
                float* row = out.data + size_t(j) * columns;
                for (double i = left; i <= right; ++i) row[size_t(i)] += float(flux * down * across[size_t(i)]);
            }
        }
    }
    return out.array();
}

}  // namespace

void add_image(nb::module_& module) {
    module.def("render_disc", &render_disc, nb::arg("rows"), nb::arg("columns"), nb::arg("x"), nb::arg("y"),
               nb::arg("psf"), named("stretch"), named("positions"), named("weights"));
    module.def("likelihood_of", &likelihood_of, named("planes"), named("moved"), named("scale"), named("glare"),
               named("places"), named("counts"), named("colour"), named("offset"), named("flux"),
               named("background"), named("around"), nb::arg("noise"), nb::arg("gain"), nb::arg("binning"),
               nb::arg("clip"), nb::arg("by_counts"));
    module.def("merge_exposures", &merge_exposures<uint8_t, merge_bytes>, named("stack"), named("exposures"),
               nb::arg("black"), nb::arg("full_scale"), nb::arg("read_variance"), nb::arg("counts_per_electron"));
    module.def("merge_exposures", &merge_exposures<uint16_t, merge_words>, named("stack"), named("exposures"),
               nb::arg("black"), nb::arg("full_scale"), nb::arg("read_variance"), nb::arg("counts_per_electron"));
    module.def("most_followed", &most_followed, named("points"), named("circles"), nb::arg("scale"));
    module.def("fitted_rim", &fitted_rim, named("points"), named("start"), nb::arg("scale"), nb::arg("drawn_out"),
               nb::arg("least_points"), nb::arg("least_scale_px"), nb::arg("least_scale"));
    module.def("crossings", &crossings, named("light"), nb::arg("level"), nb::arg("lasting"), named("radii"));
    module.def("cloud_transmittance", &cloud_transmittance, named("layer"), nb::arg("offset_x"),
               nb::arg("offset_y"), named("directions"));
    module.def("sky_light", &sky_light, named("field"), named("sun"), named("levels"), named("layer"),
               nb::arg("offset_x"), nb::arg("offset_y"));
    module.def("night_glow", &night_glow, named("field"), named("levels"), named("city"), named("moon"),
               named("layer"), nb::arg("offset_x"), nb::arg("offset_y"));
    module.def("count_light", &count_light, named("light"), named("smear"), named("noise"), named("starts"),
               named("sensor"));
    module.def("image_of_points", &image_of_points, nb::arg("rows"), nb::arg("columns"), named("points"));
}

}  // namespace sunarc
