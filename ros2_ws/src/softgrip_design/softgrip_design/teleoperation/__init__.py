# SPDX-License-Identifier: Apache-2.0
"""A person's hand leads the fingers: from landmarks of a frame to pulled lengths, while a dead-man switch is held."""
