"""dynappo: PPO whose rollout tails are written by a learned transition model.

Start at `algorithm.py`. Importing the package sets one flag of XLA's CPU compiler, before JAX starts:
with its concurrency-optimised scheduler, jaxlib 0.10.2 deadlocks on two cores at 256 robots, when
loops that run side by side (random bits, the constraint solver) take all threads and wait for one.
The flag costs nothing measurable; a value of the user's own is kept.
"""

import os

_FLAG = "--xla_cpu_enable_concurrency_optimized_scheduler"
if _FLAG not in os.environ.get("XLA_FLAGS", ""):
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {_FLAG}=false".strip()
