// The extension module with the bindings of all folders of kernels.
#include "common/bindings.h"

NB_MODULE(_kernels, m) {
  m.doc() = "Hot loops of colmap_edges";
  colmap_edges::BindCommon(m);
  colmap_edges::BindImage(m);
  colmap_edges::BindChains(m);
  colmap_edges::BindFaces(m);
  colmap_edges::BindFaceHypotheses(m);
  colmap_edges::BindFaintLines(m);
  colmap_edges::BindPaper(m);
  colmap_edges::BindPatches(m);
  colmap_edges::BindPoses(m);
  colmap_edges::BindTexture(m);
}
