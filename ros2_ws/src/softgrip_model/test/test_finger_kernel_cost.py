# SPDX-License-Identifier: Apache-2.0
"""What the compiled kernel promises beside its numbers: Python runs meanwhile, and its loops ask for no memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import threading
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from softgrip_model.finger import Kernel, _core, follow
from softgrip_model.finger.design import core_design, core_friction
from softgrip_model.finger.published import OPTIMISED_ROUTING_MM, chapter_3_finger, chapter_4_finger
from softgrip_model.friction.published import published

LAW = published("braid-tpu-chapter4").law


@pytest.fixture
def no_forced_switches() -> Iterator[None]:
    """Threads give Python's lock away only of their own accord."""
    usual = sys.getswitchinterval()
    sys.setswitchinterval(1000.0)
    yield
    sys.setswitchinterval(usual)


def _works() -> dict[str, Callable[[], object]]:
    """Calls of the kernel alone: numpy, too, lets go of the lock where it has much to do, so it prepares before."""
    rng = np.random.default_rng(1)
    finger, pulls = chapter_4_finger("power"), np.linspace(0.1, 12.0, 40)
    kernel = Kernel([finger], LAW).varied(rng.uniform(2.5, 5.0, (40, 3)), rng.uniform(5.0, 13.0, (40, 6)))
    thesis, twine = core_design(chapter_3_finger(OPTIMISED_ROUTING_MM, 13.0)), core_friction(published("twine-tpu").law)
    recipe = _core.Replication(0.9, 0.75, 35.0, 0.05, 0)
    return {
        "nothing": lambda: None,
        "solve": lambda: kernel.solve(pulls[:10], gradient=True, threads=1),
        "follow": lambda: follow(finger, LAW, pulls),
        "replicate": lambda: _core.replicate(thesis, twine, 400, 0.05, recipe),
    }


@pytest.mark.parametrize("name", ["nothing", "solve", "follow", "replicate"])
@pytest.mark.usefixtures("no_forced_switches")
def test_python_runs_while_the_kernel_computes(name: str) -> None:
    """The waiting thread gets the lock only where the kernel lets go of it."""
    work, begun, seen, working = _works()[name], threading.Event(), threading.Event(), [False]

    def again_and_again() -> None:
        begun.set()
        for _ in range(500):
            working[0] = True
            work()
            working[0] = False
            if seen.is_set():
                return

    worker = threading.Thread(target=again_and_again)
    worker.start()
    begun.wait(60.0)
    if working[0]:
        seen.set()
    worker.join(60.0)
    assert seen.is_set() is (name != "nothing")


COUNTER = """
#include <stddef.h>
extern void *__libc_malloc(size_t), *__libc_calloc(size_t, size_t), *__libc_realloc(void *, size_t);
extern void *__libc_memalign(size_t, size_t);
static unsigned long asked;
unsigned long times_asked_for_memory(void) { return asked; }
void *malloc(size_t size) { ++asked; return __libc_malloc(size); }
void *calloc(size_t count, size_t size) { ++asked; return __libc_calloc(count, size); }
void *realloc(void *old, size_t size) { ++asked; return __libc_realloc(old, size); }
void *aligned_alloc(size_t alignment, size_t size) { ++asked; return __libc_memalign(alignment, size); }
"""


CALLS = {
    "laws": "lambda n: [core_friction(known) for _ in range(n)]",
    "closing": "lambda n: one.solve(pulls(n), 0, True, True, 1)",
    "direct": "lambda n: one.solve(pulls(n), 0, False, False, 1)",
    "batch": "lambda n: fingers[n].solve(np.full((n, 3), 9.0), 0, False, True, 1)",
    "failures": "lambda n: fingers[n].solve(np.tile([5.0, 90.0, np.nan], (n, 1)), 0, True, True, 1)",
    "path": "lambda n: _core.follow(design, law, up_and_down[n], 0, contacts, settings)",
}
SCRIPT = """
import ctypes, json
import numpy as np
from softgrip_model.finger import Cylinder, _core
from softgrip_model.finger.design import core_design, core_friction
from softgrip_model.finger.path import _core_contact
from softgrip_model.finger.published import chapter_4_finger
from softgrip_model.friction.published import published

finger, known = chapter_4_finger("power"), published("braid-tpu-chapter4").law
design, law = core_design(finger), core_friction(known)
one = _core.Fingers([design], [law])
fingers = {n: _core.Fingers([design] * n, [law] * n) for n in (1000, 2000)}
up_and_down = {n: np.tile([0.5, 1.0, 0.5, 0.0], n // 4).tolist() for n in (1000, 2000)}
contacts = [_core_contact(finger, Cylinder((55.0, -50.0), 20.0))]
settings = _core.PathSettings(0.25, 0.5, 1e-6)
pulls = lambda n: np.linspace(0.01, 20.0, n)[None]
asked = ctypes.CDLL(None).times_asked_for_memory
asked.restype = ctypes.c_ulong
counts = {}
for name, call in CALLS.items():
    for n in (1000, 2000, 1000, 2000):  # the first of each warms caches up
        before = asked()
        call(n)
        counts[f"{name} {n}"] = asked() - before
print(json.dumps(counts))
"""


@pytest.fixture(scope="module")
def more(tmp_path_factory: pytest.TempPathFactory) -> dict[str, int]:
    """How often more memory is asked for in a call of 2000 elements than in one of 1000."""
    folder = tmp_path_factory.mktemp("counter")
    source, library = folder / "counter.c", folder / "counter.so"
    source.write_text(COUNTER, encoding="utf-8")
    compiler = sysconfig.get_config_var("CC").split()[0]
    subprocess.run([compiler, "-O1", "-fPIC", "-shared", "-o", str(library), str(source)], check=True)
    calls = ", ".join(f"{name!r}: {call}" for name, call in CALLS.items())
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT.replace("CALLS.items()", f"{{{calls}}}.items()")],
        env={**os.environ, "LD_PRELOAD": str(library)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    counts = json.loads(run.stdout)
    return {name: counts[f"{name} 2000"] - counts[f"{name} 1000"] for name in CALLS}


def test_the_counter_sees_every_allocation(more: dict[str, int]) -> None:
    """Each law made is an object of the core."""
    assert more["laws"] >= 1000


@pytest.mark.parametrize("call", [name for name in CALLS if name != "laws"])
def test_no_memory_is_asked_for_in_the_loop(call: str, more: dict[str, int]) -> None:
    """Twice the work takes the same few arrays."""
    assert abs(more[call]) < 20
