"""Work in one thread."""

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from gnomon.kernel import one_blas_thread


def test_blas_works_in_one_thread_unless_the_environment_says_so_already(monkeypatch: pytest.MonkeyPatch) -> None:
    def threads() -> set[int]:
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    with threadpool_limits(2, user_api="blas"):
        several = threads()
        for name in names:
            monkeypatch.setenv(name, "1")
        with one_blas_thread():
            assert threads() == several
        monkeypatch.delenv(names[0])
        with one_blas_thread():
            assert threads() == {1}
        assert threads() == several
