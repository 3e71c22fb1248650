"""The transition model, which writes the tail of a rollout. Start at `dynamics.py`.

`examples.examples` turns rows of a rollout into training data, `dynamics.fit` learns from them,
`dynamics.tail` begins a tail, and `rollout.fill` writes its rows with `dynamics.step`.

- `dynamics`: the network, its fit, and `step`, which replaces an environment's step
- `examples`: its training data: rows of a rollout as inputs, targets and weights
- `memory`: rows of past iterations, which it learns from and tails begin in; more imagined robots than real
- `moments`: running means and variances, which scale its inputs and targets
- `errors`: its prediction error, after one step and after several

Pure functions of arrays. `algorithm`, `fast` and `bench` import it; it imports `types`,
`learner.networks` and `learner.symmetry`.
"""
