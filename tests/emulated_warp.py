"""A warp of 32 threads on a CPU: tree.h with the branches that a GPU takes, every lane a thread.

    python tests/emulated_warp.py ROBOT [--robots 64] [--races] [--without SYNC]

Barriers and shuffles are pthread barriers, shared memory is a static. Prints the largest difference of each
result from Warp's one thread a robot. With `--races` g++'s ThreadSanitizer reports what two lanes touch
without a barrier between (run it with `tsan()` in LD_PRELOAD); `--without N` takes the N-th barrier out, to
see that it does. Needs g++.
"""

import argparse
import ctypes
import functools
import inspect
import re
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import warp as wp

from dynappo.physics.warp import arrays, native, tree

LANES = 32
HEAD = """
#define WP_NO_BFLOAT16
#define WP_TILE_BLOCK_DIM 1
#include "builtin.h"
#include <cstring>
#include <pthread.h>
#include <thread>
#include <vector>
static pthread_barrier_t all;
static float shown[32];
static thread_local int lane_of_thread;
struct Index { int x; };
#define threadIdx Index{lane_of_thread}
static void __syncwarp() { pthread_barrier_wait(&all); }
static float __shfl_sync(unsigned, float x, int from) {
  shown[lane_of_thread] = x;
  __syncwarp();
  const float found = shown[from & 31];
  __syncwarp();
  return found;
}
static float __shfl_xor_sync(unsigned mask, float x, int way) {
  return __shfl_sync(mask, x, lane_of_thread ^ way);
}
template <class T> static wp::array_t<T> array(void* data, const int* shape, int axes) {
  wp::array_t<T> a;
  memset((void*)&a, 0, sizeof a);
  a.data = (T*)data, a.ndim = axes;
  for (int i = axes - 1, size = sizeof(T); i >= 0; size *= shape[i--])
    a.shape[i] = shape[i], a.strides[i] = size;
  return a;
}
using namespace wp;
"""
RUN = """
extern "C" void run(int robots, const int* sizes, void** data, const int* shapes, const int* axes) {
  pthread_barrier_init(&all, 0, 32);
  std::vector<std::thread> lanes;
  for (int lane = 0; lane < 32; ++lane)
    lanes.emplace_back([=] {
      lane_of_thread = lane;
      for (int robot = 0; robot < robots; ++robot) {
        __syncwarp();
        of_thread(robot * 32 + lane, sizes[0], sizes[1], sizes[2], sizes[3], GIVEN);
      }
    });
  for (auto& lane : lanes) lane.join();
}
"""


@functools.cache
def tsan() -> str:
    """ThreadSanitizer's library, for LD_PRELOAD; "" where g++ has none."""
    try:
        found = subprocess.run(
            ["g++", "-print-file-name=libtsan.so"], capture_output=True, text=True
        )
    except FileNotFoundError:
        return ""
    return found.stdout.strip() if "/" in found.stdout else ""


def source(snippet: str, without: int | None = None) -> tuple[str, list[str]]:
    """C++ of a text of `native.code`, and the names of its arrays."""
    kinds = inspect.get_annotations(native.kernel(snippet).func, eval_str=True)
    kinds = {name: kind for name, kind in kinds.items() if not isinstance(kind, type)}
    types = {wp.float32: "wp::float32", wp.int32: "wp::int32", wp.vec3: "wp::vec_t<3, wp::float32>"}
    of = {name: types[kind.dtype] for name, kind in kinds.items()}
    if without is not None:
        at = [found.span() for found in re.finditer(r"^ +SYNC\(\);", snippet, re.M)][without]
        snippet = snippet[: at[0]] + snippet[at[1] :]
    snippet = snippet.replace("defined(__CUDA_ARCH__)", "1").replace("__shared__", "static")
    takes = ", ".join(f"wp::array_t<{kind}> {name}" for name, kind in of.items())
    given = ", ".join(
        f"array<{kind}>(data[{i}], shapes + 4 * {i}, axes[{i}])"
        for i, kind in enumerate(of.values())
    )
    head = "int thread, int substeps, int rounds, int line_rounds, int flag"
    function = f"static void of_thread({head}, {takes}) {{\n{snippet}\n}}\n"
    return HEAD + function + RUN.replace("GIVEN", given), [*of]


def step(case, robots: int, races: bool = False, without: int | None = None) -> dict:
    """What 32 lanes make of the first `robots` of a `kernel_case.Case` of the tree's kernel."""
    buffers = tree.allocate(case.model, case.shape, robots)
    snippet = code_of(case)
    text, names = source(snippet, without)
    sizes, held = buffers.numbers[:4], [x.numpy() for x in buffers.numbers[4:]]
    a = dict(zip(names, held, strict=False)) | {n: case.before[n] for n in case.sizes()}
    whole = {n for n in names if n in ("tables", *arrays.COUNTS)}
    a = {n: np.array(a[n], np.int32 if n in whole else np.float32, order="C") for n in names}
    shapes = np.zeros((len(names), 4), np.int32)
    axes = np.zeros(len(names), np.int32)
    for i, name in enumerate(names):
        vectors = name in arrays.MODEL and len(case.sizes()[name]) == 2
        shape = a[name].shape[:-1] if vectors else a[name].shape
        shapes[i, : len(shape)], axes[i] = shape, len(shape)
    with tempfile.TemporaryDirectory() as folder:
        path, library = Path(folder, "lanes.cpp"), Path(folder, "lanes.so")
        path.write_text(text)
        native_headers = Path(wp.__file__).with_name("native")
        flags = ["-std=c++17", "-O1", "-w", "-shared", "-fPIC", "-I", native_headers]
        flags += ["-g", "-fsanitize=thread"] * races
        subprocess.run(["g++", *flags, path, "-o", library, "-lpthread"], check=True)
        run = ctypes.CDLL(str(library)).run
    pointers = (ctypes.c_void_p * len(names))(*(a[name].ctypes.data for name in names))
    integers = np.array(sizes, np.int32)
    run(
        robots,
        *(ctypes.c_void_p(x.ctypes.data) for x in (integers,)),
        pointers,
        _at(shapes),
        _at(axes),
    )
    return {name: a[name][:robots] for name in (*arrays.IN_OUT, *arrays.RESULTS)}


def _at(x: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(x.ctypes.data)


def code_of(case) -> str:
    """The text that the kernel of `case` was compiled from."""
    own, texts = native.kernel, []

    def seen(text):
        texts.append(text)
        return own(text)

    native.kernel = seen
    try:
        tree.allocate(case.model, case.shape, 1)
    finally:
        native.kernel = own
    return texts[-1]


def main():
    from tree_robots import made

    parser = argparse.ArgumentParser()
    parser.add_argument("robot")
    parser.add_argument("--robots", type=int, default=64)
    parser.add_argument("--races", action="store_true")
    parser.add_argument("--without", type=int)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        case = made(args.robot, folder)
    expected = case.step(case.before)
    for name, found in step(case, args.robots, args.races, args.without).items():
        print(f"{name} {np.abs(found.astype(float) - expected[name][: args.robots]).max():.3g}")


if __name__ == "__main__":
    main()
