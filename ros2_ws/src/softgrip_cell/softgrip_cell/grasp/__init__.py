# SPDX-License-Identifier: Apache-2.0
"""Grasping: what a closing tells about the object between the fingers. Pure: stepped with observations, replayable."""
