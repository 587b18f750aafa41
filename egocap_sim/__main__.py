"""`python -m egocap_sim` is `egocap-sim`."""

import sys

from egocap_sim.cli import main

sys.exit(main())
