# SPDX-License-Identifier: Apache-2.0
"""The table of the camera's faults, printed after its tests."""


def pytest_terminal_summary(terminalreporter, config):
    """Print the table."""
    rows = getattr(config, "camera_fault_table", None)
    if not rows:
        return
    heads = ("fault", "on /diagnostics", "time to be named", "recovers by")
    widths = [max(len(row[i]) for row in [heads, *rows]) for i in range(len(heads))]
    terminalreporter.write_sep("=", "fault matrix: camera, 30 frames a second")
    for row in [heads, *rows]:
        terminalreporter.write_line("  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)))
