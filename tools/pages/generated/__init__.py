# SPDX-License-Identifier: Apache-2.0
"""The reference, page by page, from the code itself."""
