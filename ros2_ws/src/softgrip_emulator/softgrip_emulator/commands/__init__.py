# SPDX-License-Identifier: Apache-2.0
"""Commands of this package: `python -m softgrip_emulator.commands.NAME --help`."""
