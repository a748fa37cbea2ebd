"""Settings of every command: one dataclass each, at once a table of a TOML file and command-line flags.

One file describes a room; every command reads its own table of it (`[detect.led]`, `[calibrate]`, ...), and flags
override the file. Plain Python on purpose: `jaxpoint --help` reads this module and must not import jax.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import tyro

from jaxpoint.config.loading import load_settings
from jaxpoint.config.person import MarkerSettings, PersonSettings
from jaxpoint.config.pointing import PointSettings
from jaxpoint.config.simulation import SimulationSettings
from jaxpoint.config.stereo_matching import StereoSettings
from jaxpoint.config.track import TrackSettings
from jaxpoint.config.types import Count, Fraction, Positive, Unit


@dataclass(frozen=True)
class LedSettings:
    """How the light is found in images (thesis 5.3.1)."""

    method: Literal["robust", "thesis"] = "robust"
    """`robust`: median/MAD background and a Gaussian fit; `thesis`: mean/std background and template correlation."""
    channel: Literal["auto", "red", "green", "blue", "grey"] = "auto"
    """Colour channel of the light; `auto` takes the one with the strongest light."""
    led_radius_px: Positive = 3.0
    """Radius of the light in the image, 2 to 5 px as a rule; larger blobs are rejected."""
    threshold_fraction: Fraction = 0.8
    """Pixels above this fraction of the frame's largest difference belong to the light."""
    min_deviations: Positive = 5.0
    """The largest difference must exceed this many background deviations."""
    max_eccentricity: Fraction = 0.8
    """Blobs more elongated than this are motion blur."""
    min_brightness: Fraction = 0.2
    """Robust only: a spot fainter than this fraction of the camera's median light is taken for a reflection."""
    min_frames: Count = 100
    """Fewest frames from which a background is learnt."""
    masks: Path | None = None
    """Folder of one image a camera (cam_0.png), black where no light is looked for, such as on reflections and windows,
    white elsewhere; by default the folder `masks` beside the recordings, where there is one."""
    pair_by: Literal["auto", "number", "time", "place"] = "auto"
    """What says which images belong together: a `number` or the `time` in their names, the `time` stamps of videos, or
    the `place` in each recording; `auto` takes what the input holds, and refuses where it contradicts itself."""
    unequal_lengths: bool = False
    """Take videos of different lengths, each counting its own frames, for `calibrate --timestamps`."""
    workers: Count = 0
    """Processes used, one camera each; 0 takes one per core."""


@dataclass(frozen=True)
class EpipolarSettings:
    """Robust two-view geometry of every pair of cameras."""

    method: Literal["magsac", "ransac", "lmeds", "8point"] = "magsac"
    """Robust estimator; `ransac` is the thesis's 7-point RANSAC with a fixed threshold."""
    threshold_px: Positive = 3.0
    """Inlier threshold at an image width of 1280 px; it scales with the width."""
    samples: Count = 512
    """Minimal samples drawn for each pair."""
    min_shared_frames: Count = 20
    """Pairs that share fewer frames are not used."""
    division_model: bool = True
    """Estimate one distortion parameter a camera before anything else."""


@dataclass(frozen=True)
class LensSettings:
    """What is unknown in a camera."""

    distortion: str = "auto"
    """Lens model: `none`, `radial1`, `radial2` and `brown` free none, k1, k1 and k2, and all of Brown's coefficients;
    `rational` is OpenCV's with 8, `fisheye` Kannala and Brandt's, `pinhole` has none. `auto` begins with `radial2`, and
    takes `brown` or, where a lens is wide, `fisheye` where that explains the recording better. Cameras of several kinds
    are named: `brown,cam_2=fisheye` is Brown's of all but cam_2."""
    shared: tuple[str, ...] = ()
    """Groups of cameras with one lens in common, `cam_0,cam_1`; `all` for all cameras. For cameras of one kind at one
    zoom and focus: fewer unknowns where a recording is short."""
    aspect: str | float = "auto"
    """Width over height of a pixel. `auto`: what the video states, else square, and solved for where the recording
    refutes that; `fixed`: square; `free`: solved for; or a number or fraction, such as 16/15 for PAL video."""
    principal_point: Literal["prior", "fixed", "free"] = "prior"
    """`prior`: drawn to the image centre; holding it there costs 2 to 35 times in camera position."""
    principal_point_sigma: Positive = 0.05
    """Standard deviation of that prior, as a fraction of the image width."""
    known: Literal["none", "refine", "hold"] = "none"
    """With a file of known intrinsics: `hold` them or `refine` them from there."""


