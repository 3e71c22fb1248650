"""A control step on a GPU: one call of Warp. Start at `call`, then `quadruped`.

- `call`: the call, and what Warp keeps between calls
- `arrays`: names and shapes of the arrays that JAX and Warp exchange
- `quadruped`: one kernel for a robot that keeps the contract; algebra.h and quadruped.h are its source
- `scope`: which files that kernel computes, and why not the others
- `general`: any other file, by MuJoCo Warp's own step
- `kernels`: what `general` does between physics steps
- `building`: builds Warp's kernels in threads while JAX traces and XLA compiles

`physics.engine` imports `call`, `arrays` and `scope`, which need no Warp; `call` imports the others
when a robot is made. `scope` needs no JAX either.
"""
