// The fit of Urquhart et al. 2016 (Eq. 26): plain squares of the residuals, and its penalties.
#include "equations.h"

namespace sunarc {

namespace {

using Row = double[PARAMETERS];

// The penalties as sunarc.calibration.paper.Penalties has them, their weights in them.
struct Penalties {
    const double *orthogonality, *edge, *ideal_slope, *slope_by_radial;
    double circularity;
    bool with_decentering;
    size_t azimuths, angles;
};

class Equations {
  public:
    Table normal = Table(PARAMETERS * PARAMETERS), gradient = Table(PARAMETERS);
    double cost = 0.0;  // half the squares

    Equations(Optics optics, const Penalties& penalties, Vectors directions, Places pixels, Numbers information)
        : optics_(optics), penalties_(penalties), n_(directions.shape(0)), directions_(directions.data()),
          pixels_(pixels.data()), information_(information.data()), block_(new Block) {}

    void write(const Table& vector) {
        std::fill(normal.begin(), normal.end(), 0.0);
        std::fill(gradient.begin(), gradient.end(), 0.0);
        cost = 0.0;
        double rotation[9], jacobian[9], products[N_COLUMNS * N_COLUMNS] = {};
        write_rotation(&vector[ROTATION], rotation, jacobian);
        for (size_t begin = 0; begin < n_; begin += BLOCK) {
            const int size = static_cast<int>(std::min<size_t>(BLOCK, n_ - begin));
            write_block(vector.data(), optics_, rotation, jacobian, directions_ + 3 * begin, size, *block_);
            cost += weigh(*block_, pixels_ + 2 * begin, information_ + begin, size, 0.0);
            add_products(*block_, products, N_COLUMNS);
        }
        by_parameters(products);
        add_by_radial(penalties_.orthogonality, 0.0, vector, false);
        add_circularity(vector);
        for (size_t i = 0; i < penalties_.angles; ++i)
            add_by_radial(penalties_.slope_by_radial + RADIALS * i, penalties_.ideal_slope[i], vector, true);
        fill_upper(normal.data(), PARAMETERS);
        if (!std::isfinite(cost)) cost = INFINITY;
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

    void add(const Row& row, double value) {
        for (int i = 0; i < PARAMETERS; ++i) {
            if (row[i] == 0.0) continue;
            gradient[i] -= row[i] * value;
            for (int j = 0; j <= i; ++j) normal[i * PARAMETERS + j] += row[i] * row[j];
        }
        cost += 0.5 * value * value;
    }

    // c1, and c3 where the radius falls: linear in the radial coefficients.
    void add_by_radial(const double* by, double value, const Table& vector, bool if_negative) {
        for (int k = 0; k < RADIALS; ++k) value += by[k] * vector[RADIAL + k];
        if (if_negative && !(value < 0.0)) return;
        Row row = {};
        std::copy(by, by + RADIALS, row + RADIAL);
        add(row, value);
    }

    // c2: how far the edge's image lies from the principal point, less the mean of that.
    void add_circularity(Table vector) {
        constexpr double UPRIGHT[] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
        const size_t n = penalties_.azimuths;
        Block& edge = *block_;
        std::fill(&vector[X0], &vector[RADIAL], 0.0);  // about the principal point, in the camera's frame
        if (!penalties_.with_decentering) std::fill(&vector[DECENTERING], vector.data() + PARAMETERS, 0.0);
        write_block(vector.data(), {optics_.code, -1.0, INFINITY}, UPRIGHT, UPRIGHT, penalties_.edge, n, edge);
        double distance[BLOCK], mean = 0.0;
        Row rows[BLOCK] = {}, mean_row = {};
        for (size_t i = 0; i < n; ++i) {
            const double x = edge.pixel[0][i], y = edge.pixel[1][i];
            distance[i] = std::hypot(x, y), mean += distance[i] / n;
            for (int k = 0; k < N_LENS; ++k) {
                const int parameter = PARAMETER_OF[k];
                if (parameter == X0 || parameter == Y0) continue;
                if (parameter >= DECENTERING && !penalties_.with_decentering) continue;
                rows[i][parameter] = (x * edge.columns[k][0][i] + y * edge.columns[k][1][i]) / distance[i];
                mean_row[parameter] += rows[i][parameter] / n;
            }
        }
        for (size_t i = 0; i < n; ++i) {
            for (int j = 0; j < PARAMETERS; ++j) rows[i][j] = penalties_.circularity * (rows[i][j] - mean_row[j]);
            add(rows[i], penalties_.circularity * (distance[i] - mean));
        }
    }
};

nb::tuple paper_fit(int code, double mirror, double max_angle, Vectors directions, Places pixels, Numbers information,
                    In<double, RADIALS> orthogonality, double circularity, Vectors edge, bool with_decentering,
                    Numbers ideal_slope, In<double, -1, RADIALS> slope_by_radial, In<double, PARAMETERS> start,
                    Indices moving, int most_steps, double least_gain, double first_damping) {
    require_projection(code);
    require(pixels.shape(0) == directions.shape(0), "not as many pixels as directions");
    require(information.shape(0) == directions.shape(0), "not as many weights as directions");
    require(edge.shape(0) >= 1 && edge.shape(0) <= BLOCK, "not 1 to 64 directions of the edge");
    require(slope_by_radial.shape(0) == ideal_slope.shape(0), "not as many rows as slopes");
    const auto free = checked(moving, PARAMETERS, "a parameter that moves is none");
    Out<double> result({PARAMETERS}), normal({PARAMETERS, PARAMETERS});
    double cost;
    {
        nb::gil_scoped_release unlocked;
        const Penalties penalties{orthogonality.data(), edge.data(),      ideal_slope.data(), slope_by_radial.data(),
                                  circularity,          with_decentering, edge.shape(0),      ideal_slope.shape(0)};
        const Optics optics{code, mirror, max_angle};
        Equations here(optics, penalties, directions, pixels, information);
        Equations there(optics, penalties, directions, pixels, information);
        Table at(start.data(), start.data() + PARAMETERS);
        cost = minimise(here, there, free, most_steps, least_gain, first_damping, at);
        std::copy(at.begin(), at.end(), result.data);
        std::copy(here.normal.begin(), here.normal.end(), normal.data);
    }
    return nb::make_tuple(result.array(), cost, normal.array());
}

}  // namespace

void add_paper(nb::module_& module) {
    module.def("paper_fit", &paper_fit, nb::arg("code"), nb::arg("mirror"), nb::arg("max_angle"), named("directions"),
               named("pixels"), named("information"), named("orthogonality"), nb::arg("circularity"), named("edge"),
               nb::arg("with_decentering"), named("ideal_slope"), named("slope_by_radial"), named("start"),
               named("moving"), nb::arg("most_steps"), nb::arg("least_gain"), nb::arg("first_damping"));
}

}  // namespace sunarc
