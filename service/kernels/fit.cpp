// The most probable camera: Levenberg-Marquardt on a robust cost with Gaussian priors; residuals and their derivatives.
#include <algorithm>

#include "equations.h"

namespace sunarc {

namespace {

constexpr int SUMS = N_NATIVE + 2;  // columns whose products are added: derivatives, residual, one that is not looked at

// Lens = mean (17,) + basis (17, 17) · its unknowns; most of the basis is 0: `first` and `last` say where it is not.
struct Whitened {
    const double *mean, *basis;
    int first[N_LENS], last[N_LENS];

    Whitened(const double* of_mean, const double* of_basis) : mean(of_mean), basis(of_basis) {
        for (int i = 0; i < N_LENS; ++i) {
            first[i] = last[i] = 0;
            for (int j = 0; j < N_LENS; ++j)
                if (basis[i * N_LENS + j] != 0.0) last[i] = j + 1;
            while (first[i] < last[i] && basis[i * N_LENS + first[i]] == 0.0) ++first[i];
        }
    }

    void write_parameters(const double* unknowns, double* vector) const {
        std::fill_n(vector, PARAMETERS, 0.0);
        for (int i = 0; i < N_LENS; ++i) {
            double value = mean[i];
            for (int j = 0; j < N_LENS; ++j) value += basis[i * N_LENS + j] * unknowns[j];
            vector[PARAMETER_OF[i]] = value;
        }
    }
};

// Sightings: directions (n, 3), pixels (n, 2), information (n,), 1/px².
struct Seen {
    const double *directions, *pixels, *information;
    std::vector<size_t> epoch;

    // How many sightings from one on share its epoch, at most a block.
    int run(size_t begin) const {
        const size_t most = std::min<size_t>(BLOCK, epoch.size() - begin);
        size_t size = 1;
        while (size < most && epoch[begin + size] == epoch[begin]) ++size;
        return static_cast<int>(size);
    }
};

struct Goal {
    const double* precision;  // of the prior, of the unknowns
    double sigma;             // px, of the loss; 0 takes plain squares
};

class Equations {
  public:
    Table normal, gradient;
    double cost = 0.0;

    Equations(Optics optics, const Whitened& lens, const Seen& seen, const Goal& goal, size_t p)
        : normal(p * p), gradient(p), optics_(optics), lens_(lens), seen_(seen), goal_(goal), size_(p),
          block_(new Block), products_((p - N_LENS) / 3 * SUMS * SUMS) {}

    // About some unknowns: the cost, prior included.
    void write(const Table& at) {
        double vector[PARAMETERS];
        lens_.write_parameters(at.data(), vector);
        const size_t epochs = (size_ - N_LENS) / 3;
        Table rotation(9 * epochs), jacobian(9 * epochs);
        for (size_t e = 0; e < epochs; ++e)
            write_rotation(&at[N_LENS + 3 * e], &rotation[9 * e], &jacobian[9 * e]);
        std::fill(products_.begin(), products_.end(), 0.0);
        cost = 0.0;
        for (size_t begin = 0; begin < seen_.epoch.size();) {
            const size_t e = seen_.epoch[begin];
            const int size = seen_.run(begin);
            write_block(vector, optics_, &rotation[9 * e], &jacobian[9 * e], seen_.directions + 3 * begin, size, *block_);
            cost += weigh(*block_, seen_.pixels + 2 * begin, seen_.information + begin, size, goal_.sigma);
            // J'WJ with the weights of the loss (iteratively reweighted least squares): the second derivative of Tukey's
            // loss is negative for far sightings, and the matrix with it would not always be positive.
            add_products(*block_, &products_[e * SUMS * SUMS], SUMS);
            begin += size;
        }
        by_unknowns(epochs);
        for (size_t i = 0; i < size_; ++i) {
            cost += 0.5 * goal_.precision[i] * at[i] * at[i];
            normal[i * size_ + i] += goal_.precision[i];
            gradient[i] -= goal_.precision[i] * at[i];
        }
        // a step to where the projection overflows must lose every comparison
        if (!std::isfinite(cost)) cost = INFINITY;
    }

  private:
    Optics optics_;
    const Whitened& lens_;
    const Seen& seen_;
    const Goal& goal_;
    size_t size_;
    std::unique_ptr<Block> block_;
    Table products_;  // of each epoch, in the order of a block's columns

