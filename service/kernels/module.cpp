// sunarc._kernels: the loops that numpy cannot do. What each returns stands in service/sunarc/_kernels.pyi.
#include "equations.h"

NB_MODULE(_kernels, module) {
    sunarc::add_displacement(module);
    sunarc::add_fit(module);
    sunarc::add_image(module);
    sunarc::add_inverse(module);
    sunarc::add_lens(module);
    sunarc::add_paper(module);
    sunarc::add_posterior(module);
    sunarc::add_stars(module);
    sunarc::add_tables(module);
}
