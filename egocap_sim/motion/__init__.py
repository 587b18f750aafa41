"""Motion files or names of built-in motions in; canonical clips out.

`clips` reads files, `generators` makes motions, `retarget` adapts a clip to a person.
"""

from egocap_sim.motion.clips.load import load_clip as load_clip
from egocap_sim.motion.clips.load import load_motion as load_motion
from egocap_sim.motion.generators.registry import MOTIONS as MOTIONS
from egocap_sim.motion.generators.registry import make_motion as make_motion
from egocap_sim.motion.kinematics.clip import Clip as Clip
