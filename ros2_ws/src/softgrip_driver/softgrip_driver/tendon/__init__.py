# SPDX-License-Identifier: Apache-2.0
"""What a tendon drive does, whatever device pulls: units, guards, trajectories, homing, the controller, the loop."""
