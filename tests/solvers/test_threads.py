"""Work on several threads: the same results for any number, and one thread where others work."""

import multiprocessing
import os
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.sparse import csr_array
from threadpoolctl import ThreadpoolController, threadpool_info, threadpool_limits

import esfem_core as ec
from esfem_core.solvers import products, side_by_side, thread_count, threads, times, using_threads
from esfem_core.solvers.multifrontal import factorise


def test_results_come_in_the_order_of_the_items():
    def slow_at_first(i):
        time.sleep(0.01 * (i == 0))
        return i

    with using_threads(3):
        assert side_by_side(slow_at_first, range(20)) == list(range(20))
        assert side_by_side(slow_at_first, []) == []


def test_several_threads_do_take_part():
    meet = threading.Barrier(2, timeout=5)  # passes when two threads wait
    with using_threads(2):
        side_by_side(lambda _: meet.wait(), range(2))


def test_what_is_not_worth_it_stays_on_this_thread():
    with using_threads(2):
        found = side_by_side(lambda _: threading.current_thread(), range(9), worth=False)
    assert set(found) == {threading.current_thread()}


def test_the_first_item_that_fails_is_reported():
    def fail(i):
        if i in (3, 4):
            time.sleep(0.01 * (4 - i))
            raise ValueError(f"item {i}")

    for number in (1, 2):
        with using_threads(number), pytest.raises(ValueError, match="item 3"):
            side_by_side(fail, range(9))


def test_inside_an_item_all_goes_on_one_thread():
    with using_threads(2):
        assert side_by_side(lambda _: thread_count(), range(4)) == [1] * 4
        assert thread_count() == 2


def test_settings_of_numpy_hold_on_all_threads():
    with using_threads(2), np.errstate(divide="raise"):
        assert side_by_side(lambda _: np.geterr()["divide"], range(4)) == ["raise"] * 4


class TestDefault:
    @pytest.fixture(autouse=True)
    def environment(self, monkeypatch):
        monkeypatch.delenv("OMP_NUM_THREADS", raising=False)

    def test_one_for_each_processor(self):
        assert thread_count() == len(os.sched_getaffinity(0))

    @pytest.mark.parametrize(("said", "count"), [("1", 1), ("5", 5), (" 3,2", 3), ("999", 256)])
    def test_the_environment_is_obeyed(self, monkeypatch, said, count):
        monkeypatch.setenv("OMP_NUM_THREADS", said)
        assert thread_count() == count

    @pytest.mark.parametrize("said", ["", "0", "many", "-1"])
    def test_nonsense_in_the_environment_is_not(self, monkeypatch, said):
        monkeypatch.setenv("OMP_NUM_THREADS", said)
        assert thread_count() == len(os.sched_getaffinity(0))

    def test_one_where_blas_has_threads_that_cannot_be_held_back(self, monkeypatch):
        monkeypatch.setattr(threads, "_blas_pools", lambda: None)
        for name in threads.BLAS_THREADS:
            monkeypatch.delenv(name, raising=False)
        assert thread_count() == 1
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
        assert thread_count() == len(os.sched_getaffinity(0))

    def test_one_in_threads_that_others_have_started(self):
        with ThreadPoolExecutor(1) as pool:
            assert pool.submit(thread_count).result() == 1

    def test_one_in_worker_processes(self, monkeypatch):
        monkeypatch.setattr(threads, "parent_process", multiprocessing.current_process)
        assert thread_count() == 1


class TestBlas:
    """Other threads than these make products of matrices, unless they are held back."""

    @pytest.fixture(autouse=True)
    def two_threads(self):
        with threadpool_limits(2, user_api="blas"):
            yield

    @staticmethod
    def counts():
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    def test_works_on_one_thread_while_ours_do(self):
        with using_threads(2):
            assert side_by_side(lambda _: self.counts(), range(2)) == [{1}, {1}]
            with using_threads(1):
                assert self.counts() == {1}
            assert self.counts() == {1}
        assert self.counts() == {2}

    def test_also_if_nobody_has_said_how_many(self, monkeypatch):
        monkeypatch.setenv("OMP_NUM_THREADS", "2")
        assert side_by_side(lambda _: self.counts(), range(2)) == [{1}, {1}]
        assert self.counts() == {2}

    def test_libraries_that_are_loaded_after_a_run_are_held_as_well(self, monkeypatch):
        class Controller(ThreadpoolController):
            def limit(self, *, limits):
                held.append(limits)
                return super().limit(limits=limits)

        held = []
        with using_threads(1):
            pass
        with monkeypatch.context() as later:
            later.setattr("threadpoolctl.ThreadpoolController", Controller)
            later.setitem(sys.modules, "a module that loads a library", threads)
            with using_threads(1):
                assert held == [1]

    def test_until_the_last_of_several_callers_is_done(self):
        first, second = using_threads(1), using_threads(1)
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        assert self.counts() == {1}
        second.__exit__(None, None, None)
        assert self.counts() == {2}

    def test_also_after_a_failure(self):
        with pytest.raises(ZeroDivisionError), using_threads(2):
            side_by_side(lambda i: 1 / i, range(3))
        assert self.counts() == {2}

    def test_between_the_steps_of_a_run_it_has_its_own(self):
        space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
        seen = []
        problem = ec.Problem(
            u0=lambda x: x[:, 0], f=lambda at: seen.append(self.counts()) or 0 * at.u
        )
        for _ in ec.evolve(space, problem, 1, 0.1, 0.2):
            assert self.counts() == {2}
        assert seen == [{1}] * 2


