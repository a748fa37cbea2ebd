"""Bodies are whole, of the stature drawn, and what is between two joints lies between them."""

from collections import Counter

import cv2
import numpy as np
import pytest
import pyvista

from jaxpoint.config.people import LooksSettings, PeopleSettings, Uniform
from jaxpoint.simulate.mesh import PARTS_A_PERSON, Part
from jaxpoint.simulate.people import colours
from jaxpoint.simulate.people.actor import Actor, RestFrom, Stay
from jaxpoint.simulate.people.floor import Floor
from jaxpoint.simulate.people.play import make_play
from jaxpoint.simulate.people.rest import Rest
from jaxpoint.simulate.people.simulated_person import draw_person
from jaxpoint.simulate.people.stance import standing

HANGING: dict = {"left": "hanging", "right": "hanging"}
SEEDS = range(6)


def stands(seed: int, looks: LooksSettings | None = None, rest: Rest = "hanging") -> Actor:
    person = draw_person(np.random.default_rng(seed), seed, looks or LooksSettings())
    stance = standing(person.proportions, np.array([3.0, 2.5, 0.0]), 0.7)
    return Actor(person, [Stay(0.0, 1.0, stance)], [RestFrom(0.0, {"left": rest, "right": rest})], [])


def points(seed: int) -> tuple[Actor, float]:
    """Someone who points, and a moment of the hold."""
    actor = make_play(seed, PeopleSettings(play="gestures", people=1, gestures=1, nothing=1.0), (), Floor()).actors[0]
    return actor, actor.gestures[0].hold_first_s + 0.3


def pieces(triangles):
    """Triangles of each closed surface, which share no corner with another's."""
    group = np.arange(triangles.max() + 1)
    for _ in range(200):
        least = group[triangles].min(axis=1, keepdims=True)
        before = group.copy()
        np.minimum.at(group, triangles, np.broadcast_to(least, triangles.shape))
        if (group == before).all():
            break
    return [triangles[group[triangles[:, 0]] == one] for one in np.unique(group)]


@pytest.mark.parametrize("seed", SEEDS)
def test_every_surface_is_closed_and_turned_outwards(seed):
    actor, moment = points(seed)
    mesh = actor.mesh(moment)
    found = pieces(mesh.triangles)
    assert len(found) == 3 + 2 * (1 + 2 + 11 + 3)  # trunk, neck, head; shoulders, arms, hands, legs
    for triangles in found:
        edges = Counter(tuple(edge) for t in triangles.tolist() for edge in zip(t, t[1:] + t[:1]))
        assert set(edges.values()) == {1}  # each edge once in each direction: closed, and turned alike
        assert all((b, a) in edges for a, b in edges)
        a, b, c = mesh.vertices[triangles].transpose(1, 0, 2)
        assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0  # six times the volume
    face = np.cross(*(mesh.vertices[mesh.triangles[:, i]] - mesh.vertices[mesh.triangles[:, 0]] for i in (1, 2)))
    along = np.einsum("tij,tj->ti", mesh.normals[mesh.triangles], face / np.linalg.norm(face, axis=1, keepdims=True))
    assert (along > 0).mean() > 0.995
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_stature_and_floor(seed):
    actor = stands(seed, LooksSettings(bald=1.0))
    height = actor.mesh(0.5).vertices[:, 2]
    assert height.min() == pytest.approx(0.0, abs=0.003)
    assert height.max() == pytest.approx(actor.person.stature_m, abs=0.02)
    assert 1.50 <= actor.person.stature_m <= 1.95


@pytest.mark.parametrize(("part", "ends"), [("FOREARM", ("elbow", "wrist")), ("UPPER_ARM", ("shoulder", "elbow"))])
def test_sections_lie_on_the_bone(part, ends):
    """Cut by planes across the bone: the centre of every section is within 4 mm of the line between the joints."""
    for seed in SEEDS:
        actor, moment = points(seed)
        mesh, joints = actor.mesh(moment), actor.joints(moment)
        for side in ("left", "right"):
            start, end = (joints[f"{side}_{end}"] for end in ends)
            own = mesh.parts == Part[f"{side}_{part}".upper()] + PARTS_A_PERSON * (actor.person.number % 8)
            triangles = mesh.triangles[own[mesh.triangles].all(axis=1)]
            surface = pyvista.PolyData.from_regular_faces(mesh.vertices, triangles)
            along = (end - start) / np.linalg.norm(end - start)
            for share in (0.15, 0.4, 0.65, 0.9):
                middle = start + share * (end - start)
                section = surface.slice(normal=along, origin=middle)
                lengths = section.compute_cell_sizes(area=False, volume=False)["Length"]
                centre = np.average(section.cell_centers().points, axis=0, weights=lengths)
                assert np.linalg.norm(centre - middle) < 0.004
                assert 0.08 < lengths.sum() < 0.55  # m around, cloth included


