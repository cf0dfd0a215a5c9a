"""`python -m benchmarks.maglev`: the whole page."""

import sys

from benchmarks.maglev.report import main

sys.exit(main())
