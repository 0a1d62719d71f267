// Entry of the bindings of edge fields, correspondences and following.
#pragma once

#include <nanobind/nanobind.h>

namespace colmap_edges {

void BindTracing(nanobind::module_& m);

}  // namespace colmap_edges
