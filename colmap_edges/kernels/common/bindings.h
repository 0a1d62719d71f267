// Entry points of the bindings, at least one for each folder of kernels.
#pragma once

#include <nanobind/nanobind.h>

namespace colmap_edges {

void BindCommon(nanobind::module_& m);
void BindImage(nanobind::module_& m);
void BindChains(nanobind::module_& m);
void BindFaces(nanobind::module_& m);
void BindFaceHypotheses(nanobind::module_& m);
void BindFaintLines(nanobind::module_& m);
void BindPaper(nanobind::module_& m);
void BindPatches(nanobind::module_& m);
void BindPoses(nanobind::module_& m);
void BindTexture(nanobind::module_& m);

}  // namespace colmap_edges
