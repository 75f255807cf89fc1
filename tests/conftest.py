"""What all tests share: real data, a browser, and the account of what was left out.

A test that needs an optional thing asks a fixture for it and is skipped, with the reason, where it is
missing. With ``SIGHTLINE_REQUIRE_ALL=1`` nothing may be left out: such a skip is then a failure.
A skip whose reason begins with "not applicable" is one that no installation could change.

The tests find real data through ``SIGHTLINE_DATA``, by default in ``../shared/data``. The package finds them
only where a test hands them over: the variable is not set while tests run.
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cloudpickle
import pytest

from shared_setup import made_once
from sightline.io.results import line_of_sight
from sightline.io.results.schema import check_summary

REQUIRE_ALL = os.environ.get("SIGHTLINE_REQUIRE_ALL", "") not in ("", "0")
ROOT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("SIGHTLINE_DATA", ROOT / ".." / "shared" / "data")).resolve()

#: Files whose tests take ten seconds or more, the longest first: those that recover strips, and all others.
LONGEST = (
    (
        "applications/test_instruments.py", "applications/test_line_of_sight.py", "test_cli_recover.py",
        "applications/test_fusion.py", "applications/test_relief.py", "applications/test_hybridise.py",
        "applications/test_unlike_bands.py", "motion/strip/test_withheld.py", "test_cli_register.py",
        "test_cli_tdi.py", "report/test_hostile_names.py", "kinds/test_kinds.py",
        "applications/test_registration.py", "motion/strip/test_alternatives.py",
        "estimation/test_likelihood.py", "test_examples.py",
    ),
    (
        "applications/test_sequence_bad_input.py", "applications/test_frame_attitude.py",
        "applications/test_sequence_poses.py", "fuzz/test_fuzz.py", "applications/test_frame_cube.py",
        "applications/test_tdi_lines.py", "applications/test_focal_plane.py", "test_cli_output.py",
        "test_read_only.py", "io/stereo/test_load.py", "photogrammetry/block/test_bundle.py",
        "photogrammetry/flight/test_focal.py", "applications/test_spin_attitude.py",
        "simulate/test_sequence.py", "motion/frames/test_solve.py", "products/test_resample.py",
        "simulate/test_scenarios.py", "photogrammetry/test_triangulate.py",
        "photogrammetry/flight/test_poses.py", "test_cli_georeference.py",
        "photogrammetry/pair/test_plane.py", "test_cli_orient.py",
        "applications/test_stereo_orientation.py", "imaging/test_noise_estimation.py",
        "io/results/test_tdi_table.py", "fuzz/test_cases.py", "motion/layout/test_search.py",
    ),
)  # fmt: skip

_write_json = line_of_sight.write_json


def _write_checked_json(path: Path, content: Mapping[str, Any]) -> None:
    """Every summary that a test has written follows the published schema."""
    _write_json(path, content)
    if path.name == "summary.json":
        check_summary(path.read_text(encoding="utf-8"))


# before any module takes it by its name
line_of_sight.write_json = _write_checked_json


@pytest.fixture(scope="session", autouse=True)
def no_data_by_default() -> Iterator[None]:
    """The package is given no folder of real data, but by tests that name it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("SIGHTLINE_DATA", raising=False)
        yield


@pytest.fixture(scope="session")
def real_data() -> Callable[[str], Path]:
    """Folder of one real data set by its name, for example ``real_data("landsat7_everest")``."""

    def folder(name: str) -> Path:
        found = DATA / name
        if not found.is_dir():
            pytest.skip(f"real data set {name} not found; set SIGHTLINE_DATA to the folder that holds it")
        return found

    return folder


@pytest.fixture(scope="session")
def recovery(tmp_path_factory) -> SimpleNamespace:
    """A small rendered strip and what `sightline recover` made of it: folders `scene` and `folder`, the
    `printed` summary, and the objects behind the files (`result`, `acquisition`, `summary`, and `solved`: the
    strip, the last state of its estimate, the result)."""
    base = made_once(tmp_path_factory, "recovery", _recover)
    kept = cloudpickle.loads((base / "kept.pkl").read_bytes())
    return SimpleNamespace(scene=base / "scene", folder=base / "result", **kept)


def _recover(base: Path) -> None:
    """What `recovery` is made of, in a folder of all processes."""
    from sightline.applications import line_of_sight
    from sightline.cli.main import run
    from sightline.kinds import recovery as results

    scene, folder, kept = base / "scene", base / "result", {}
    written, solve = results.write_result, line_of_sight.joint_line_of_sight

    def keep(to, result, acquisition, **options):
        kept["summary"] = written(to, result, acquisition, **options)
        kept.update(result=result, acquisition=acquisition)
        return kept["summary"]

    def keep_solved(*given):
        kept["solved"] = solve(*given)
        return kept["solved"]

    size = ["--lines", "640", "--columns", "320"]
    assert run(["simulate", "line-of-sight", "--seed", "3", *size, "--out", str(scene)]) == 0
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(said):
        patch.setattr(results, "write_result", keep)
        patch.setattr(line_of_sight, "joint_line_of_sight", keep_solved)
        assert run(["recover", str(scene / "acquisition.toml"), "--out", str(folder), "--json"]) == 0
    (base / "kept.pkl").write_bytes(cloudpickle.dumps(kept | {"printed": said.getvalue()}))


