# SPDX-License-Identifier: Apache-2.0
"""Cable friction: the laws, their fit with uncertainty, the models that were published.

Start with `published("braid-tpu")` or `fit(measurements, Law.MATTE)`.
"""
