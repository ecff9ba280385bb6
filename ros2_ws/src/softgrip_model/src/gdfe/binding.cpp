// SPDX-License-Identifier: Apache-2.0
// Thin private binding of softgrip_model.gdfe._core.
#include <pybind11/pybind11.h>

PYBIND11_MODULE(_core, module) {
  module.doc() = "Private core of softgrip_model.gdfe.";
}
