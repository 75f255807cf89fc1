"""One camera at a window of the ISS: its constant boresight error about the orbit frame, and what is weak.

Run: python examples/iss_stereo.py [OUT]
     sightline orient OUT/stereo.toml --out result      # the same, with files and a page

Ten photographs, six seconds apart: time in place of a second camera. EXIF times are cut to the second (7 km
along the track); its positions lie within 100 m of an even flight. Not in the sigmas: a delay common to all
positions (0.06 degrees of pitch per second) and terrain that slopes as a whole (350 m in 200 km: 0.1 degrees
of roll). The lens is what `sightline recover` finds. Clouds are masked.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from iss_frames import ALTITUDE, DATA, GROUND, GROUND_SIGMA, write_cloud_mask

from sightline.applications.frame_attitude import mount_by_motion
from sightline.applications.stereo_orientation import orient
from sightline.io.acquisition.load import load_acquisition
from sightline.io.formats.exif import write_photo_acquisition
from sightline.io.stereo.load import read_stereo
from sightline.photogrammetry.pair.match_problem import match_problem

LENS = """shape = [972, 1296]\nfocal_length_px = 1032.0\nfocal_length_sigma_px = 6.3
principal_point_px = [443.4, 664.2]\ndistortion = [0.0172, 0.0262, -0.00048, 0.00258, -0.0585]"""
# px: what the lens leaves unexplained; m: scatter of positions; rad: of the station about its mean attitude
NOISE = "sigma_px = 0.1\nsigma_position = 100.0\nsigma_attitude = 1e-3"

if {"-h", "--help"} & set(sys.argv):
    print(__doc__)
    sys.exit()
out = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp(prefix="iss-stereo-"))
photos = sorted((DATA / "iss_astropi_a").glob("*.jpg"))
if not photos:
    sys.exit(f"no photographs in {DATA / 'iss_astropi_a'}; set SIGHTLINE_DATA to the folder of real data")
out.mkdir(parents=True, exist_ok=True)
known = load_acquisition(write_photo_acquisition(photos, out, height=ALTITUDE))
mount = mount_by_motion(known.frames, known.surface).body_from_camera.as_quat().tolist()
poses, images = "camera,shot,t,x,y,z,qx,qy,qz,qw\n", "camera,shot,image,mask\n"
for shot, frame in enumerate(known.frames):
    pose = frame.camera.trajectory.at(frame.camera.t)
    numbers = np.concatenate([[shot, frame.camera.t], pose.position[0], pose.world_from_body[0].as_quat()])
    poses += "iss," + ",".join(f"{value:.17g}" for value in numbers) + "\n"
    mask = write_cloud_mask(frame.image.read((0, 972), (0, 1296)), out / f"clouds_{shot}.npy")
    images += f"iss,{shot},{photos[shot].resolve()},{mask.name}\n"
stereo_toml = f"""cameras = "cameras.csv"\nimages = "images.csv"\n[camera]\n{LENS}
body_from_camera = {mount}\n[noise]\n{NOISE}\n[surface]\nheight = {GROUND}\nheight_sigma = {GROUND_SIGMA}\n"""
for name, text in {"cameras.csv": poses, "images.csv": images, "stereo.toml": stereo_toml}.items():
    (out / name).write_text(text)
stereo = read_stereo(out / "stereo.toml")
found = orient(match_problem(stereo.problem, stereo.pictures.sources, surface=stereo.surface, floor_px=0.1))
print(
    "boresight error, degrees:", np.degrees(found.angles[0]).round(3), f"of {len(found.rejected)} sightings"
)
for sigma, direction in zip(found.observability.sigmas, found.observability.directions, strict=True):
    print(f"± {np.degrees(sigma):.3f} degrees along (roll, pitch, yaw) = {direction.round(2)}")
print(f"{found.rejected.sum()} sightings left out", *found.warnings, sep="; ")
