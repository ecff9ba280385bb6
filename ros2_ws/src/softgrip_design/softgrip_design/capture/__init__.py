# SPDX-License-Identifier: Apache-2.0
"""From pictures of a hand to grasp motions: frames, landmarks, angles, motions, their kinds."""
