# SPDX-License-Identifier: Apache-2.0
"""The same results by any number of workers, resumed, with a worker killed in the middle; failures listed."""

from __future__ import annotations

import asyncio
import json
import sys
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from softgrip_design.design import Task
from softgrip_design.optimiser import optimise
from softgrip_design.trajectory import SHIPPED, load
from softgrip_model.friction.published import published
from softgrip_sweep import ResultsStore, SweepError, SweepTask, dask_pool, run_sweep
from softgrip_sweep.commands import sweep
from softgrip_sweep.intervals import wilson
from softgrip_sweep.pools import WORKER_DEATHS_ALLOWED
from softgrip_sweep.studies import bags, designs, grasps
from softgrip_testing.dask_computers import dask_computers
from softgrip_testing.virtual_grasps import ProductSet
from softgrip_testing.waiting import wait_until

HERE = Path(__file__).parent
BAGS = HERE.parents[3] / "tests/replay/bags"
SMALL = designs.DesignSpace(motions=("power",), profiles=("power",), samples=20)
SPACE = designs.DesignSpace(motions=("power",), profiles=("power",), samples=700)


class Inline(Executor):
    """Does everything at once in this process; counts."""

    def __init__(self):
        self.count = 0

    def submit(self, work, /, *args, **kwargs):
        self.count += 1
        future = Future()
        try:
            future.set_result(work(*args, **kwargs))
        except Exception as error:  # noqa: BLE001  an executor keeps whatever a task raises
            future.set_exception(error)
        return future


@pytest.fixture(autouse=True)
def work(monkeypatch):
    """Make sweep_work importable here and in the workers."""
    monkeypatch.syspath_prepend(str(HERE))
    monkeypatch.setenv("PYTHONPATH", str(HERE), prepend=":")
    yield
    sys.modules.pop("sweep_work", None)


def squares(count):
    return [SweepTask("sweep_work:square", {"number": number}) for number in range(count)]


def contents(store):
    return {path.name: path.read_bytes() for path in (store.folder / "results").iterdir()}


def test_a_task_has_the_same_key_whatever_the_order_of_its_arguments():
    one, two = SweepTask("m:f", {"a": 1, "b": 2}), SweepTask("m:f", {"b": 2, "a": 1})
    assert one.key == two.key
    assert len({one.key, SweepTask("m:f", {"a": 1, "b": 3}).key, SweepTask("m:g", {"a": 1, "b": 2}).key}) == 3


def test_a_sweep_goes_on_where_it_was(tmp_path):
    store, pool, seen = ResultsStore(tmp_path), Inline(), []
    run_sweep(squares(3), store, pool)
    summary = run_sweep(squares(5), store, pool, lambda: seen.append(1))
    assert (summary.done, summary.resumed, summary.failed) == (2, 3, ())
    assert (pool.count, len(seen)) == (5, 5)
    assert [store.load(task)["square"] for task in squares(5)] == [0, 1, 4, 9, 16]


def test_a_failure_is_listed_kept_and_tried_again(tmp_path):
    store, pool = ResultsStore(tmp_path), Inline()
    bad = SweepTask("sweep_work:fail", {"number": 7})
    for _ in range(2):
        summary = run_sweep([*squares(2), bad], store, pool)
        ((task, error),) = summary.failed
        assert task == bad
        assert "no square of 7" in error
    assert pool.count == 4  # the squares once, the failure twice
    assert "Traceback" in store.failure(bad)
    store.save(bad, {"square": 49})
    assert store.failure(bad) is None
    assert run_sweep([bad], store, pool).resumed == 1


def test_a_damaged_result_is_named(tmp_path):
    store = ResultsStore(tmp_path)
    (task,) = squares(1)
    store.save(task, {"square": 0})
    next((tmp_path / "results").iterdir()).write_text("{")
    with pytest.raises(SweepError, match="delete it"):
        store.load(task)


def test_a_scheduler_that_is_not_there_is_named(monkeypatch):
    monkeypatch.setattr("softgrip_sweep.pools.CONNECT_TIMEOUT_S", 0.5)
    with pytest.raises(SweepError, match="dask scheduler"), dask_pool(scheduler="tcp://127.0.0.1:9"):
        pass


def test_one_and_two_workers_give_the_same_designs_to_the_bit(tmp_path):
    tasks = designs.tasks(SPACE)
    assert len(tasks) == 3  # a profile, 500 samples and 200
    inline = ResultsStore(tmp_path / "inline")
    run_sweep(tasks, inline, Inline())
    two = ResultsStore(tmp_path / "two")
    with dask_pool(2) as pool:
        assert run_sweep(tasks, two, pool).done == 3
    assert contents(inline) == contents(two)
    every = [one for task in tasks for one in two.load(task)]
    assert len(every) == 701
    # the optimiser's own measure of the best, one design at a time; and no sample beats what it finds
    best = designs.best(every)[0]
    objective = Task(published("braid-tpu-chapter4").law).objective(load(SHIPPED / "hand_power.csv"), "index")
    value = 2.0 * best["error_deg"] + best["force_n"]
    assert objective.value(np.array(best["design_mm"])) == pytest.approx(value, rel=1e-5)
    assert optimise(objective).value < value


def test_a_killed_worker_changes_nothing(tmp_path):
    tasks = [
        *squares(6),
        SweepTask("sweep_work:die_once", {"number": 6, "folder": str(tmp_path)}),
        SweepTask("sweep_work:die_once", {"number": 7, "folder": str(tmp_path)}),
    ]
    store = ResultsStore(tmp_path / "results")
    with dask_pool(2) as pool:
        summary = run_sweep(tasks, store, pool)
    assert summary.failed == ()
    assert [store.load(task)["square"] for task in tasks] == [number**2 for number in range(8)]
    assert (tmp_path / "died-6").exists()
    assert (tmp_path / "died-7").exists()


