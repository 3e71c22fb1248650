"""A control step on a GPU: one call of Warp. Start at `call`, then `quadruped`, then `tree`.

- `call`: the call, and what Warp keeps between calls
- `arrays`: names and shapes of the arrays that JAX and Warp exchange
- `quadruped`: one kernel for a base on four legs of three joints: algebra.h, arrow.h and quadruped.h
- `tree`: one kernel for any other tree of hinges: algebra.h and tree.h
- `native`: what these two share beside algebra.h, and ground.h on ground that is not flat
- `scope`: which files they compute, and why not the others
- `general`: any other file, by MuJoCo Warp's own step
- `kernels`: what `general` does between physics steps; `rough`, on ground that is not flat
- `building`: builds Warp's kernels in threads while JAX traces and XLA compiles

`physics.engine` imports `call`, `arrays` and `scope`, which need no Warp; `call` imports the others
when a robot is made. `scope` needs no JAX either.
"""