@dataclass(frozen=True)
class OutlierSettings:
    """Which observations are believed."""

    loss: Literal["cauchy", "none"] = "cauchy"
    """Robust loss of the adjustment."""
    sigmas: Positive = 4.0
    """An observation is kept within this many robust standard deviations."""
    floor_px: Positive = 1.0
    """It is always kept within this distance."""
    max_rounds: Count = 20
    """Bound on the rounds of rejecting and readmitting."""


@dataclass(frozen=True)
class CalibrateSettings:
    """How a calibration is made from tracks."""

    init: Literal["auto", "factorisation", "thesis", "essential", "boards"] = "auto"
    """First solution; `auto` lets all compete and keeps the one with the lowest robust cost. `boards` takes each lens
    from its own views of boards, and the poses from views together; so does `auto` for one or two cameras."""
    epipolar: EpipolarSettings = field(default_factory=EpipolarSettings)
    lens: LensSettings = field(default_factory=LensSettings)
    outliers: OutlierSettings = field(default_factory=OutlierSettings)
    time_offsets: bool = False
    """Cameras are out of step by up to 2 frames each: solve for a time offset of every camera too."""
    readout_times: bool = False
    """Cameras have rolling shutters: solve for the time of every camera from its first image row to its last too."""
    held_out: Fraction = 0.1
    """Fraction of the frames kept aside to judge the distortion model; all are used in the last adjustment."""
    max_mean_px: Positive = 1.0
    """Quality gate: a mean reprojection error above this fails the calibration (results are kept and marked)."""
    min_kept: Fraction = 0.7
    """Quality gate: a smaller fraction of kept observations fails the calibration; those of frames that only one
    camera saw do not count."""
    max_focal_sigma: Positive = 0.1
    """Quality gate: a focal length known worse than this (one standard deviation, relative) fails the calibration."""
    max_expected_error: Positive = 0.05
    """Quality gate: so does a larger error to be expected of the light's points, as a share of their extent."""
    seed: Count = 0
    """Seed of everything drawn at random; the same seed gives the same calibration."""


@dataclass(frozen=True)
class InputSettings:
    """How the tracks are read."""

    one_based: bool = False
    """The first pixel is (1, 1), as in files written by Matlab."""
    image_size: tuple[Count, Count] | None = None
    """Width and height in pixels of every camera, for files that do not say it."""
    min_likelihood: Fraction | None = None
    """Keypoints of a pose estimator that are less sure than this are as not seen; by default 0.6 of DeepLabCut and
    Lightning Pose, and all of SLEAP."""
    individual: str | None = None
    """Whose keypoints are read, where a file holds several animals or people."""
    wand_m: Positive | None = None
    """The two points of every frame (0 and 1) are the ends of a wand of this length, which gives metres."""
    static_points: Path | None = None
    """easyWand's background points, at rest and clicked in all cameras: they take part too."""
    timestamps: Path | None = None
    """timestamps.csv of caliscope: brings frames that each camera's file counts for itself to common moments."""
    intrinsics: Path | None = None
    """Known lenses, with or without poses: a file or folder of any format that `jaxpoint convert --list` names, or a
    folder of *.rad files; see `lens.known`."""
    intrinsics_by_order: bool = False
    """The known lenses are in the order of the cameras, whatever their names."""
    offset: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """NAME=FRAMES, once for each camera out of step: it shows the light so many frames late (early: negative) at the
    first frame of the tracks. `cam_2=37` takes its frame 37 as the others' frame 0."""
    rate: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """NAME=RATE, frames a second, once for each camera that runs faster or slower than the others; these run at
    `all=30`, or at the rate of the tracks' times. Only ratios matter. `all=30` and `cam_2=29.83`: its frame 2983 shows
    what the others' frame 3000 shows; where its recording repeats or skips frames for that, these are put right."""
    readout: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """NAME=FRAMES, once for each camera with a rolling shutter: it takes so many frames from its first image row to its
    last (negative where it hangs upside down); `all=0.6` means every camera that is not named."""
    leave_out: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """Name of a camera that is not used; once for each."""


