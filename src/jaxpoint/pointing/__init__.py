"""From an arm in several views to its line in the room, and to what lies on it.

Imported at once: `nearest` and `posterior` are names of functions and of their modules, and the functions must win.
"""

from jaxpoint.body.joints import Joints
from jaxpoint.body.limb_axis import LimbAxis, fit_axis
from jaxpoint.pointing.bias.bias import Bias
from jaxpoint.pointing.bias.fit import fit_bias, fit_personal_bias
from jaxpoint.pointing.bias.learn import Learnt, learn_bias
from jaxpoint.pointing.bias.pointings import Pointings
from jaxpoint.pointing.bias.solve import Observed
from jaxpoint.pointing.hits import Hits, intersect
from jaxpoint.pointing.nearest import Nearest, nearest, nearest_to_points
from jaxpoint.pointing.objects import Objects, Thing
from jaxpoint.pointing.pointing_line import PointingLine, pointing_lines, pointing_ray
from jaxpoint.pointing.posterior import Behaviour, Posterior, posterior
from jaxpoint.pointing.room_box import Room, RoomPoint, end_in_room
from jaxpoint.pointing.shapes import Box, Rectangle, Sphere
from jaxpoint.pointing.word_evidence import words_evidence

__all__ = [
    "Behaviour",
    "Bias",
    "Box",
    "Hits",
    "Joints",
    "Learnt",
    "LimbAxis",
    "Nearest",
    "Objects",
    "Observed",
    "PointingLine",
    "Pointings",
    "Posterior",
    "Rectangle",
    "Room",
    "RoomPoint",
    "Sphere",
    "Thing",
    "end_in_room",
    "fit_axis",
    "fit_bias",
    "fit_personal_bias",
    "intersect",
    "learn_bias",
    "nearest",
    "nearest_to_points",
    "pointing_lines",
    "pointing_ray",
    "posterior",
    "words_evidence",
]
