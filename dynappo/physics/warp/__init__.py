"""A control step in MuJoCo Warp: one call, one CUDA graph. Start at `engine.py`.

- `engine`: the call, and the arrays that Warp keeps
- `arrays`: names and shapes of the arrays that JAX and Warp exchange
- `stages`: a control step: motors, physics, what is kept
- `kernels`: our own three kernels
- `building`: builds Warp's kernels in threads while JAX traces and XLA compiles

`physics.engine` imports `engine` and `arrays`, which need no Warp; `engine` imports the others when a
robot is made.
"""
