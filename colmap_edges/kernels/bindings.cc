// Python face of the kernels: converts arrays, releases the GIL, calls the core, converts back.
#include <nanobind/nanobind.h>

NB_MODULE(_kernels, m) { m.doc() = "Hot loops of colmap_edges"; }