def test_lengths_of_bones_never_change():
    settings = PeopleSettings(people=1, gestures=4, pause_s=Uniform(0.2, 0.3))
    actor = make_play(4, settings, (), Floor()).actors[0]
    size = actor.person.proportions
    bones = {
        ("shoulder", "elbow"): size.upper_arm,
        ("elbow", "wrist"): size.forearm,
        ("knee", "ankle"): size.shank,
    }
    for time in np.arange(actor.moves[0].start_s, actor.moves[-1].end_s, 0.11):
        joints = actor.joints(time)
        for side in ("left", "right"):
            for (a, b), length in bones.items():
                found = np.linalg.norm(joints[f"{side}_{a}"] - joints[f"{side}_{b}"])
                assert found == pytest.approx(length, abs=1e-9)
        assert np.linalg.norm(joints["left_eye"] - joints["right_eye"]) == pytest.approx(
            0.0356 * size.stature, abs=1e-3
        )


def test_joints_and_surface_belong_together():
    """The tip is the farthest place of the index finger, the head's joint the middle of the head."""
    for seed in SEEDS:
        actor, moment = points(seed)
        mesh, joints = actor.mesh(moment), actor.joints(moment)
        hand = actor.gestures[0].hand
        finger = mesh.vertices[mesh.parts % PARTS_A_PERSON == Part[f"{hand}_finger".upper()]]
        far = finger[np.argmax(np.linalg.norm(finger - joints[f"{hand}_wrist"], axis=1))]
        np.testing.assert_allclose(far, joints[f"{hand}_tip"], atol=0.004)
        head = mesh.vertices[mesh.parts % PARTS_A_PERSON == Part.HEAD]
        np.testing.assert_allclose((head.min(axis=0) + head.max(axis=0)) / 2, joints["head"], atol=0.035)


@pytest.mark.parametrize(("tone", "low", "high"), [(0.0, 33, 43), (0.5, 53, 62), (1.0, 63, 73)])
def test_skin_has_the_lightness_published(tone, low, high):
    """OpenCV's CIELAB of many people of one tone; see `colours.TONES`."""
    albedo = np.array([colours.skin_albedo(np.random.default_rng(i), tone) for i in range(200)], np.float32)
    encoded = np.where(albedo <= 0.0031308, 12.92 * albedo, 1.055 * albedo ** (1 / 2.4) - 0.055)
    lab = cv2.cvtColor(encoded[None].astype(np.float32), cv2.COLOR_RGB2LAB)[0]
    assert low < lab[:, 0].mean() < high
    assert (lab[:, 1:].mean(axis=0) > 4).all()
    assert (lab[:, 1:].mean(axis=0) < 22).all()


def test_shares_of_what_people_wear():
    looks = LooksSettings()
    people = [draw_person(np.random.default_rng(i), i, looks) for i in range(1500)]
    assert np.mean([p.clothes_like_skin != "no" for p in people]) == pytest.approx(looks.clothes_like_skin, abs=0.04)
    assert np.mean([p.cap is not None for p in people]) == pytest.approx(looks.cap, abs=0.04)
    assert np.mean([p.handed == "left" for p in people]) == pytest.approx(looks.left_handed, abs=0.03)
    assert np.mean([p.sleeve == "long" for p in people]) == pytest.approx(looks.sleeves.long, abs=0.04)
    assert len({p.hair_style for p in people}) == 3


def test_sleeves_cover_what_their_name_says():
    """Skin on the forearm: all of it, half, hardly any."""

    def bare(sleeve):
        shares = {name: float(name == sleeve) for name in ("none", "short", "elbow", "rolled", "long")}
        actor = stands(1, LooksSettings(sleeves=type(LooksSettings().sleeves)(**shares)))
        mesh = actor.mesh(0.0)
        own = mesh.parts % PARTS_A_PERSON == Part.RIGHT_FOREARM
        return np.isclose(mesh.albedo[own], actor.person.skin).all(axis=1).mean()

    assert bare("none") == bare("short") == 1.0
    assert 0.4 < bare("rolled") < 0.7
    assert bare("long") < 0.3  # the round end within the hand
