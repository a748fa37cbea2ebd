from .known import KnownRoom as KnownRoom, known_in as known_in
from .rooms import RandomRoom as RandomRoom, random_room as random_room
from .scene import Scene as Scene, make_scene as make_scene
from .simulated_session import SimulatedSession as SimulatedSession, simulate_session as simulate_session
from .wave import SimulatedWave as SimulatedWave, simulate_wave as simulate_wave