@dataclass(frozen=True)
class AlignSettings:
    """What is known in metres about the room; give one of landmarks, camera centres, floor, or length."""

    landmarks: Path | None = None
    """CSV of known points, `name,x_m,y_m,z_m[,sigma_m]` (or x_cm, x_mm, ...), z up. A name is a point in
    `landmark_pixels`, else a camera, else the number of a frame (the light was there)."""
    landmark_pixels: Path | None = None
    """CSV of points clicked in two or more images, `name,camera,x,y`."""
    camera_centres: Path | None = None
    """Known camera positions: CSV in the form of `landmarks`, a calibration file, or a .dat with one row a camera."""
    world: str = "room"
    """Axes of the known points or centres where z does not point up or they are left-handed: unity, unreal, opengl,
    opensim, opencv, ... or what their x, y and z are in the room, as x,z,-y. The room has z up in any case."""
    unit: Unit = None
    """Unit of camera centres from a file that does not say it, m, cm or mm."""
    floor: tuple[str, ...] = ()
    """Three or more points on the floor, named as in `landmarks`: the first becomes the origin, x points to the
    second."""
    length: tuple[str, ...] = ()
    """Two points, named as in `landmarks`, whose distance is `length_m`: the calibration has metres then, and still
    neither floor nor up."""
    length_m: Positive | None = None
    """Distance between the points of `length`, or between the first two of `floor`."""
    moved_m: Positive = 0.05
    """Cameras that stand farther than this from their known centres, where the others agree, were moved since and are
    left out."""
    max_rms_mm: Positive = 50.0
    """Quality gate: a larger rms residual fails the alignment (results are kept and marked)."""
    max_extent_m: Positive = 300.0
    """Cameras and known points that spread wider than this are refused as given in another unit."""


@dataclass(frozen=True)
class ValidateSettings:
    """What a calibration is held against (thesis 5.4)."""

    lengths: Path | None = None
    """CSV of measured lengths, `name,end_a,end_b,length_m`; the ends are names in `landmark_pixels`."""
    landmark_pixels: Path | None = None
    """CSV of the ends clicked in two or more images, `name,camera,x,y`."""
    tracks: Path | None = None
    """Another recording by the same cameras, triangulated and reprojected."""
    held_out: bool = False
    """Calibrate each half of the frames anew: predict the other half, and compare the two rigs."""
    max_mean_mm: Positive = 20.0
    """Quality gate: a larger mean error of the lengths fails the validation (the thesis claims 2 cm)."""


@dataclass(frozen=True)
class DetectSettings:
    """What is looked for in images."""

    led: LedSettings = field(default_factory=LedSettings)
    person: PersonSettings = field(default_factory=PersonSettings)
    marker: MarkerSettings = field(default_factory=MarkerSettings)


@dataclass(frozen=True)
class RuntimeSettings:
    """How the computer is used; no result depends on it."""

    keep_programs: bool = True
    """Keep compiled programs, so that the next run starts sooner."""
    compilation_cache: Path | None = None
    """Folder in which they are kept; by default `programs` in the user's cache folder (`jaxpoint doctor` shows it)."""


@dataclass(frozen=True)
class RoomConfig:
    """A whole configuration file, one table a field."""

    input: InputSettings = field(default_factory=InputSettings)
    detect: DetectSettings = field(default_factory=DetectSettings)
    track: TrackSettings = field(default_factory=TrackSettings)
    calibrate: CalibrateSettings = field(default_factory=CalibrateSettings)
    align: AlignSettings = field(default_factory=AlignSettings)
    validate: ValidateSettings = field(default_factory=ValidateSettings)
    point: PointSettings = field(default_factory=PointSettings)
    simulate: SimulationSettings = field(default_factory=SimulationSettings)
    stereo: StereoSettings = field(default_factory=StereoSettings)
    runtime: RuntimeSettings = field(default_factory=RuntimeSettings)


def load_config(path: Path) -> RoomConfig:
    """Read the configuration file of a room, as `load_settings` does."""
    return load_settings(path, RoomConfig)
