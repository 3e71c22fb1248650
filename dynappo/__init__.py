"""dynappo: PPO whose rollout tails are written by a learned transition model.

Start at `algorithm.py`. Importing the package sets two flags of XLA's CPU compiler, before JAX starts;
a value of the user's own is kept.

- The concurrency-optimised scheduler is off: with it, jaxlib 0.10.2 deadlocks on two cores at 256
  robots, when loops that run side by side (random bits, the constraint solver) take all threads and
  wait for one. Costs nothing measurable.
- jaxlib 0.10.2 computes wrong numbers in sums of products with more than 32,768 results
  (jax-ml/jax#39103): from robot 2,340 on, lowest points of a Go1 were wrong and falls were seen where
  there were none. The fusion that does it is off, in that version only; no GPU is affected.
"""

import os
from importlib import metadata

_FLAGS = {"--xla_cpu_enable_concurrency_optimized_scheduler": "false"}
if metadata.version("jaxlib") == "0.10.2":
    _FLAGS["--xla_cpu_experimental_ynn_fusion_type"] = ""
for _flag, _value in _FLAGS.items():
    if _flag not in os.environ.get("XLA_FLAGS", ""):
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {_flag}={_value}".strip()
