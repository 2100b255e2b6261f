#include "equations.h"

namespace sunarc {

DISPATCHED double weigh(Block& b, const double* pixels, const double* information, int size, double sigma) {
    auto& along = b.columns[RESIDUAL][0];
    auto& across = b.columns[RESIDUAL][1];
    for (int i = 0; i < size; ++i) {
        along[i] = pixels[2 * i] - b.pixel[0][i], across[i] = pixels[2 * i + 1] - b.pixel[1][i];
        b.weight[i] = information[i];
    }
    for (int i = size; i < BLOCK; ++i) along[i] = across[i] = b.weight[i] = 0.0;
    const bool plain = sigma <= 0.0;
    const double cut = plain ? 0.0 : 1.0 / (CUT * sigma * CUT * sigma), inverse = plain ? 1.0 : 1.0 / sigma;
    double squares = 0.0, losses = 0.0;
#pragma omp simd reduction(+ : squares, losses)
    for (int i = 0; i < BLOCK; ++i) {
        // A comparison, not isfinite: the loop stays in vector registers. A sighting that is not shown costs and has no
        // derivative: a step that loses sightings gains nothing by it.
        const bool shown = std::fabs(along[i]) + std::fabs(across[i]) < INFINITY;
        const double dx = shown ? along[i] : UNSEEN_PX, dy = shown ? across[i] : UNSEEN_PX;
        const double square = (dx * dx + dy * dy) * b.weight[i];
        const double left = 1.0 - std::min(square * cut, 1.0);
        squares += square;
        losses += 1.0 - left * left * left;
        along[i] = dx, across[i] = dy;
        b.weight[i] = shown ? inverse * left * std::sqrt(b.weight[i]) : 0.0;
    }
    for (auto& column : b.columns)
        for (auto& coordinate : column)
#pragma omp simd
            for (int i = 0; i < BLOCK; ++i) coordinate[i] *= b.weight[i];
    return plain ? 0.5 * squares : CUT * CUT / 6.0 * losses;
}

namespace {

// Add the products of two columns with WIDTH others: eight sums at a time keep the arithmetic units busy.
template <int WIDTH>
INLINED void add_products_of(const Block& block, int a, int b, double* products, int count) {
    using Four = double __attribute__((vector_size(32), may_alias));
    constexpr int FOURS = 2 * BLOCK / 4;
    const auto column = [&](int k) { return reinterpret_cast<const Four*>(block.columns[k][0]); };
    const Four *even = column(a), *odd = column(a + 1);
    Four first[WIDTH] = {}, second[WIDTH] = {};
    for (int i = 0; i < FOURS; ++i)
        for (int k = 0; k < WIDTH; ++k) {
            const Four other = column(b + k)[i];
            first[k] += even[i] * other, second[k] += odd[i] * other;
        }
    const auto sum = [](const Four& four) { return (four[0] + four[1]) + (four[2] + four[3]); };
    for (int k = 0; k < WIDTH; ++k) {
        products[a * count + b + k] += sum(first[k]);
        products[(a + 1) * count + b + k] += sum(second[k]);
    }
}

}  // namespace

DISPATCHED void add_products(const Block& block, double* products, int count) {
    for (int a = 0; a < count; a += 2) {
        int b = 0;
        for (; b + 4 <= a + 2; b += 4) add_products_of<4>(block, a, b, products, count);
        if (b < a + 2) add_products_of<2>(block, a, b, products, count);
    }
}

void fill_upper(double* matrix, size_t size) {
    for (size_t i = 0; i < size; ++i)
        for (size_t j = 0; j < i; ++j) matrix[j * size + i] = matrix[i * size + j];
}

bool solve(double* m, double* v, int size) {
    for (int j = 0; j < size; ++j) {
        double total = m[j * size + j];
        for (int k = 0; k < j; ++k) total -= m[j * size + k] * m[j * size + k];
        if (!(total > 0.0)) return false;
        m[j * size + j] = std::sqrt(total);
        for (int i = j + 1; i < size; ++i) {
            total = m[i * size + j];
            for (int k = 0; k < j; ++k) total -= m[i * size + k] * m[j * size + k];
            m[i * size + j] = total / m[j * size + j];
        }
    }
    for (int i = 0; i < size; ++i) {
        for (int k = 0; k < i; ++k) v[i] -= m[i * size + k] * v[k];
        v[i] /= m[i * size + i];
    }
    for (int i = size - 1; i >= 0; --i) {
        for (int k = i + 1; k < size; ++k) v[i] -= m[k * size + i] * v[k];
        v[i] /= m[i * size + i];
    }
    return true;
}

void damped_step(const Table& normal, const Table& gradient, const std::vector<size_t>& moving, double damping,
                 Table& work, Table& step) {
    const size_t f = moving.size(), p = gradient.size();
    Table scale(f);
    // focal lengths in px stand beside coefficients of 1e-3: scaled, the damping means the same to all
    for (size_t i = 0; i < f; ++i) scale[i] = 1.0 / std::sqrt(std::max(normal[moving[i] * p + moving[i]], 1e-300));
    for (size_t i = 0; i < f; ++i) {
        step[i] = scale[i] * gradient[moving[i]];
        for (size_t j = 0; j <= i; ++j) work[i * f + j] = normal[moving[i] * p + moving[j]] * scale[i] * scale[j];
        work[i * f + i] += damping + RIDGE;
    }
    if (solve(work.data(), step.data(), static_cast<int>(f)))
        for (size_t i = 0; i < f; ++i) step[i] *= scale[i];
    else
        std::fill(step.begin(), step.end(), 0.0);
}

double predicted_gain(const Table& normal, const Table& gradient, const std::vector<size_t>& moving, double damping,
                      const Table& step) {
    const size_t p = gradient.size();
    double total = 0.0;
    for (size_t i = 0; i < moving.size(); ++i) {
        const size_t k = moving[i];
        total += step[i] * (gradient[k] + damping * normal[k * p + k] * step[i]);
    }
    return 0.5 * total;
}

// H. B. Nielsen, "Damping parameter in Marquardt's method", IMM-REP-1999-05 (1999).
double trust_factor(double gain, double predicted) {
    if (predicted <= 0.0) return 1.0;
    const double miss = 2.0 * gain / predicted - 1.0;
    return std::max(DAMPING_FALLS, std::min(1.0 - miss * miss * miss, 2.0));
}

}  // namespace sunarc
