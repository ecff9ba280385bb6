# SPDX-License-Identifier: Apache-2.0
"""What the kernel's thread that carries a serial port's bytes waits for on a busy computer.

That thread (tty's work queue) is an ordinary one. With autogroups on, the kernel shares a processor out among sessions
before it looks at threads, and the thread is as one of them: measured with sched_switch, it stood runnable for 92 ms
while the programs of one session took turns. Sources: sched(7), "The autogroup feature"; docs/driver.md, "Timing".
"""

from __future__ import annotations

from pathlib import Path

SETTING = Path("/proc/sys/kernel/sched_autogroup_enabled")
#: what is wrong, and what helps
AUTOGROUP_REMEDY = (
    "the bus' bytes wait for the programs of a whole session (autogroups): `sudo sysctl "
    "kernel.sched_autogroup_enabled=0` ends that; docs/build/computer.md has it for good"
)


def has_autogroups(setting: Path = SETTING) -> bool:
    """Return whether the kernel shares processors out among sessions; False where it does not know them."""
    try:
        return setting.read_text(encoding="ascii").strip() not in {"", "0"}
    except (OSError, UnicodeDecodeError):
        return False
