"""The tracker: poses from detections and from images."""

import os

# Threads that spin while they wait take the core from the one they wait for when the machine does
# other things, too: an image then took three to eight times longer. Set here, before torch or numba
# load OpenMP, which reads it once; whoever wants it otherwise sets it outside.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
