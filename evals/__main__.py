"""`python -m evals` is `egocap-eval`."""

import sys

from evals.cli import main

sys.exit(main())
