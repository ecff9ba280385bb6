# SPDX-License-Identifier: Apache-2.0
"""Parts to print, from a profile and a hand file (docs/parts.md); lengths in mm, as parts are printed in mm.

What a part is (`Form`) is plain geometry and needs nothing but numpy. `solid` makes solids of it with build123d, an
extra.
"""
