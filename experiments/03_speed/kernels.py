"""Kernels of one gradient step, from a profile that ppo.py wrote.

    python experiments/03_speed/kernels.py PROFILE.xplane.pb.gz [STEPS=80]

Prints every kernel of a step in the middle with its time and the gap before it (us; negative: it began
before the last one ended), and their sum.
"""

import collections
import gzip
import sys

from jax.profiler import ProfileData


def events(path):
    """`(start ns, duration ns, name)` of every kernel on the GPU, in order."""
    profile = ProfileData.from_serialized_xspace(gzip.open(path).read())
    lines = [line for plane in profile.planes if "GPU" in plane.name for line in plane.lines]
    streams = [line for line in lines if line.name.startswith("Stream")]
    return sorted((e.start_ns, e.duration_ns, e.name) for line in streams for e in line.events)


def main(path, steps=80):
    kernels = events(path)
    counts = collections.Counter(name for _, _, name in kernels)
    mark = next(name for name in counts if counts[name] == steps)  # a kernel that a step has once
    marks = [i for i, kernel in enumerate(kernels) if kernel[2] == mark]
    first, last = marks[steps // 2 + 1], marks[steps // 2 + 2]
    end = kernels[first][0]
    for start, took, name in kernels[first:last]:
        print(f"{took / 1e3:7.2f}  {(start - end) / 1e3:6.2f}  {name[:100]}")
        end = start + took
    busy = sum(took for _, took, _ in kernels[first:last])
    span = kernels[last][0] - kernels[first][0]
    print(f"{last - first} kernels, {busy / 1e3:.1f} us of work in {span / 1e3:.1f} us")


if __name__ == "__main__":
    main(sys.argv[1], *(int(n) for n in sys.argv[2:]))
