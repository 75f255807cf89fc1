"""``sightline demo``: the main job on a scene it renders, and the result against the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from sightline.cli.options import ORBIT_CASES, STRIP_CASES, Json, Overwrite, Seed

# Part of a strip: long enough for the tones and the longest lag, done in a minute or two.
LINES, COLUMNS = 2000, 600

#: A TDI detector in the place of the panchromatic line, for the strip that comes next.
TDI = """name = "TDI settings for the next strip"

[grid]
stages = { from = 3, to = 64 }
integration_ratio = { from = 0.2, to = 1.0, step = 0.1 }

[head]
stages = 2
integration_ratio = 0.2

[noise]
gain = 9e-6
read = 12.0

[columns]
acquisition = "scene/acquisition.toml"
band = "PAN"

[signals]
from = 5
to = 2000
count = 32

[mtf]
aperture_x = 0.9
aperture_y = 0.9
diffusion_sigma_px = 0.2
optics_mtf = 0.35
"""


def demo(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write.")] = Path("demo"),
    case: Annotated[
        str, typer.Option("--case", metavar="CASE", help=f"One of: {', '.join(STRIP_CASES)}.")
    ] = "relief",
    seed: Seed = 1,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Render a strip, recover its line of sight, score it against the truth, set a TDI detector by it."""
    from sightline.cli.output import output_folder
    from sightline.cli.recover import recover_into
    from sightline.cli.score import score_folder
    from sightline.cli.tdi import choose_into, tell
    from sightline.cli.terminal import print_json, progress, say
    from sightline.errors import InputError
    from sightline.io.formats.json_text import json_text
    from sightline.simulate.files import write_strip
    from sightline.simulate.scenarios import line_of_sight_case

    if case in ORBIT_CASES:
        raise InputError(
            f"case {case!r} is not for `demo`, which takes {', '.join(STRIP_CASES)}; use `sightline simulate "
            f"line-of-sight --case {case}`, then `recover` and `score`"
        )
    with output_folder(out, overwrite=overwrite) as folder, progress() as report:
        scene, result = folder / "scene", folder / "result"
        scene.mkdir()
        result.mkdir()
        report(f"rendering a strip of 4 bands, case {case}, seed {seed}")
        scenario = line_of_sight_case(case, seed, lines=LINES, columns=COLUMNS)
        write_strip(scenario, scene, star_tracker=True, gyro=True)
        summary = recover_into(result, scene / "acquisition.toml", report, truth=scene / "truth.csv")
        report("scoring against the truth")
        scored = score_folder(result, scene / "truth.csv")
        (folder / "score.json").write_text(json_text(scored) + "\n", encoding="utf-8")
        (folder / "tdi.toml").write_text(TDI, encoding="utf-8")
        (folder / "tdi").mkdir()
        settings = choose_into(folder / "tdi", folder / "tdi.toml", result, report, pictures=True)
    if as_json:
        both = {"score": scored, "summary": summary, "tdi": settings}
        print_json(both | {"report": out / "result" / "report.html"})
    else:
        _tell(out, scored, summary)
        say("TDI stages and integration time for a detector that moves like this strip did:")
        tell(settings)
        say(f"report  {out / 'tdi' / 'report.html'}")


def _tell(out: Path, scored: dict[str, Any], summary: dict[str, Any]) -> None:
    """The score as a small table, and where to look next."""
    from sightline.cli.terminal import say
    from sightline.report.words import grouped

    unseen = grouped(summary["hidden_directions"]["words"])
    say(f"against the truth, which the estimate never saw; {unseen}, unseen by images, left out:")
    for axis in ("roll", "pitch", "yaw"):
        found = scored[axis]
        say(
            f"  {axis:5}  error {found['rms']:.4f} {found['unit']} rms, claimed sigma {found['sigma']:.4f},"
            f" NEES {found['nees']:.2f}, {100.0 * found['coverage_95']:.1f} % within 1.96 sigma"
        )
    for axis, found in scored["absolute"].items():
        say(
            f"  {axis:5}  error of the whole angle {found['rms']:.4f} {found['unit']} rms, claimed sigma "
            f"{found['sigma']:.4f} (tied by the star tracker and the gyro)"
        )
    say(f"scene   {out / 'scene' / 'acquisition.toml'}")
    say(f"result  {out / 'result'}")
    say(f"report  {out / 'result' / 'report.html'}")
