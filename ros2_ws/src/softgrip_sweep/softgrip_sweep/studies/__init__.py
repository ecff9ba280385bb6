# SPDX-License-Identifier: Apache-2.0
"""What is swept: each module lists tasks, does one, and makes a table of the results."""
