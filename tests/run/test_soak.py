"""Checkpoints of three hours: memory does not grow with them, but for a leak that is tensorstore's.

Three hours of `best` on a GPU are 3,000 checkpoints (100 iterations of 35 ms each). tensorstore 0.1.86 never
frees the lists that it makes of JSON: orbax asks it for counters twice a save, and for a JSON text once an
array. That is 0.05 MB a checkpoint of 60 arrays, 50 MB in 1,000. It is shown here by itself, and left out.
"""

import pytest
from answers import shell

SOAK = """
import gc, tempfile
from pathlib import Path
import jax.numpy as jnp
import tensorstore
from dynappo.run import checkpoint

def resident():
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6

ask = tensorstore.experimental_collect_matching_metrics
known = tensorstore.KvStore.Spec({"driver": "file", "path": "/"}).to_json()
tensorstore.experimental_collect_matching_metrics = lambda *_: []
tensorstore.KvStore.Spec.to_json = lambda self: known | {"path": self.url.removeprefix("file://")}
state = {"params": {"kernel": jnp.ones((16, 16)), "bias": jnp.ones(16)}}
with tempfile.TemporaryDirectory() as folder, checkpoint.opened(Path(folder)) as checkpoints:
    for step in range(1, 3001):
        checkpoint.save(checkpoints, step, state, float(step % 7), sim_steps=step, config={})
        checkpoint.wait(checkpoints)
        if step in (2000, 3000):
            print(step, resident())
    assert len(checkpoints.all_steps()) == 4
for _ in range(1000):
    ask("/tensorstore/kvstore/")
print("upstream", resident())
"""


@pytest.mark.slow
def test_memory_does_not_grow_with_checkpoints():
    """Less than 1 MB in the last 1,000; and the leak upstream is still there."""
    done = shell("-c", SOAK, timeout=900)
    found = {name: float(value) for name, value in map(str.split, done.stdout.splitlines())}
    assert found["3000"] - found["2000"] < 1.0, done.stdout
    lost = found["upstream"] - found["3000"]
    assert lost > 1.0, "tensorstore has mended its leak: take it out of this file"