    // The sums by the whitened unknowns of the lens and the poses of all epochs.
    void by_unknowns(size_t epochs) {
        std::fill(normal.begin(), normal.end(), 0.0);
        std::fill(gradient.begin(), gradient.end(), 0.0);
        double half[N_NATIVE][N_LENS];
        for (size_t e = 0; e < epochs; ++e) {
            double* native = &products_[e * SUMS * SUMS];
            const double* pull = native + RESIDUAL * SUMS;
            fill_upper(native, SUMS);
            add_lens_sums(native, half);
            const size_t pose = N_LENS + 3 * e;
            for (int a = 0; a < 3; ++a) {
                gradient[pose + a] = pull[N_LENS + a];
                for (int j = 0; j < N_LENS; ++j) normal[(pose + a) * size_ + j] = half[N_LENS + a][j];
                for (int b = 0; b <= a; ++b)
                    normal[(pose + a) * size_ + pose + b] = native[(N_LENS + a) * SUMS + N_LENS + b];
            }
        }
        fill_upper(normal.data(), size_);
    }

    // One epoch's sums times the basis to `half`, and those of the lens to the equations.
    void add_lens_sums(const double* native, double (*half)[N_LENS]) {
        for (int i = 0; i < N_NATIVE; ++i) {
            std::fill_n(half[i], N_LENS, 0.0);
            for (int k = 0; k < N_LENS; ++k)
                for (int j = lens_.first[k]; j < lens_.last[k]; ++j)
                    half[i][j] += native[i * SUMS + k] * lens_.basis[k * N_LENS + j];
        }
        for (int k = 0; k < N_LENS; ++k)
            for (int i = lens_.first[k]; i < lens_.last[k]; ++i) {
                const double share = lens_.basis[k * N_LENS + i];
                gradient[i] += share * native[RESIDUAL * SUMS + k];
                for (int j = 0; j <= i; ++j) normal[i * size_ + j] += share * half[k][j];
            }
    }
};

nb::tuple most_probable(int code, double mirror, double max_angle, In<double, N_LENS> mean,
                        In<double, N_LENS, N_LENS> basis, Vectors directions, Places pixels, Numbers information,
                        Indices epoch, Numbers precision, double sigma, int iterations, double tolerance,
                        Numbers start, Indices moving) {
    require_projection(code);
    const size_t n = directions.shape(0), p = start.shape(0);
    require(p >= N_LENS + 3 && (p - N_LENS) % 3 == 0, "not the unknowns of a lens and of its poses");
    require(pixels.shape(0) == n, "not as many pixels as directions");
    require(information.shape(0) == n, "not as many weights as directions");
    require(epoch.shape(0) == n, "not as many epochs as directions");
    require(precision.shape(0) == p, "not as many precisions as unknowns");
    const Seen seen{directions.data(), pixels.data(), information.data(),
                    checked(epoch, (p - N_LENS) / 3, "an epoch has no pose")};
    const auto free = checked(moving, p, "an unknown that moves is none");
    Out<double> result({p});
    double cost;
    {
        nb::gil_scoped_release unlocked;
        Table at(start.data(), start.data() + p);
        const Whitened lens(mean.data(), basis.data());
        const Goal goal{precision.data(), sigma};
        Equations here({code, mirror, max_angle}, lens, seen, goal, p), there({code, mirror, max_angle}, lens, seen, goal, p);
        cost = minimise(here, there, free, iterations, tolerance, FIRST_DAMPING, at);
        std::copy(at.begin(), at.end(), result.data);
    }
    return nb::make_tuple(result.array(), cost);
}

Result compute_residuals(int code, double mirror, double max_angle, In<double, PARAMETERS> vector, Vectors directions,
                    Places pixels) {
    require_projection(code);
    const size_t n = directions.shape(0);
    require(pixels.shape(0) == n, "not as many pixels as directions");
    Out<double> result({n, 2});
    {
        nb::gil_scoped_release unlocked;
        double rotation[9], jacobian[9];
        write_rotation(vector.data() + ROTATION, rotation, jacobian);
        auto block = std::make_unique<Block>();
        for (size_t begin = 0; begin < n; begin += BLOCK) {
            const size_t size = std::min<size_t>(BLOCK, n - begin);
            write_pixels(vector.data(), {code, mirror, max_angle}, rotation, directions.data() + 3 * begin, size, *block);
            for (size_t i = 0; i < 2 * size; ++i) {
                const double residual = pixels.data()[2 * begin + i] - block->pixel[i % 2][i / 2];
                result.data[2 * begin + i] = std::isfinite(residual) ? residual : UNSEEN_PX;
            }
        }
    }
    return result.array();
}

// The derivatives of a block by the lens's unknowns, in place of those by its parameters.
DISPATCHED void by_lens_unknowns(const Whitened& lens, Block& block) {
    double own[N_LENS][2 * BLOCK] = {};
    for (int i = 0; i < N_LENS; ++i)
        for (int j = lens.first[i]; j < lens.last[i]; ++j) {
            const double share = lens.basis[i * N_LENS + j], *column = block.columns[i][0];
#pragma omp simd
            for (int k = 0; k < 2 * BLOCK; ++k) own[j][k] += share * column[k];
        }
    std::copy_n(own[0], N_LENS * 2 * BLOCK, block.columns[0][0]);
}

struct Columns {
    double *residual, *columns;  // (2, n), (2, size, n)
    size_t n, size;
    double& at(int c, size_t column, size_t i) const { return columns[(c * size + column) * n + i]; }
};

nb::tuple residuals_and_jacobian(int code, double mirror, double max_angle, In<double, -1, PARAMETERS> vectors,
                                   In<double, N_LENS, N_LENS> basis, Vectors directions, Places pixels,
                                   Indices epoch, In<double, -1, 2, -1> systematic_px, Numbers sizes) {
    require_projection(code);
    const size_t n = directions.shape(0), epochs = vectors.shape(0), shared = sizes.shape(0);
    require(pixels.shape(0) == n, "not as many pixels as directions");
    require(epoch.shape(0) == n, "not as many epochs as directions");
    require(systematic_px.shape(0) == n, "not as many systematic errors as directions");
    require(systematic_px.shape(2) == shared, "not a size for each systematic error");
    const Seen seen{directions.data(), pixels.data(), nullptr,
                    checked(epoch, epochs, "an epoch has no camera")};
    const size_t size = N_LENS + 3 * epochs + shared;
    Out<double> residual({2, n}), columns({2, size, n});
    {
        nb::gil_scoped_release unlocked;
        std::fill_n(columns.data, 2 * size * n, 0.0);
        const Columns out{residual.data, columns.data, n, size};
        const Whitened lens(nullptr, basis.data());
        Table rotations(9 * epochs), jacobians(9 * epochs);
        for (size_t e = 0; e < epochs; ++e)
            write_rotation(vectors.data() + PARAMETERS * e + ROTATION, &rotations[9 * e], &jacobians[9 * e]);
        auto block = std::make_unique<Block>();
        for (size_t begin = 0; begin < n;) {
            const size_t e = seen.epoch[begin];
            const int count = seen.run(begin);
            write_block(vectors.data() + PARAMETERS * e, {code, mirror, max_angle}, &rotations[9 * e], &jacobians[9 * e],
                        seen.directions + 3 * begin, count, *block);
            by_lens_unknowns(lens, *block);
            for (int c = 0; c < 2; ++c)
                for (int j = 0; j < N_NATIVE; ++j)
                    std::copy_n(block->columns[j][c], count, &out.at(c, j < N_LENS ? j : j + 3 * e, begin));
            for (int c = 0; c < 2; ++c)
                for (int b = 0; b < count; ++b) {
                    const size_t i = begin + b;
                    const double* displaced = systematic_px.data() + (2 * i + c) * shared;
                    double difference = pixels.data()[2 * i + c] - block->pixel[c][b];
                    for (size_t s = 0; s < shared; ++s) difference -= displaced[s] * sizes.data()[s];
                    const bool shown = std::isfinite(block->pixel[0][b]);
                    out.residual[c * n + i] = shown && std::isfinite(difference) ? difference : UNSEEN_PX;
                    if (!shown) continue;
                    for (size_t s = 0; s < shared; ++s) out.at(c, size - shared + s, i) = displaced[s];
                }
            begin += count;
        }
    }
    return nb::make_tuple(residual.array(), columns.array());
}

}  // namespace

void add_fit(nb::module_& module) {
    module.def("most_probable", &most_probable, nb::arg("code"), nb::arg("mirror"), nb::arg("max_angle"), named("mean"),
               named("basis"), named("directions"), named("pixels"), named("information"), named("epoch"),
               named("precision"), nb::arg("sigma"), nb::arg("iterations"), nb::arg("tolerance"), named("start"),
               named("moving"));
    module.def("compute_residuals", &compute_residuals, nb::arg("code"), nb::arg("mirror"), nb::arg("max_angle"), named("vector"),
               named("directions"), named("pixels"));
    module.def("residuals_and_jacobian", &residuals_and_jacobian, nb::arg("code"), nb::arg("mirror"),
               nb::arg("max_angle"), named("vectors"), named("basis"), named("directions"), named("pixels"),
               named("epoch"), named("systematic_px"), named("sizes"));
}

}  // namespace sunarc
