"""The parts of the benchmark: its problems, its peers' derivatives, and that the engine is given what they are."""

from dataclasses import replace

import bundle_adjustment as benchmark
import engine
import growth
import numpy as np
import pytest
import scipy_peer
import small_solvers
from bal import read_bal
from problem import BundleProblem, read_problem, write_problem
from rooms import Size, room_problem

from jaxpoint.errors import FileFormatError, UsageError

SMALL = Size(cameras=5, points=120, share=0.8)


def as_bal(room: BundleProblem) -> BundleProblem:
    """A room of 11 parameters as BAL would have it: x and z turned around, so that the camera looks along -z."""
    turn = np.array([-1.0, 1.0, -1.0])
    rotated = engine.Rotation.from_matrix(np.diag(turn)) * engine.Rotation.from_rotvec(room.cameras[:, :3])
    pose = np.concatenate([rotated.as_rotvec(), room.cameras[:, 3:6] * turn], axis=1)
    pixels = (room.pixels - room.cameras[room.camera_of, 7:9]) * [-1.0, 1.0]
    return replace(room, cameras=np.concatenate([pose, room.cameras[:, [6, 9, 10]]], axis=1), pixels=pixels)


@pytest.mark.parametrize("parameters", [11, 15])
def test_rooms_are_as_their_size_says(parameters):
    room = room_problem(SMALL, parameters, seed=1)
    assert room.parameters == parameters
    assert room.visibility == pytest.approx(0.8, abs=1e-3)
    assert (np.bincount(room.point_of, minlength=60) >= 2).all()
    assert len(np.unique(room.point_of * 5 + room.camera_of)) == room.observations
    assert (np.diff(room.point_of) >= 0).all()
    again = room_problem(SMALL, parameters, seed=1)
    assert (again.pixels == room.pixels).all()
    assert (again.cameras == room.cameras).all()
    assert room.cost(room.cameras, room.points) / room.observations > 10.0  # the start is off


def test_a_room_where_too_little_is_seen():
    with pytest.raises(ValueError, match="shorter focal"):
        room_problem(Size(4, 60, 1.0), 11, seed=0)


@pytest.mark.parametrize("parameters", [11, 15])
def test_a_file_keeps_the_problem(parameters, tmp_path):
    room = room_problem(SMALL, parameters, seed=2)
    write_problem(tmp_path / "problem.bin", room)
    found = read_problem(tmp_path / "problem.bin")
    for name in ("cameras", "points", "camera_of", "point_of", "pixels"):
        assert (getattr(found, name) == getattr(room, name)).all()


@pytest.mark.parametrize("parameters", [11, 15])
def test_derivatives_of_the_scipy_peer(parameters):
    room = room_problem(SMALL, parameters, seed=3)
    cameras = room.cameras.copy()
    cameras[:, 6:] += np.random.default_rng(0).normal(0.0, 1e-2, cameras[:, 6:].shape)
    exact = scipy_peer.jacobian(room, cameras, room.points)
    for column in range(parameters + 3):
        step = np.zeros(parameters + 3)
        step[column] = 1e-6
        there, back = (
            room.residuals(cameras + sign * step[:parameters], room.points + sign * step[parameters:])
            for sign in (1.0, -1.0)
        )
        np.testing.assert_allclose(exact[:, :, column], (there - back) / 2e-6, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("lens", ["11", "15", "bal"])
def test_the_engine_solves_the_problem_that_the_peers_see(lens):
    drawn = room_problem(SMALL, 15 if lens == "15" else 11, seed=4)
    room = as_bal(drawn) if lens == "bal" else drawn
    numbers, base = engine.as_unknown(room)
    np.testing.assert_allclose(engine.as_cameras(numbers, base, room.parameters), room.cameras, atol=1e-9)
    end, _ = engine.solve(engine.task_of(room, rtol=1e-8, steps=100))
    assert bool(end.settled)
    cost = engine.cost_of(room, end)
    assert 2.0 * cost == pytest.approx(float(end.cost), rel=1e-9)
    if lens == "bal":
        assert room.cost(room.cameras, room.points) == pytest.approx(drawn.cost(drawn.cameras, drawn.points), rel=1e-9)
        assert cost < 0.1 * room.cost(room.cameras, room.points)
    else:
        assert scipy_peer.run(room).cost == pytest.approx(cost, rel=1e-6)


def test_bal_files(tmp_path):
    room = as_bal(room_problem(SMALL, 11, seed=5))
    lines = [f"5 120 {room.observations}"]
    lines += [f"{c} {p} {u!r} {v!r}" for c, p, (u, v) in zip(room.camera_of, room.point_of, room.pixels.tolist())]
    lines += [repr(number) for number in [*room.cameras.ravel().tolist(), *room.points.ravel().tolist()]]
    path = tmp_path / "problem.txt"
    path.write_text("\n".join(lines))
    found = read_bal(path)
    assert (found.pixels == room.pixels).all()
    assert (found.cameras == room.cameras).all()
    path.write_text("\n".join(lines[:-1]))
    with pytest.raises(FileFormatError, match="counts"):
        read_bal(path)
    with pytest.raises(FileFormatError, match="cannot be read"):
        read_bal(tmp_path / "nowhere.txt")


def test_bal_needs_a_folder(monkeypatch):
    monkeypatch.delenv("JAXPOINT_DATA", raising=False)
    with pytest.raises(UsageError, match="--data"):
        benchmark.bal_problem(None)


def test_published_start_of_ladybug(data_folder):
    ladybug = benchmark.bal_problem(data_folder)
    assert ladybug.cost(ladybug.cameras, ladybug.points) == pytest.approx(850912.46, rel=1e-7)


def test_only_much_worse_ratios_are_noticed():
    found = {"S/11": 0.4, "M/11": 0.6, "new/11": 9.0}
    (phrase,) = benchmark.worsened(found, {"S/11": 0.3, "M/11": 0.3})
    assert phrase == "M/11 0.60 (was 0.30)"


def test_exponents_and_their_parts():
    rows = [growth.Row("cameras", c, 100, 80 * c, 2.0 * c + 0.5 * c**2, None) for c in (4, 8, 16)]
    np.testing.assert_allclose(growth.split(rows)[:, 1], [8.0, 32.0, 128.0])
    straight = [growth.Row("points", 8, p, 8 * p, 0.01 * p, None) for p in (100, 200, 400)]
    assert growth.exponent(straight, "points") == pytest.approx(1.0)


@pytest.mark.parametrize("ways", [small_solvers.axes, small_solvers.lights])
def test_small_solvers_are_compared_at_the_same_optimum(ways):
    """Of a limb's ends, m, or a light's centre, px; an arm that points at a camera may have several."""
    own, library = (way.run() for way in ways(small_solvers.Small(axes=8, lights=8)))
    assert np.median(np.abs(own - library).max(axis=1)) < 1e-5
