// SPDX-License-Identifier: Apache-2.0
// The polar rotation and the volume correction of an element that is flat or inside out: its invariants give none.
#pragma once

namespace softgrip::gdfe {

// det F below which an element is treated here.
inline constexpr double kInvertedBelow = 1e-3;

// f, rotation, correction: 3x3 row by row. rotation has det +1; correction pushes the volume back up, bounded.
void rotation_and_volume_of_inverted(const double* f, double* rotation, double* correction);

}  // namespace softgrip::gdfe
