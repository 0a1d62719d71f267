// Entry of the bindings of what is looked up in images.
#pragma once

#include <nanobind/nanobind.h>

namespace colmap_edges {

void BindImages(nanobind::module_& m);

}  // namespace colmap_edges
