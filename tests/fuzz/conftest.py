"""Seeds, and the process in which cases are run."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.fuzz.hunt import Hunter
from tests.fuzz.seeds import build

from shared_setup import made_once


@pytest.fixture(scope="session")
def seeds(tmp_path_factory) -> Path:
    """All seeds; made by the first process of a session that needs them."""
    return made_once(tmp_path_factory, "fuzz-seeds", build)


@pytest.fixture(scope="session")
def hunter(seeds, tmp_path_factory):
    work = tmp_path_factory.mktemp("hunt")
    with Hunter(seeds, work / "work", work / "failing", "tests.fuzz.planted") as made:
        yield made