@pytest.mark.parametrize("number", [0, 257, 1.5, "2"])
def test_other_numbers_are_refused(number):
    with pytest.raises((TypeError, ValueError), match="threads must be an integer"):
        using_threads(number).__enter__()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks here")
@pytest.mark.filterwarnings("ignore:.*fork")
def test_a_forked_process_starts_threads_of_its_own():
    with using_threads(2):
        side_by_side(abs, range(4))
        child = os.fork()
        if child == 0:
            os._exit(side_by_side(abs, range(4)) != [0, 1, 2, 3])
    for _ in range(500):
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            break
        time.sleep(0.01)
    else:
        os.kill(child, 9)
        pytest.fail("the forked process waits for threads that it does not have")
    assert status == 0


def test_products_are_those_of_scipy(monkeypatch):
    kept = np.random.default_rng(0).random((700, 500))
    A = csr_array(np.where(kept < 0.02, kept, 0))
    x = np.random.default_rng(1).standard_normal((500, 3))
    monkeypatch.setattr(products, "ROWS", 64)
    monkeypatch.setattr(products, "LEAST", 0)
    for number in (1, 2, 3):
        with using_threads(number):
            np.testing.assert_array_equal(times(A, x), A @ x)
            np.testing.assert_array_equal(times(A, x[:, 0]), A @ x[:, 0])


def test_solves_have_the_same_bits(monkeypatch):
    """A cut tree, too, which only large meshes have."""
    monkeypatch.setattr("esfem_core.solvers.fronts.SMALL", 2)
    monkeypatch.setattr("esfem_core.solvers.multifrontal.LARGE", 0)
    space = ec.SurfaceSpace(ec.sphere("octahedron", 4), 2, ec.to_unit_sphere)
    M, A = space.mass_stiffness(space.nodes)
    b = np.random.default_rng(0).standard_normal((len(space.nodes), 3))
    solved = []
    for number in (1, 2, 3):
        with using_threads(number):
            solved.append(factorise(M + A, space.fronts, float).solve(b))
    assert space.fronts.subtrees == 4
    np.testing.assert_allclose((M + A) @ solved[0], b, rtol=0, atol=1e-11)
    for x in solved[1:]:
        np.testing.assert_array_equal(x, solved[0])


@pytest.mark.parametrize("mass", ["updated", "extrapolated"])
def test_runs_have_the_same_bits(monkeypatch, mass):
    monkeypatch.setattr("esfem_core.elements.integrals.CHUNK", 500)
    monkeypatch.setattr("esfem_core.elements.scatter.PIECE", 500)
    monkeypatch.setattr("esfem_core.elements.scatter.LEAST", 0)
    monkeypatch.setattr(products, "ROWS", 300)
    monkeypatch.setattr(products, "LEAST", 0)
    space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
    problem = ec.problems.growing_sphere()
    lasts = []
    for number in (1, 2, 3):
        *_, last = ec.evolve(space, problem, 2, 0.05, 0.5, mass=mass, threads=number)
        lasts.append(last)
    for last in lasts[1:]:
        for name in ("x", "v", "u"):
            np.testing.assert_array_equal(getattr(last, name), getattr(lasts[0], name))


def test_the_threads_of_a_run_are_not_those_of_its_caller():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    run = ec.evolve(space, ec.problems.growing_sphere(), 1, 0.1, 0.3, threads=7)
    before = thread_count()
    for _ in run:
        assert thread_count() == before


def test_a_run_refuses_other_numbers():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    with pytest.raises(ValueError, match="threads must be an integer from 1 to 256, got 0"):
        ec.evolve(space, ec.problems.growing_sphere(), 1, 0.1, 0.3, threads=0)
