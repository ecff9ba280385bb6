// SPDX-License-Identifier: Apache-2.0
// The instruction sets that this build has code for and this machine runs.
#pragma once

#include <string>
#include <vector>

namespace softgrip::gdfe {

// The one in use.
std::string simd_target();

// All that can be used here, best first; the last one is that of every machine.
std::vector<std::string> simd_targets();

// Use this one from here on, in the whole process; an empty name: the best. Throws std::invalid_argument for others.
void use_simd_target(const std::string& name);

}  // namespace softgrip::gdfe
