"""A pilot-operated solenoid valve of an ultra-high-pressure hydrogen vessel: simulated, identified, diagnosed."""

import os

# NumPy reads this where it is loaded. The matrices of a fit are thin: threads of the linear algebra wait for each
# other, and beside other work a diagnosis has taken 240 CPU seconds for 32. What a user has set stays.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__version__ = "0.2.0"
