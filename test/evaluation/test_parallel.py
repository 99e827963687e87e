"""Calls spread over processes and over a Dask cluster."""

from __future__ import annotations

import math
import os
import sys
from typing import Any

import pytest

from estimation.errors import InputError
from evaluation.parallel import ClusterError, cluster, each


def test_results_come_in_order() -> None:
    assert each(math.hypot, [(3 * k, 4 * k) for k in range(20)]) == [5.0 * k for k in range(20)]
    with cluster("") as threads:
        assert threads == 1


def test_two_local_workers_do_the_calls() -> None:
    pytest.importorskip("distributed", reason="dask is optional: requirements/evaluation.txt")
    with cluster("local:2") as threads:
        assert threads == 2
        assert each(math.hypot, [(3 * k, 4 * k) for k in range(20)]) == [5.0 * k for k in range(20)]
        where = set(each(os.getpid, [()] * 20))
    assert os.getpid() not in where


def test_without_dask_the_option_says_what_to_install(monkeypatch: Any) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(ClusterError, match=r"pip install -r requirements/evaluation\.txt"),
        cluster("local:2"),
    ):
        pass


@pytest.mark.parametrize("address", ["local:", "local:none", "local:0", "somewhere"])
def test_addresses_that_are_none_are_refused(address: str) -> None:
    pytest.importorskip("distributed", reason="dask is optional: requirements/evaluation.txt")
    with pytest.raises(InputError, match="--dask"), cluster(address):
        pass
