# SPDX-License-Identifier: Apache-2.0
"""What really happens in the emulated cell: motors, tendons, fingers and products. Its laws and numbers are its own."""
