"""Motions: read from files, or made; all as canonical clips."""

from egocap_sim.motion.clip import Clip as Clip
from egocap_sim.motion.load import load_clip as load_clip
from egocap_sim.motion.procedural import MOTIONS as MOTIONS
from egocap_sim.motion.procedural import make_motion as make_motion
