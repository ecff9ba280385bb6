// SPDX-License-Identifier: Apache-2.0
// The roof of a solver that is bound by memory: how fast this machine reads a working set over and over.
#pragma once

#include <cstddef>

namespace softgrip::gdfe {

// Bytes per second at which `threads` threads read `bytes` of doubles; the best of `repeats` passes.
double read_bandwidth(std::size_t bytes, int threads, int repeats);

}  // namespace softgrip::gdfe
