"""docs/validation.md: each script of validation/ has its block, and a block knows how old it is."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = sorted((ROOT / "validation").glob("*.py"))
BENCHMARKS = sorted((ROOT / "benchmarks").glob("*.py"))
if not SCRIPTS:
    pytest.skip("not applicable: validation/ is not part of this copy", allow_module_level=True)


@pytest.fixture(scope="module")
def gates():
    """validation/gates.py, which is no part of the package."""
    spec = importlib.util.spec_from_file_location("gates_of_validation", ROOT / "validation" / "gates.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_every_script_has_a_block_and_every_block_a_script(gates):
    scripts = {path.stem for path in SCRIPTS} - set(gates.HELPERS)
    assert set(gates.blocks()) == scripts
    marks = gates.DOCUMENT.read_text(encoding="utf-8").count("<!-- begin validation/")
    assert marks == len(scripts)


def test_a_block_older_than_the_code_that_it_measures_says_so(gates):
    wrong = gates.wrong_marks()
    assert not wrong, (
        "; ".join(f"the block of validation/{script}.py {what}" for script, what in wrong.items())
        + ": run the script without arguments, or `python validation/gates.py --mark`"
    )


@pytest.mark.parametrize("path", [*SCRIPTS, *BENCHMARKS], ids=lambda path: path.stem)
def test_what_a_script_takes_from_the_package_is_there(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("sightline"):
            module = importlib.import_module(str(node.module))
            missing = [
                one.name
                for one in node.names
                if not hasattr(module, one.name) and not _is_module(f"{node.module}.{one.name}")
            ]
            assert not missing, f"{node.module} has no {', '.join(missing)}"


def _is_module(name: str) -> bool:
    return importlib.util.find_spec(name) is not None


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_every_script_can_fail(gates, path):
    if path.stem in gates.HELPERS:
        return
    called = {
        ast.unparse(node.func) for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)
    }
    assert "gates.run" in called
    assert called & {"gates.check", "gates.note"}


SOURCE = '''
import numpy as np
from sightline.geometry.units import ARCSEC

#: px.
LIMIT = 0.5


def fit(points: np.ndarray, weights: np.ndarray) -> float:
    """Weighted mean."""
    total = weights.sum()
    if total <= 0.0:
        raise ValueError(f"weights add up to {total}")
    scaled = points * weights
    return float(scaled.sum() / total) * np.sin(LIMIT)


def other(a: float) -> float:
    return a - 1.0
'''


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("#: px.", "#: Pixels, along and across."),
        ('"""Weighted mean."""', '"""Mean by weight, in more words."""'),
        ("add up to", "are no weights: their sum is"),
        ("weights: np.ndarray", "weights"),
        ("import numpy as np\n", "import numpy as np\nfrom sightline.geometry import rotations\n"),
        ("scaled", "pulled"),
        ("    total = weights.sum()\n", "    total = (\n        weights.sum()\n    )\n"),
    ],
    ids=["comment", "docstring", "words of an error", "annotation", "import", "local name", "layout"],
)
def test_what_changes_no_result_leaves_a_block_as_young_as_it_was(gates, before, after):
    assert before in SOURCE
    assert gates.statements(SOURCE.replace(before, after)) == gates.statements(SOURCE)


def test_parts_of_modules_may_be_moved(gates):
    cut = SOURCE.index("def other")
    assert gates.statements(SOURCE[:cut]) | gates.statements(SOURCE[cut:]) == gates.statements(SOURCE)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("points * weights", "points / weights"),
        ("scaled.sum() / total", "total / scaled.sum()"),
        ("np.sin", "np.cos"),
        ("LIMIT = 0.5", "LIMIT = 0.6"),
        ("total <= 0.0", "total < 0.0"),
        ("points: np.ndarray, weights: np.ndarray", "weights: np.ndarray, points: np.ndarray"),
        ("a - 1.0", "1.0 - a"),
    ],
)
def test_what_may_change_a_result_makes_a_block_older(gates, before, after):
    assert before in SOURCE
    assert gates.statements(SOURCE.replace(before, after)) != gates.statements(SOURCE)


def test_the_code_measured_is_what_a_script_reaches_by_import(gates):
    reached = {path.name for path in gates.measured(ROOT / "validation" / "line_of_sight.py")}
    # the joint estimate, through what recovers a strip; nothing of pages, files or commands
    assert "normal_equations.py" in reached and "matches.py" in reached
    layers = {
        path.relative_to(gates.SOURCE / "sightline").parts[0]
        for path in gates.measured(ROOT / "validation" / "line_of_sight.py")
    }
    assert not layers & {"io", "report", "cli"}


@pytest.fixture
def scratch(gates, tmp_path, monkeypatch):
    """A document of one block, and no figures noted yet."""
    document = tmp_path / "validation.md"
    document.write_text("before\n" + gates.block("series", "0" * 12, f"*Old. {gates.OLDER}*") + "after\n")
    monkeypatch.setattr(gates, "DOCUMENT", document)
    monkeypatch.setattr(gates, "_figures", [])
    monkeypatch.setattr(sys, "argv", ["series.py"])
    return document


def test_a_missed_figure_ends_with_1_and_stands_in_the_block(gates, scratch):
    def main():
        print("| a | b |\n|---|---|\n| 1 | 2 |")
        gates.check("a good one", 1.0, 0.9, 1.1)
        gates.check("one too small", 0.5, 0.9, 1.1)
        gates.check("none at all", float("nan"), 0.9, 1.1)

    with pytest.raises(SystemExit) as ended:
        gates.run(main, "validation/series.py")
    assert ended.value.code == 1
    text = scratch.read_text()
    assert "| a good one | 1 | >= 0.9, <= 1.1 | yes |" in text
    assert "| one too small | 0.5 | >= 0.9, <= 1.1 | **NO** |" in text
    assert "| none at all | nan | >= 0.9, <= 1.1 | **NO** |" in text
    assert "| 1 | 2 |" in text and text.startswith("before\n") and text.endswith("after\n")
    assert not gates.wrong_marks()  # fresh, and says nothing of being old


def test_figures_that_are_met_end_with_0_and_none_at_all_does_not(gates, scratch, monkeypatch):
    with pytest.raises(SystemExit) as ended:
        gates.run(lambda: gates.check("one", 1.0, 1.0, 1.0), "validation/series.py")
    assert ended.value.code == 0
    monkeypatch.setattr(gates, "_figures", [])
    with pytest.raises(SystemExit) as ended:
        gates.run(lambda: None, "validation/series.py")
    assert ended.value.code not in (0, None)


def test_a_run_with_arguments_leaves_the_block(gates, scratch, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["series.py", "--trials", "1"])
    before = scratch.read_text()
    with pytest.raises(SystemExit):
        gates.run(lambda: gates.check("one", 1.0, 1.0, 1.0), "validation/series.py")
    assert scratch.read_text() == before


def test_marks_follow_the_code(gates, scratch):
    fresh = gates.block("series", gates.digest("series"), "*Now.*\n\n| a |\n")
    stale = gates.block("series", "0" * 12, "*Then.*\n\n| a |\n")
    scratch.write_text(stale)
    assert list(gates.wrong_marks()) == ["series"]
    gates.mark()
    assert f"*Then. {gates.OLDER}*" in scratch.read_text() and not gates.wrong_marks()
    scratch.write_text(fresh.replace("*Now.*", f"*Now. {gates.OLDER}*"))
    assert list(gates.wrong_marks()) == ["series"]
    gates.mark()
    assert scratch.read_text() == fresh and not gates.wrong_marks()


def test_bounds_of_nees_reject_sigmas_a_quarter_off(gates):
    low, high = gates.nees_bounds(300)
    assert low < 1.0 < high
    assert 1.25**-2 < low and high < 0.8**-2
