"""The examples in the docstrings of geometry run and print what they say."""

from __future__ import annotations

import doctest
import importlib
import pkgutil

import pytest

import sightline.geometry

MODULES = [module.name for module in pkgutil.iter_modules(sightline.geometry.__path__)]


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_run(name):
    found = doctest.testmod(importlib.import_module(f"sightline.geometry.{name}"))
    assert found.failed == 0
