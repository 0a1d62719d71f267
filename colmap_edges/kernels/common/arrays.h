// Array types of the bindings, their checks, and the conversion of C++ vectors to numpy.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <initializer_list>
#include <stdexcept>
#include <utility>
#include <vector>

#include "common/vectors.h"

namespace colmap_edges {

namespace nb = nanobind;

template <typename T, typename Shape>
using InArray = nb::ndarray<const T, Shape, nb::c_contig, nb::device::cpu>;

template <typename T>
using OutArray = nb::ndarray<nb::numpy, T>;

using Points2D = InArray<double, nb::shape<-1, 2>>;
using Points3D = InArray<double, nb::shape<-1, 3>>;
using Rotation = InArray<double, nb::shape<3, 3>>;
using Translation = InArray<double, nb::shape<3>>;
using Doubles = InArray<double, nb::ndim<1>>;
using Ints = InArray<int32_t, nb::ndim<1>>;
using Longs = InArray<int64_t, nb::ndim<1>>;
using Bools = InArray<bool, nb::ndim<1>>;

inline void Require(bool holds, const char* message) {
  if (!holds) throw std::invalid_argument(message);
}

// Checks CSR offsets of `total` points.
inline void CheckOffsets(const Longs& offsets, size_t total) {
  Require(offsets.size() > 0 && offsets(0) == 0 && offsets(offsets.size() - 1) == int64_t(total),
          "offsets must start at 0 and end at the number of points");
  for (size_t i = 1; i < offsets.size(); ++i) {
    Require(offsets(i) >= offsets(i - 1), "offsets must not decrease");
  }
}

inline void CheckOffsets(const Longs& offsets, size_t count, size_t total) {
  Require(offsets.size() == count + 1, "offsets must have one more entry than items");
  CheckOffsets(offsets, total);
}

inline void CheckViews(const Ints& views, size_t num_views) {
  for (size_t i = 0; i < views.size(); ++i) {
    Require(views(i) >= 0 && views(i) < int64_t(num_views), "view index out of range");
  }
}

inline std::vector<int64_t> ToVector(const Longs& values) {
  return {values.data(), values.data() + values.size()};
}

// Moves `values` into a numpy array of the given shape that owns them.
template <typename T>
OutArray<T> ToArray(std::vector<T>&& values, std::initializer_list<size_t> shape) {
  auto* owned = new std::vector<T>(std::move(values));
  nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return OutArray<T>(owned->data(), shape, owner);
}

}  // namespace colmap_edges