@pytest.fixture(scope="session")
def browser() -> Iterator[object]:
    """A headless Chromium driven by playwright."""
    playwright = pytest.importorskip("playwright.sync_api", reason="the playwright package is not installed")
    names = ("chromium", "chromium-browser", "google-chrome", "chrome")
    found = next(filter(None, map(shutil.which, names)), None)
    if found is None:
        pytest.skip("no Chromium found to open report pages with")
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield chromium
        chromium.close()


@pytest.fixture
def open_page(browser) -> Iterator[Callable[[Path], tuple[object, list[str]]]]:
    """Function that opens a local HTML file: the page, and every console error or request it made."""
    contexts = []

    def open_file(path: Path) -> tuple[object, list[str]]:
        context = browser.new_context(viewport={"width": 1280, "height": 900})
        contexts.append(context)
        page, problems = context.new_page(), []
        page.on("console", lambda said: problems.append(said.text) if said.type == "error" else None)
        page.on("pageerror", lambda error: problems.append(str(error)))
        own = path.resolve().as_uri()
        local = (own, "data:", "blob:", "about:")
        page.on("request", lambda sent: None if sent.url.startswith(local) else problems.append(sent.url))
        page.goto(own, wait_until="load")
        return page, problems

    yield open_file
    for context in contexts:
        context.close()


def pytest_addoption(parser) -> None:
    """``--done FILE``: run what an earlier run, perhaps of another clone, left out or did not pass."""
    parser.addoption(
        "--done", metavar="FILE", type=Path, help="leave out the tests that FILE lists; add those that pass"
    )


def _longest_first(items) -> list[Any]:
    """The same tests, those of long files first: of strips at once, of all else where the second half begins.

    Of two workers each is handed one half: nothing long is left for the end, when one would wait for the
    other, and each compiles kernels that the other finds ready.
    """
    places: dict[Path, tuple[int, int]] = {
        ROOT / "tests" / name: (group, place)
        for group, names in enumerate(LONGEST)
        for place, name in enumerate(names)
    }
    missing = [str(path) for path in places if not path.is_file()]
    if missing:
        raise pytest.UsageError(f"LONGEST of tests/conftest.py names no file: {', '.join(missing)}")
    items = sorted(items, key=lambda item: item.path)  # the order in which both workers know them
    rank = {item: places.get(item.path, (len(LONGEST), 0)) for item in items}
    strips, others, short = (
        sorted((item for item in items if rank[item][0] == group), key=lambda item: rank[item])
        for group in range(len(LONGEST) + 1)
    )
    before = max(0, len(items) // 2 - len(strips))
    return [*strips, *short[:before], *others, *short[before:]]


def pytest_collection_modifyitems(config, items) -> None:
    """Leave out what is listed as done; begin with what takes long."""
    file = config.getoption("done")
    if file and file.is_file():
        done = set(file.read_text(encoding="utf-8").splitlines())
        config.hook.pytest_deselected(items=[item for item in items if item.nodeid in done])
        items[:] = [item for item in items if item.nodeid not in done]
    items[:] = _longest_first(items)


def _refuse_skip(report) -> None:
    """Make a skip of something optional a failure, where nothing may be left out."""
    if REQUIRE_ALL and report.skipped and not hasattr(report, "wasxfail"):
        reason = _reason(report)
        if not reason.startswith("not applicable"):
            report.outcome = "failed"
            report.longrepr = f"left out, though SIGHTLINE_REQUIRE_ALL allows nothing to be: {reason}"


def _reason(report) -> str:
    said = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    return said.removeprefix("Skipped: ")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    _refuse_skip(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    """Of two workers the second reads folders from the end, and so finds half of all files compiled."""
    report = yield
    _refuse_skip(report)
    if os.environ.get("PYTEST_XDIST_WORKER") == "gw1" and isinstance(collector, pytest.Directory):
        report.result.reverse()
    return report


def pytest_terminal_summary(terminalreporter, config) -> None:
    """Name what was left out, and why; list what is done, where that is asked for."""
    stats = terminalreporter.stats
    file = config.getoption("done")
    if file and not hasattr(config, "workerinput"):  # of all workers at once
        names = {
            kind: {report.nodeid for report in stats.get(kind, ())} for kind in ("passed", "failed", "error")
        }
        with file.open("a", encoding="utf-8") as listed:
            listed.writelines(
                f"{name}\n" for name in sorted(names["passed"] - names["failed"] - names["error"])
            )
    reasons = Counter(_reason(report) for report in stats.get("skipped", ()))
    if reasons:
        terminalreporter.section("left out")
        for reason, count in sorted(reasons.items()):
            terminalreporter.line(f"{count} test{'s' if count > 1 else ''}: {reason}")
