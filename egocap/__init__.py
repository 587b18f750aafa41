"""EgoCap: full-body motion capture from head-worn fisheye cameras.

Images of a calibrated rig in; poses with their uncertainty out. The simulator is `egocap_sim`.
"""

import os

# Idle threads must sleep, not spin: spinning threads take the core from the thread they wait for,
# and one image then took three to eight times longer. OpenMP reads this once, when torch or numba
# load it; a value set outside stays.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

__version__ = "0.1.0"
