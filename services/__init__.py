"""The parts of scene-attack that both the API and the worker use, without HTTP and the queue."""

import os

# OpenMP threads spin at every barrier by default. With more busy threads than cores, as beside other workers, that cost
# torch a factor of 10 to 30 (measured, 2 threads on 2 shared cores). Read when torch is loaded, so set here, before.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
