"""One camera at a window of the ISS: its constant boresight error about the orbit frame, with what is not known.

Run: python examples/iss_stereo.py [OUT]
     sightline orient OUT/stereo.toml --out result      # the same, with files and a page

Ten photographs, six seconds apart, see the same ground from up to 400 km of baseline: time in place of a second
camera. EXIF times are cut to the second (7 km along the track), so positions are those EXIF gives; these lie within
100 m of an even flight. A delay common to all turns the vertical by 0.06 degrees per second and cannot be seen. The
lens is the one that `sightline recover` finds in these frames (see iss_frames.py). Clouds are masked.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from iss_frames import ALTITUDE, DATA, GROUND, GROUND_SIGMA, write_cloud_mask

from sightline.applications.frame_attitude import mount_by_motion
from sightline.applications.stereo_matching import match_problem
from sightline.applications.stereo_orientation import orient
from sightline.io.acquisition import load_acquisition
from sightline.io.exif import write_photo_acquisition
from sightline.io.stereo import read_stereo

# m: scatter of positions. rad: of the station about its mean attitude in a minute (general knowledge).
SIGMA_POSITION, SIGMA_ATTITUDE = 100.0, 1e-3
LENS = """shape = [972, 1296]
focal_length_px = 1032.0
focal_length_sigma_px = 6.3
principal_point_px = [443.4, 664.2]
distortion = [0.0172, 0.0262, -0.00048, 0.00258, -0.0585]"""


def main() -> None:
    """Write stereo.toml with its tables, then find the angles and say what is weak."""
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp(prefix="iss-stereo-"))
    photos = sorted((DATA / "iss_astropi_a").glob("*.jpg"))
    if not photos:
        print(f"no photographs in {DATA / 'iss_astropi_a'}; set SIGHTLINE_DATA to the folder of real data")
        return
    out.mkdir(parents=True, exist_ok=True)
    known = load_acquisition(
        write_photo_acquisition(photos, out, height=ALTITUDE, ground=(GROUND, GROUND_SIGMA))
    )
    mount = mount_by_motion(known.frames, known.surface).body_from_camera.as_quat().tolist()
    poses, images = ["camera,shot,t,x,y,z,qx,qy,qz,qw"], ["camera,shot,image,mask"]
    for shot, frame in enumerate(known.frames):
        t = frame.camera.t
        pose = frame.camera.trajectory.at(t)
        numbers = [t, *pose.position[0], *pose.world_from_body[0].as_quat()]
        poses.append(f"iss,{shot}," + ",".join(repr(float(value)) for value in numbers))
        pixels = frame.image.read((0, frame.image.shape[0]), (0, frame.image.shape[1]))
        mask = write_cloud_mask(pixels, out / f"clouds_{shot}.npy")
        images.append(f"iss,{shot},{photos[shot].resolve()},{mask.name}")
    (out / "cameras.csv").write_text("\n".join(poses) + "\n")
    (out / "images.csv").write_text("\n".join(images) + "\n")
    (out / "stereo.toml").write_text(
        f'cameras = "cameras.csv"\nimages = "images.csv"\n[camera]\n{LENS}\nbody_from_camera = {mount}\n'
        f"[noise]\nsigma_position = {SIGMA_POSITION}\nsigma_attitude = {SIGMA_ATTITUDE}\n"
        f"[surface]\nheight = {GROUND}\nheight_sigma = {GROUND_SIGMA}\n"
    )
    stereo = read_stereo(out / "stereo.toml")
    problem = match_problem(
        stereo.problem, stereo.pictures.sources, image=stereo.pictures.image, surface=stereo.surface
    )
    found = orient(problem)
    sigma = np.sqrt(np.diag(found.covariance)[:3])
    for name, angle, one in zip(("roll", "pitch", "yaw"), found.angles[0], sigma, strict=True):
        print(f"{name:5} {np.degrees(angle):+.3f} ± {np.degrees(one):.3f} degrees")
    print(f"{len(problem.tracks)} sightings, {found.rejected.sum()} left out; {found.warnings}")
    print("principal sigmas, degrees, weakest first:", np.degrees(found.observability.sigmas))
    print(found.observability.directions.round(2))


if __name__ == "__main__":
    main()
