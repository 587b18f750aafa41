"""`python -m egocap` is `egocap`."""

import sys

from egocap.cli import main

sys.exit(main())
