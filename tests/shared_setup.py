"""Set-ups that take long, made once by the first of the processes of a session that needs them."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest

#: s for which other processes wait.
MOST_WAITED = 600


def made_once(factory: pytest.TempPathFactory, name: str, build: Callable[[Path], object]) -> Path:
    """The folder that `build` fills, once it is whole; tests leave it as it is.

    Where `build` fails, the next process tries it by itself.
    """
    alone = "PYTEST_XDIST_WORKER" not in os.environ
    base = factory.getbasetemp() if alone else factory.getbasetemp().parent
    root, taken, whole = (base / f"{name}{ending}" for ending in ("", ".taken", ".whole"))
    for _ in range(MOST_WAITED * 5):
        if whole.exists():
            return root
        try:
            taken.mkdir()
        except FileExistsError:
            time.sleep(0.2)
            continue
        if whole.exists():
            return root
        try:
            root.mkdir()
            build(root)
        except BaseException:
            shutil.rmtree(root)
            taken.rmdir()
            raise
        whole.touch()
        return root
    pytest.fail(f"the process that makes {name} has not made it")
