"""Seeds, and the process in which cases are run."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
from tests.fuzz.hunt import Hunter
from tests.fuzz.seeds import build

#: s for which other processes wait for the seeds.
MOST_WAITED = 300


@pytest.fixture(scope="session")
def seeds(tmp_path_factory) -> Path:
    """All seeds; made by the first process of a session that needs them."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        root = tmp_path_factory.mktemp("fuzz") / "seeds"
        build(root)
        return root
    root = tmp_path_factory.getbasetemp().parent / "fuzz-seeds"
    try:
        root.with_suffix(".taken").mkdir()
    except FileExistsError:
        for _ in range(MOST_WAITED * 5):
            if root.is_dir():
                return root
            time.sleep(0.2)
        pytest.fail("the process that makes the seeds has not made them")
    build(root.with_suffix(".made"))
    root.with_suffix(".made").rename(root)
    return root


@pytest.fixture(scope="session")
def hunter(seeds, tmp_path_factory):
    work = tmp_path_factory.mktemp("hunt")
    with Hunter(seeds, work / "work", work / "failing", "tests.fuzz.planted") as made:
        yield made
