// Array types of the bindings and the one way to hand a C++ vector to numpy.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <initializer_list>
#include <utility>
#include <vector>

namespace colmap_edges {

namespace nb = nanobind;

template <typename T, typename Shape>
using InArray = nb::ndarray<const T, Shape, nb::c_contig, nb::device::cpu>;

template <typename T>
using OutArray = nb::ndarray<nb::numpy, T>;

// Moves `values` into a numpy array of the given shape that owns them.
template <typename T>
OutArray<T> ToArray(std::vector<T>&& values, std::initializer_list<size_t> shape) {
  auto* owned = new std::vector<T>(std::move(values));
  nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return OutArray<T>(owned->data(), shape, owner);
}

}  // namespace colmap_edges
