"""`python -m egocap_eval` is `egocap-eval`."""

import sys

from egocap_eval.cli import main

sys.exit(main())
