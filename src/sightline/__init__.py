"""Sightline: where an Earth-observation camera was looking, from its own images, with error bars.

The public names are loaded when they are first used, so that ``import sightline`` stays quick.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from sightline import result as _result
from sightline.version import VERSION as __version__  # noqa: F401

if TYPE_CHECKING:
    from sightline.access import allow_network
    from sightline.applications.batch import Batch
    from sightline.applications.detector_noise import DetectorNoise
    from sightline.applications.focal_plane import FocalPlane, LayoutChoice, choose_layout
    from sightline.applications.frame_attitude import FrameAttitude, recover_frame_attitude
    from sightline.applications.frame_cube import CubeSummary, assemble_cube
    from sightline.applications.line_of_sight import recover_line_of_sight
    from sightline.applications.raster_matches import (
        BandMatches,
        RasterMatches,
        match_bands,
        match_rasters,
    )
    from sightline.applications.reference_tie import ReferenceTie, tie_to_reference
    from sightline.applications.registration import Registration, register_bands
    from sightline.applications.sequence_poses import SequencePoses, georeference_sequence
    from sightline.applications.spin_attitude import SpinAttitude, SpinOptions, recover_spin_attitude
    from sightline.applications.stereo_orientation import StereoOrientation, orient
    from sightline.applications.stereo_prediction import StereoPrediction
    from sightline.applications.tdi_choice import TdiProblem, TdiResult, choose_tdi
    from sightline.errors import (
        EstimationError,
        FormatError,
        GeometryError,
        InputError,
        SightlineError,
        SpanError,
        UnobservableBandWarning,
    )
    from sightline.evaluation.score import Score, score_motion
    from sightline.execution import Executor, executor_from_name
    from sightline.geometry.camera import Camera, FrameCamera, PushbroomCamera, Rays
    from sightline.geometry.conjugate import predict_match
    from sightline.geometry.instrument import AreaDetector, Instrument, LineDetector
    from sightline.geometry.pointing import FixedMount, Pointing, ScanMirror
    from sightline.geometry.spin import Spin
    from sightline.geometry.surface import Dem, Ellipsoid, Plane, Surface
    from sightline.geometry.trajectory import Motion, Pose, Trajectory
    from sightline.imaging.placed import PlacedImage
    from sightline.imaging.source import ArrayImage, ImageSource
    from sightline.imaging.tdi_noise import NoiseLaw
    from sightline.imaging.tdi_transfer import Exposure
    from sightline.io.acquisition.acquired import Acquisition
    from sightline.io.acquisition.load import load_acquisition
    from sightline.io.formats.images import load_raster
    from sightline.io.formats.junocam import write_junocam_acquisition
    from sightline.io.layout.load import load_instrument
    from sightline.io.results.hidden import remove_hidden
    from sightline.io.results.tdi_tags import read_tdi_tags
    from sightline.io.sequence.load import load_sequence
    from sightline.io.stereo.load import load_stereo
    from sightline.io.tdi.load import load_tdi
    from sightline.kinds.open import open_result
    from sightline.matching.follow import FollowPlan
    from sightline.matching.match_images import match_images
    from sightline.matching.matches import Matches
    from sightline.matching.select import grid_points
    from sightline.motion.band import Band, ChipKnowledge, Frame, LensKnowledge
    from sightline.motion.estimators.differences import AngleDifferences
    from sightline.motion.frames.passes import FrameOptions
    from sightline.motion.results import LineOfSight
    from sightline.motion.strip.strip import RecoverOptions
    from sightline.photogrammetry.flight.problem import SequenceProblem
    from sightline.photogrammetry.pair.problem import StereoProblem
    from sightline.products.cube_plan import CubePlan
    from sightline.products.frame_mosaic import Mosaic, frame_mosaic
    from sightline.result import Result
    from sightline.simulate.scenarios import line_of_sight_case
    from sightline.simulate.sequence import sequence_case
    from sightline.simulate.stereo import stereo_case
    from sightline.stages import Stages
    from sightline.tdi.choose import TdiChoice
    from sightline.tdi.setting import ChoiceRules, ScanColumns, TdiDetector, TdiGrid
    from sightline.tdi.table import TdiTable
    from sightline.tdi.tagging import TdiTags

# Public name -> module that defines it, sorted; `tests/test_public_api.py` compares it with what is there.
_MODULE_OF = {
    "Acquisition": "sightline.io.acquisition.acquired",
    "AngleDifferences": "sightline.motion.estimators.differences",
    "AreaDetector": "sightline.geometry.instrument",
    "ArrayImage": "sightline.imaging.source",
    "Band": "sightline.motion.band",
    "BandMatches": "sightline.applications.raster_matches",
    "Batch": "sightline.applications.batch",
    "Camera": "sightline.geometry.camera",
    "ChipKnowledge": "sightline.motion.band",
    "ChoiceRules": "sightline.tdi.setting",
    "CubePlan": "sightline.products.cube_plan",
    "CubeSummary": "sightline.applications.frame_cube",
    "Dem": "sightline.geometry.surface",
    "DetectorNoise": "sightline.applications.detector_noise",
    "Ellipsoid": "sightline.geometry.surface",
    "EstimationError": "sightline.errors",
    "Executor": "sightline.execution",
    "Exposure": "sightline.imaging.tdi_transfer",
    "FixedMount": "sightline.geometry.pointing",
    "FocalPlane": "sightline.applications.focal_plane",
    "FollowPlan": "sightline.matching.follow",
    "FormatError": "sightline.errors",
    "Frame": "sightline.motion.band",
    "FrameAttitude": "sightline.applications.frame_attitude",
    "FrameCamera": "sightline.geometry.camera",
    "FrameOptions": "sightline.motion.frames.passes",
    "GeometryError": "sightline.errors",
    "ImageSource": "sightline.imaging.source",
    "InputError": "sightline.errors",
    "Instrument": "sightline.geometry.instrument",
    "LayoutChoice": "sightline.applications.focal_plane",
    "LensKnowledge": "sightline.motion.band",
    "LineDetector": "sightline.geometry.instrument",
    "LineOfSight": "sightline.motion.results",
    "Matches": "sightline.matching.matches",
    "Mosaic": "sightline.products.frame_mosaic",
    "Motion": "sightline.geometry.trajectory",
    "NoiseLaw": "sightline.imaging.tdi_noise",
    "PlacedImage": "sightline.imaging.placed",
    "Plane": "sightline.geometry.surface",
    "Pointing": "sightline.geometry.pointing",
    "Pose": "sightline.geometry.trajectory",
    "PushbroomCamera": "sightline.geometry.camera",
    "RasterMatches": "sightline.applications.raster_matches",
    "Rays": "sightline.geometry.camera",
    "RecoverOptions": "sightline.motion.strip.strip",
    "ReferenceTie": "sightline.applications.reference_tie",
    "Registration": "sightline.applications.registration",
    "Result": "sightline.result",
    "ScanColumns": "sightline.tdi.setting",
    "ScanMirror": "sightline.geometry.pointing",
    "Score": "sightline.evaluation.score",
    "SequencePoses": "sightline.applications.sequence_poses",
    "SequenceProblem": "sightline.photogrammetry.flight.problem",
    "SightlineError": "sightline.errors",
    "SpanError": "sightline.errors",
    "Spin": "sightline.geometry.spin",
    "SpinAttitude": "sightline.applications.spin_attitude",
    "SpinOptions": "sightline.applications.spin_attitude",
    "Stages": "sightline.stages",
    "StereoOrientation": "sightline.applications.stereo_orientation",
    "StereoPrediction": "sightline.applications.stereo_prediction",
    "StereoProblem": "sightline.photogrammetry.pair.problem",
    "Surface": "sightline.geometry.surface",
    "TdiChoice": "sightline.tdi.choose",
    "TdiDetector": "sightline.tdi.setting",
    "TdiGrid": "sightline.tdi.setting",
    "TdiProblem": "sightline.applications.tdi_choice",
    "TdiResult": "sightline.applications.tdi_choice",
    "TdiTable": "sightline.tdi.table",
    "TdiTags": "sightline.tdi.tagging",
    "Trajectory": "sightline.geometry.trajectory",
    "UnobservableBandWarning": "sightline.errors",
    "allow_network": "sightline.access",
    "assemble_cube": "sightline.applications.frame_cube",
    "choose_layout": "sightline.applications.focal_plane",
    "choose_tdi": "sightline.applications.tdi_choice",
    "executor_from_name": "sightline.execution",
    "frame_mosaic": "sightline.products.frame_mosaic",
    "georeference_sequence": "sightline.applications.sequence_poses",
    "grid_points": "sightline.matching.select",
    "line_of_sight_case": "sightline.simulate.scenarios",
    "load_acquisition": "sightline.io.acquisition.load",
    "load_instrument": "sightline.io.layout.load",
    "load_raster": "sightline.io.formats.images",
    "load_sequence": "sightline.io.sequence.load",
    "load_stereo": "sightline.io.stereo.load",
    "load_tdi": "sightline.io.tdi.load",
    "match_bands": "sightline.applications.raster_matches",
    "match_images": "sightline.matching.match_images",
    "match_rasters": "sightline.applications.raster_matches",
    "open_result": "sightline.kinds.open",
    "orient": "sightline.applications.stereo_orientation",
    "predict_match": "sightline.geometry.conjugate",
    "read_tdi_tags": "sightline.io.results.tdi_tags",
    "recover_frame_attitude": "sightline.applications.frame_attitude",
    "recover_line_of_sight": "sightline.applications.line_of_sight",
    "recover_spin_attitude": "sightline.applications.spin_attitude",
    "register_bands": "sightline.applications.registration",
    "remove_hidden": "sightline.io.results.hidden",
    "score_motion": "sightline.evaluation.score",
    "sequence_case": "sightline.simulate.sequence",
    "stereo_case": "sightline.simulate.stereo",
    "tie_to_reference": "sightline.applications.reference_tie",
    "write_junocam_acquisition": "sightline.io.formats.junocam",
}

__all__ = [
    "Acquisition",
    "AngleDifferences",
    "AreaDetector",
    "ArrayImage",
    "Band",
    "BandMatches",
    "Batch",
    "Camera",
    "ChipKnowledge",
    "ChoiceRules",
    "CubePlan",
    "CubeSummary",
    "Dem",
    "DetectorNoise",
    "Ellipsoid",
    "EstimationError",
    "Executor",
    "Exposure",
    "FixedMount",
    "FocalPlane",
    "FollowPlan",
    "FormatError",
    "Frame",
    "FrameAttitude",
    "FrameCamera",
    "FrameOptions",
    "GeometryError",
    "ImageSource",
    "InputError",
    "Instrument",
    "LayoutChoice",
    "LensKnowledge",
    "LineDetector",
    "LineOfSight",
    "Matches",
    "Mosaic",
    "Motion",
    "NoiseLaw",
    "PlacedImage",
    "Plane",
    "Pointing",
    "Pose",
    "PushbroomCamera",
    "RasterMatches",
    "Rays",
    "RecoverOptions",
    "ReferenceTie",
    "Registration",
    "Result",
    "ScanColumns",
    "ScanMirror",
    "Score",
    "SequencePoses",
    "SequenceProblem",
    "SightlineError",
    "SpanError",
    "Spin",
    "SpinAttitude",
    "SpinOptions",
    "Stages",
    "StereoOrientation",
    "StereoPrediction",
    "StereoProblem",
    "Surface",
    "TdiChoice",
    "TdiDetector",
    "TdiGrid",
    "TdiProblem",
    "TdiResult",
    "TdiTable",
    "TdiTags",
    "Trajectory",
    "UnobservableBandWarning",
    "allow_network",
    "assemble_cube",
    "choose_layout",
    "choose_tdi",
    "executor_from_name",
    "frame_mosaic",
    "georeference_sequence",
    "grid_points",
    "line_of_sight_case",
    "load_acquisition",
    "load_instrument",
    "load_raster",
    "load_sequence",
    "load_stereo",
    "load_tdi",
    "match_bands",
    "match_images",
    "match_rasters",
    "open_result",
    "orient",
    "predict_match",
    "read_tdi_tags",
    "recover_frame_attitude",
    "recover_line_of_sight",
    "recover_spin_attitude",
    "register_bands",
    "remove_hidden",
    "score_motion",
    "sequence_case",
    "stereo_case",
    "tie_to_reference",
    "write_junocam_acquisition",
]


def __getattr__(name: str) -> Any:
    """Load the module that defines a public name, the first time it is asked for."""
    module = _MODULE_OF.get(name)
    if module is None:
        raise AttributeError(f"module 'sightline' has no attribute {name!r}")
    value = getattr(importlib.import_module(module), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """The public names, loaded or not, and nothing else."""
    return sorted([*_MODULE_OF, "__version__"])


def _kind_of(result: Any) -> _result.Kind:
    """How a result shows itself: by a layer that later ones than the result's own make up."""
    from sightline.kinds.open import kind_of

    return kind_of(result)


_result.serve(_kind_of)
