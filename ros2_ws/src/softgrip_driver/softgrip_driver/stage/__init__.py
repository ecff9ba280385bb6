# SPDX-License-Identifier: Apache-2.0
"""A linear stage or a test stand as a tendon drive."""
