"""A real electromagnet and its ball through the same diagnosis: `python -m benchmarks.maglev`."""

import sys

from benchmarks.maglev.report import main

sys.exit(main())
