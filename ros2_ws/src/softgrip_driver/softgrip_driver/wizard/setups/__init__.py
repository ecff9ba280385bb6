# SPDX-License-Identifier: Apache-2.0
"""Set-ups of the drives that this package knows, one module a make (softgrip_driver.wizard.drive_setup)."""
