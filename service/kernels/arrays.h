// Arrays between Python and the loops: what comes in is checked, what goes out is new.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

// Compiled twice, for any processor and for one with AVX2; which is run is decided when the module is loaded.
#if defined(__x86_64__)
#define DISPATCHED __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define DISPATCHED
#endif
// A function that is called from a dispatched one takes part in its vector registers only where it is inlined.
#define INLINED static inline __attribute__((always_inline))

namespace sunarc {

namespace nb = nanobind;

// C order, of the processor, of exactly this type and shape (-1: any length); read-only arrays are taken too.
template <typename T, auto... lengths>
using In = nb::ndarray<const T, nb::shape<lengths...>, nb::c_contig, nb::device::cpu>;
using Numbers = In<double, -1>;
using Matrix = In<double, -1, -1>;
using Vectors = In<double, -1, 3>;  // directions
using Places = In<double, -1, 2>;   // pixels
using Rotation = In<double, 3, 3>;
using Indices = In<int64_t, -1>;

// The name of an array among the arguments; it is never converted: a copy would hide a wrong type or order.
inline auto named(const char* name) { return nb::arg(name).noconvert(); }

inline void require(bool holds, const char* problem) {
    if (!holds) throw nb::value_error(problem);
}

// The numbers of an array, from 0 to below `end`: a copy, which no other thread changes once it is checked.
template <typename Given>
std::vector<size_t> checked(const Given& given, size_t end, const char* problem) {
    std::vector<size_t> copy(given.data(), given.data() + given.size());
    for (size_t one : copy) require(one < end, problem);  // one below 0 is beyond all
    return copy;
}

// A new array, not initialised.
template <typename T>
struct Out {
    T* data;
    std::unique_ptr<T[]> owned;
    std::vector<size_t> shape;

    explicit Out(std::vector<size_t> lengths) : shape(std::move(lengths)) {
        size_t size = 1;
        for (size_t length : shape) size *= length;
        owned.reset(new T[size > 0 ? size : 1]);
        data = owned.get();
    }
    // Hand it to Python, with the interpreter's lock.
    nb::ndarray<nb::numpy, T> array() {
        nb::capsule owner(data, [](void* memory) noexcept { delete[] static_cast<T*>(memory); });
        T* memory = owned.release();
        return nb::ndarray<nb::numpy, T>(memory, shape.size(), shape.data(), owner);
    }
};
using Result = nb::ndarray<nb::numpy, double>;

void add_image(nb::module_& module);
void add_stars(nb::module_& module);

}  // namespace sunarc
