# SPDX-License-Identifier: Apache-2.0
"""Run mutants against their tests, some at a time, and keep every result on disk so that a run can be resumed."""

from __future__ import annotations

import json
import queue
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from mutant import Mutant
from workshop import FAILED, PASSED, TestRun, Workshop, WorkshopError

#: a mutant's tests may take so many times what they take without it, plus [s], before they count as stuck
TEST_TIMEOUT_S = 5.0
START_S = 60.0

KILLED, STUCK, SURVIVED = "killed", "stuck", "survived"
#: passed its named tests; what the suite says is not known, so it is not kept
UNNOTICED = "unnoticed"


@dataclass(frozen=True)
class Result:
    """What became of one mutant.

    Attributes:
        area, id: of the mutant.
        digest: of mutant, file and tests; a result with another one is not reused.
        outcome: killed (a test failed), stuck (its tests did not end; counts as killed), survived, unnoticed (by its
            named tests, and the suite was not asked).
        by: the first test that failed, empty when none did.
        targeted: whether the tests named in the list noticed it; otherwise the area's suite did.
        seconds: that its tests took.
    """

    area: str
    id: str
    digest: str
    outcome: str
    by: str
    targeted: bool
    seconds: float


class Campaign:
    """Runs mutants.

    Args:
        root: the checkout.
        results: file of JSON lines; what it holds already, and still fits, is not run again.
        workers: copies of the sources, and mutants at a time.
        report: called with each new result.
        quick: run the named tests only.
    """

    def __init__(
        self, root: Path, results: Path, workers: int, report: Callable[[Result], None], *, quick: bool = False
    ) -> None:
        self._root = root
        self._path = results
        self._workers = workers
        self._report = report
        self._quick = quick
        self._unnoticed: dict[str, Result] = {}
        self._lock = threading.Lock()
        self._baselines: dict[tuple[str, ...], float] = {}
        self._failure: Exception | None = None

    def run(self, mutants: Sequence[Mutant]) -> list[Result]:
        """Return a result for each mutant.

        Raises:
            WorkshopError: the tests fail or can not be run without any mutant.
        """
        digests = {mutant.id: mutant.digest(self._root) for mutant in mutants}
        kept = {result.id: result for result in read_results(self._path) if result.digest == digests.get(result.id)}
        todo = [mutant for mutant in mutants if mutant.id not in kept]
        self._run_all([mutant for mutant in todo if not mutant.is_real_time], digests, self._workers)
        # These have the machine to themselves.
        self._run_all([mutant for mutant in todo if mutant.is_real_time], digests, 1)
        kept |= {result.id: result for result in read_results(self._path) if result.digest == digests.get(result.id)}
        kept |= self._unnoticed
        return [kept[mutant.id] for mutant in mutants]

    def _run_all(self, mutants: Iterable[Mutant], digests: dict[str, str], workers: int) -> None:
        todo: queue.SimpleQueue[Mutant] = queue.SimpleQueue()
        for mutant in mutants:
            todo.put(mutant)
        threads = [threading.Thread(target=self._work, args=(todo, digests)) for _ in range(min(workers, todo.qsize()))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        if self._failure is not None:
            raise self._failure

    def _work(self, todo: queue.SimpleQueue[Mutant], digests: dict[str, str]) -> None:
        folder = Path(tempfile.mkdtemp(prefix="softgrip-mutants-"))
        try:
            workshop = Workshop(self._root, folder)
            while self._failure is None:
                mutant = todo.get_nowait()
                self._keep(self._judge(workshop, mutant, digests[mutant.id]))
        except queue.Empty:
            return
        except Exception as error:  # noqa: BLE001  raised again by the thread that waits for all workers
            self._failure = error
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def _judge(self, workshop: Workshop, mutant: Mutant, digest: str) -> Result:
        seconds = 0.0
        for tests in (mutant.tests,) if self._quick else (mutant.tests, mutant.suite):
            limit_s = TEST_TIMEOUT_S * self._baseline(workshop, tests) + START_S
            with workshop.mutated(mutant):
                run = _run_until_sure(workshop, mutant, tests, limit_s)
            seconds += run.seconds
            if run.code is None or run.code == FAILED:
                outcome = STUCK if run.code is None else KILLED
                by = run.failed[0] if run.failed else ""
                return Result(mutant.area, mutant.id, digest, outcome, by, tests is mutant.tests, round(seconds, 1))
            if run.code != PASSED:
                raise WorkshopError(f"{mutant.id}: pytest ended with code {run.code}:\n{run.output}")
        outcome = UNNOTICED if self._quick else SURVIVED
        return Result(mutant.area, mutant.id, digest, outcome, "", False, round(seconds, 1))

    def _baseline(self, workshop: Workshop, tests: tuple[str, ...]) -> float:
        """Return how long tests take without a mutant [s]; they have to pass."""
        with self._lock:
            known = self._baselines.get(tests)
        if known is None:
            run = workshop.run_tests(tests, 3600.0)
            if run.code != PASSED:
                run = workshop.run_tests(tests, 3600.0)
            if run.code != PASSED:
                raise WorkshopError(f"expected {' '.join(tests)} to pass without a mutant, found:\n{run.output}")
            known = run.seconds
            with self._lock:
                self._baselines[tests] = known
        return known

    def _keep(self, result: Result) -> None:
        with self._lock:
            self._report(result)
            if result.outcome == UNNOTICED:
                self._unnoticed[result.id] = result
                return
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps({**asdict(result), "at": round(time.time())}) + "\n")


def read_results(path: Path) -> list[Result]:
    """Return what a results file holds, empty without one; a line that was cut short is left out."""
    results = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
        try:
            row = json.loads(line)
        except ValueError:
            continue
        row.pop("at", None)
        results.append(Result(**row))
    return results


def _run_until_sure(workshop: Workshop, mutant: Mutant, tests: tuple[str, ...], limit_s: float) -> TestRun:
    """Run tests; where they go by the machine's clock a failure has to repeat, for it may be the machine's."""
    run = workshop.run_tests(tests, limit_s)
    if run.code == FAILED and mutant.is_real_time:
        return workshop.run_tests(tests, limit_s)
    return run
