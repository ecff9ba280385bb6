# SPDX-License-Identifier: Apache-2.0
"""One shift of the cell: the operator and the cell controller in one client, its report and summary."""
