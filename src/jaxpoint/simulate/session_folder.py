"""A simulated session as a folder, laid out like a recorded one, with the truth beside it."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from pathlib import Path

import cv2
import numpy as np

from jaxpoint.camera.rig import CameraRig
from jaxpoint.config.loading import to_toml
from jaxpoint.config.pointing import RoomExtent
from jaxpoint.errors import MissingDependencyError
from jaxpoint.io.calibration import write_calibration_json
from jaxpoint.simulate.simulated_session import Progress, SimulatedFrame, SimulatedSession
from jaxpoint.simulate.wave import SimulatedWave

CORNERS = ("lt", "rt", "lb", "rb")
PIXELS = ("head", "elbow", "wrist", "tip")
SHEET_WIDTH = 400  # px, of one camera in the preview
TAPE_SIGMA_M = 0.005  # of each coordinate of a camera, measured by tape


def write_session(
    folder: Path,
    session: SimulatedSession,
    *,
    wave: SimulatedWave | None = None,
    masks: bool = False,
    progress: Progress | None = None,
) -> None:
    """Write a session into an empty folder that exists, but for its preview; see `docs/reference/formats.md`.

    Args:
        folder: it should take its final name only afterwards, so that what is there is whole (`runs.new_run`).
        session: what happens.
        wave: a light waved beforehand in the same room.
        masks: also write `truth/masks`, an image of labels a frame.
        progress: called after every image.

    Raises:
        MissingDependencyError: OpenCV cannot write videos here.
        OSError: the disk is full or not writable.
    """
    report = progress or (lambda *_: None)
    names = session.rig.names
    truth = folder / "truth"
    truth.mkdir()
    write_calibration_json(
        folder / "calibration.json", session.rig, provenance={"simulated": True, "seed": session.seed}
    )
    (folder / "session.toml").write_text(made_from(session), encoding="utf-8")
    _write_objects(folder / "objects.csv", session)
    _write_timestamps(folder / "timestamps.csv", session)
    _write_people(truth / "people.csv", session)
    _write_gestures(truth / "gestures.csv", session)
    _write_joints(truth / "joints.csv", session)
    _write_empty(folder / "empty", session, names, report)
    _write_frames(folder, session, names, masks, report)
    if wave is not None:
        _write_wave(folder, wave, names, report)
        write_camera_centres(folder / "camera_centres.csv", session.rig, session.seed)


def write_preview(path: Path, session: SimulatedSession) -> None:
    """A sheet with one image of every camera: the middle of the first gesture, or of the session."""
    gesture = next(iter(session.gestures), None)
    middle = session.play.duration_s / 2 if gesture is None else (gesture.hold_first_s + gesture.hold_last_s) / 2
    moment = min(session.frame_at(middle), session.clocks.moments - 1)
    images = [frame.image for frame in session.frames([moment])]
    if not images:
        return
    height = round(SHEET_WIDTH * images[0].shape[0] / images[0].shape[1])
    small = [cv2.resize(image, (SHEET_WIDTH, height), interpolation=cv2.INTER_AREA) for image in images]
    small += [np.zeros_like(small[0])] * (-len(small) % 2)
    rows = [np.hstack(small[i : i + 2]) for i in range(0, len(small), 2)]
    path.write_bytes(cv2.imencode(".jpg", np.vstack(rows))[1].tobytes())


class _Videos:
    """One mp4 a camera in a new folder."""

    def __init__(self, folder: Path, names: Sequence[str], size: tuple[int, int], rates: Sequence[float]):
        folder.mkdir()
        code = cv2.VideoWriter.fourcc(*"mp4v")
        self._writers = [
            cv2.VideoWriter(str(folder / f"{name}.mp4"), code, rate, size) for name, rate in zip(names, rates)
        ]
        if not all(writer.isOpened() for writer in self._writers):
            raise MissingDependencyError(
                "OpenCV cannot write mp4 videos here; install opencv-python-headless from its wheel, which can."
            )

    def __enter__(self) -> _Videos:
        return self

    def __exit__(self, *_: object) -> None:
        for writer in self._writers:
            writer.release()

    def write(self, camera: int, image: np.ndarray) -> None:
        self._writers[camera].write(image)


def _write_frames(folder: Path, session: SimulatedSession, names, masks: bool, report: Progress) -> None:
    rate = session.settings.frames_per_second
    slow = session.settings.faults.half_rate
    rates = [rate / 2 if camera in slow else rate for camera in range(len(names))]
    total = int(session.clocks.present.sum())
    rows = []
    with _Videos(folder / "videos", names, session.settings.viewpoints.size, rates) as videos:
        for done, frame in enumerate(session.frames(), start=1):
            videos.write(frame.camera, frame.image)
            rows += _view_rows(frame, names)
            if masks:
                _write_mask(folder / "truth" / "masks" / names[frame.camera], frame)
            report("images", done, total)
    header = ["frame", "camera", "person", "hand", "forearm_visible", "forearm_angle_deg", "finger_visible"]
    header += ["silhouette_px", *(f"{name}_{axis}" for name in PIXELS for axis in "xy")]
    _write_csv(folder / "truth" / "views.csv", header, rows)


def _view_rows(frame: SimulatedFrame, names: Sequence[str]) -> list[list[object]]:
    return [
        [
            *(frame.frame, names[frame.camera], view.person, view.hand, f"{view.forearm_visible:.3f}"),
            *(f"{view.forearm_angle_deg:.2f}", f"{view.finger_visible:.3f}", view.silhouette_px),
            *(f"{value:.2f}" for name in PIXELS for value in getattr(view, name)),
        ]
        for view in frame.views
    ]


def _write_mask(folder: Path, frame: SimulatedFrame) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{frame.frame:06d}.png").write_bytes(cv2.imencode(".png", frame.labels)[1].tobytes())


def _write_empty(folder: Path, session: SimulatedSession, names, report: Progress) -> None:
    count = session.settings.empty_frames
    if not count:
        return
    rates = [session.settings.frames_per_second] * len(names)
    with _Videos(folder, names, session.settings.viewpoints.size, rates) as videos:
        for frame in range(count):
            for camera in range(len(names)):
                videos.write(camera, session.empty(frame, camera))
            report("empty room", frame + 1, count)


def _write_wave(folder: Path, wave: SimulatedWave, names, report: Progress) -> None:
    rates = [wave.frames_per_second] * len(names)
    with _Videos(folder / "wave", names, wave.size, rates) as videos:
        for frame in range(wave.frames):
            for camera in range(len(names)):
                videos.write(camera, wave.image(frame, camera))
            report("wave", frame + 1, wave.frames)
    rows = [[frame, *_metres(place)] for frame, place in enumerate(wave.light)]
    _write_csv(folder / "truth" / "light.csv", ["frame", "x_m", "y_m", "z_m"], rows)


def write_camera_centres(path: Path, rig: CameraRig, seed: int) -> None:
    """Where the cameras hang, as an installer would measure it by tape: with errors, for `jaxpoint align`."""
    errors = np.random.default_rng([seed, 6]).normal(0.0, TAPE_SIGMA_M, (len(rig), 3))
    places = np.asarray(rig.positions, np.float64) + errors
    rows = [[name, *(f"{value:.3f}" for value in place), TAPE_SIGMA_M] for name, place in zip(rig.names, places)]
    _write_csv(path, ["name", "x_m", "y_m", "z_m", "sigma_m"], rows)


def _write_objects(path: Path, session: SimulatedSession) -> None:
    header = ["name", "unit", "kind", "tags", *(f"{corner}_{axis}" for corner in CORNERS for axis in "xyz")]
    rows = [
        [thing.name, "m", thing.kind, " ".join(thing.tags), *_metres(thing.corners.ravel())]
        for thing in session.objects
    ]
    _write_csv(path, header, rows)


def _write_timestamps(path: Path, session: SimulatedSession) -> None:
    clocks = session.clocks
    index = clocks.frame_index
    rows = [
        [moment, camera, index[moment, camera], f"{clocks.stamped_s[moment, camera]:.6f}"]
        for moment, camera in np.argwhere(clocks.present)
    ]
    _write_csv(path, ["sync_index", "cam_id", "frame_index", "frame_time"], rows)


def _write_people(path: Path, session: SimulatedSession) -> None:
    header = ["person", "stature_m", "handed", "tone", "sleeve", "clothes_like_skin", "cap", "hair", "shorts"]
    rows = [
        [
            *(who.number, f"{who.stature_m:.3f}", who.handed, f"{who.tone:.3f}", who.sleeve, who.clothes_like_skin),
            *(int(who.cap is not None), who.hair_style, int(who.shorts)),
        ]
        for who in {actor.person.number: actor.person for actor in session.play.actors}.values()
    ]
    _write_csv(path, header, rows)


def _write_gestures(path: Path, session: SimulatedSession) -> None:
    header = ["gesture", "person", "first_frame", "hold_first", "hold_last", "last_frame", "hand", "law", "target"]
    header += ["target_x_m", "target_y_m", "target_z_m"]
    rows = []
    for number, made in enumerate(session.gestures):
        times = (made.first_s, made.hold_first_s, made.hold_last_s, made.last_s)
        frames = [session.frame_at(time) for time in times]
        rows.append([number, made.person, *frames, made.hand, made.law, made.target, *_metres(made.target_m)])
    _write_csv(path, header, rows)


def _write_joints(path: Path, session: SimulatedSession) -> None:
    rows = []
    for moment in range(session.clocks.moments):
        time_s = session.time_of(moment)
        for actor in session.present(time_s):
            found = actor.joints(time_s).items()
            rows += [[moment, actor.person.number, joint, *_metres(place)] for joint, place in found]
    _write_csv(path, ["frame", "person", "joint", "x_m", "y_m", "z_m"], rows)


def made_from(session: SimulatedSession) -> str:
    """The text of a configuration file that makes the session again, and gives `point` the room's size."""
    again = f"jaxpoint simulate --config session.toml --seed {session.seed} --out again"
    extent = RoomExtent((0.0, 0.0, 0.0), tuple(session.scene.size.tolist()))
    settings = {"point": {"room": extent}, "simulate": session.settings}
    return f"# jaxpoint {version('jaxpoint')}: {again}\n\n" + to_toml(settings)


def _metres(values: Iterable[float]) -> list[str]:
    return [f"{value:.5f}" for value in values]


def _write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
