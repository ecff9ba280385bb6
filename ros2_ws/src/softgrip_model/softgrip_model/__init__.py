# SPDX-License-Identifier: Apache-2.0
"""What physics says: friction, finger kinematics, stiffness, GDFE."""
