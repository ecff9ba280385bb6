# SPDX-License-Identifier: Apache-2.0
"""The camera that looks at the index finger from the side: optics, picture, and motion JPEG over HTTP."""
