# SPDX-License-Identifier: Apache-2.0
"""From a human demonstration to a printable finger: capture, trajectory, optimisation, geometry."""