class LostResults(Inline):
    """Gives the first results as Dask's executor gives that of a worker which died before it had come."""

    def __init__(self, lost):
        super().__init__()
        self._lost = lost

    def submit(self, work, /, *args, **kwargs):
        done = super().submit(work, *args, **kwargs)
        return done if self.count > self._lost else asyncio.run(lost(done.result()))


async def lost(result):
    from distributed.cfexecutor import _cascade_future  # noqa: PLC0415  an extra

    async def once_there(*, raiseit):
        return result

    future = Future()
    await _cascade_future(SimpleNamespace(_result=once_there, status="lost"), future)
    return future


def test_a_result_that_its_worker_takes_with_it_is_made_again(tmp_path):
    store, pool = ResultsStore(tmp_path), LostResults(1)
    summary = run_sweep(squares(3), store, pool)
    assert (summary.done, summary.failed, pool.count) == (3, (), 4)
    assert [store.load(task)["square"] for task in squares(3)] == [0, 1, 4]


def test_a_task_whose_workers_all_take_its_result_with_them_is_listed(tmp_path):
    summary = run_sweep(squares(1), ResultsStore(tmp_path), pool := LostResults(100))
    assert [task for task, _ in summary.failed] == squares(1)
    assert pool.count == 1 + WORKER_DEATHS_ALLOWED


def test_a_computer_of_a_cluster_is_switched_off_in_the_middle(tmp_path):
    # two workers with folders of their own behind a scheduler, by Dask's own command
    tasks = [SweepTask("sweep_work:square_once_released", {"number": k, "folder": str(tmp_path)}) for k in range(6)]
    store = ResultsStore(tmp_path / "results")
    with dask_computers(tmp_path / "network") as computers, ThreadPoolExecutor(1) as thread:
        with dask_pool(scheduler=computers.scheduler) as pool:
            sweeping = thread.submit(run_sweep, tasks, store, pool)
            first, second = computers.workers
            wait_until(lambda: all([*tmp_path.glob(f"begun-*-{one.pid}")] for one in computers.workers), "both at work")
            first.kill()
            first.wait()
            (tmp_path / "go").touch()
            assert sweeping.result().failed == ()
        (lost,) = tmp_path.glob(f"begun-*-{first.pid}")
        again = tmp_path / lost.name.replace(str(first.pid), str(second.pid))
        assert (lost.read_text(), again.read_text()) == tuple(
            str(tmp_path / "network" / f"computer_{k}") for k in (1, 2)
        )
        assert [store.load(task)["square"] for task in tasks] == [k**2 for k in range(6)]
        # the one that is left does real work, with the same results to the bit as this process
        here, there = ResultsStore(tmp_path / "here"), tmp_path / "there"
        run_sweep(designs.tasks(SMALL), here, Inline())
        arguments = ["designs", "--motions", "power", "--profiles", "power", "--samples", "20", "--results", str(there)]
        assert sweep.main([*arguments, "--scheduler", computers.scheduler]) == 0
    assert contents(here) == contents(ResultsStore(there))


def test_wilson_interval_of_a_textbook():
    # Newcombe 1998, Statistics in Medicine 17, table I, method 3: 81 of 263 and 0 of 20
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)


def test_virtual_grasps_are_the_same_in_this_process_and_by_the_command(tmp_path, capsys):
    names = ["grape", "frozen_pizza"]
    (task,) = [t for t in grasps.tasks([1], [ProductSet.PUBLISHED], names) if t.arguments["finger_set"] == "pinch"]
    store = ResultsStore(tmp_path)
    run_sweep([task], store, Inline())
    arguments = ["grasps", "--cells", "1", "--product-sets", "B", "--products", *names, "--results"]
    assert sweep.main([*arguments, str(tmp_path / "command"), "--workers", "1", "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["finger_set"] for line in lines] == ["power", "pinch", "hook"]
    assert lines[1]["result"] == store.load(task)
    found = grasps.grasps(task, store.load(task))
    check = grasps.cross_check(found, ProductSet.PUBLISHED, "")
    # 5 g of grape between two fingers; 695 g of frost, which the thesis could not hold for long either
    assert [(item.product, item.outcomes) for item in check.tried] == [
        ("grape", ("GRIPPED",)),
        ("frozen_pizza", ("SLIPPED",)),
    ]
    assert grasps.rows(check)[0][2] == "1/1 [21, 100] = success"


def test_bags_are_replayed_and_a_changed_one_is_noticed(tmp_path):
    folder = BAGS / "closings"
    assert bags.find_bags([BAGS])
    # the grasps were recorded with a scripted driver, not with the predictor
    with pytest.raises(SweepError, match="without any of these"):
        bags.tasks([BAGS / "grasps"], ["kinematics_predictor"])
    (task,) = bags.tasks([folder], ["kinematics_predictor"], tolerance=1e-6)
    result = bags.replay_bag(**task.arguments)
    assert result["verdict"] == "identical"
    assert result["compared"] > 1000
    with pytest.raises(SweepError, match="found another"):
        bags.replay_bag(**{**task.arguments, "digest": "0" * 16})
    with pytest.raises(SweepError, match=r"no metadata\.yaml"):
        bags.find_bags([tmp_path])
