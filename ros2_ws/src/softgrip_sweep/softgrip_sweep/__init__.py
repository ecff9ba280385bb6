# SPDX-License-Identifier: Apache-2.0
"""Many tasks at once: what is done (`SweepTask`), what came out (`ResultsStore`), and who does it (`run_sweep`)."""

from softgrip_sweep.engine import SweepSummary, run_sweep
from softgrip_sweep.errors import SweepError
from softgrip_sweep.pools import dask_pool, process_pool
from softgrip_sweep.store import ResultsStore
from softgrip_sweep.task import SweepTask

__all__ = ["ResultsStore", "SweepError", "SweepSummary", "SweepTask", "dask_pool", "process_pool", "run_sweep"]
