"""The public surface: `__all__` is what is there, sorted, and nothing heavy loads before it is used."""

from __future__ import annotations

import ast
import importlib
import inspect
import json
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import sightline
from sightline.version import VERSION

HEAVY = [
    "scipy", "numba", "rasterio", "jinja2", "pandas", "dask", "distributed", "xarray", "pyproj", "matplotlib",
]  # fmt: skip


def loaded_after(code: str) -> set[str]:
    """Top-level packages in memory after running `code` in a fresh interpreter."""
    probe = f"{code}\nimport json, sys\nprint(json.dumps(sorted({{m.split('.')[0] for m in sys.modules}})))"
    run = subprocess.run(
        [sys.executable, "-c", probe], capture_output=True, text=True, timeout=60, check=True
    )
    return set(json.loads(run.stdout.splitlines()[-1]))


def test_all_is_sorted_and_is_the_table_of_names():
    assert sightline.__all__ == sorted(sightline.__all__)
    assert sorted(sightline._MODULE_OF) == sightline.__all__
    assert list(sightline._MODULE_OF) == sightline.__all__


@pytest.mark.parametrize("name", sightline.__all__)
def test_every_public_name_loads_from_the_module_that_defines_it(name):
    value = getattr(sightline, name)
    assert value is getattr(importlib.import_module(sightline._MODULE_OF[name]), name)
    assert value.__module__ == sightline._MODULE_OF[name]
    assert inspect.getdoc(value)


def test_type_checkers_see_the_same_names():
    tree = ast.parse(Path(sightline.__file__).read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    seen = {
        alias.name: node.module
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == sightline._MODULE_OF


def test_dir_lists_the_public_names_and_an_unknown_one_is_an_attribute_error():
    assert dir(sightline) == sorted([*sightline.__all__, "__version__"])
    with pytest.raises(AttributeError, match="no attribute 'recover'"):
        sightline.recover  # noqa: B018


def test_the_version_is_that_of_the_installed_package():
    assert sightline.__version__ == VERSION == version("sightline-eo")


def test_importing_the_package_loads_nothing_heavy():
    assert loaded_after("import sightline").isdisjoint(HEAVY)


@pytest.mark.parametrize(
    "arguments", [["--help"], ["recover", "--help"], ["simulate", "line-of-sight", "--help"]]
)
def test_asking_for_help_loads_nothing_heavy(arguments):
    code = (
        "import contextlib, io, sys\n"
        "from sightline.cli.main import main\n"
        f"sys.argv = ['sightline', *{arguments!r}]\n"
        "with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.suppress(SystemExit):\n"
        "    main()\n"
        "assert 'Usage' in out.getvalue(), out.getvalue()\n"
    )
    assert loaded_after(code).isdisjoint([*HEAVY, "numpy"])
