"""The transition model, which writes the tail of a rollout. Start at `dynamics.py`.

`dynamics.tail` begins a tail, `rollout.fill` writes its rows with `dynamics.step`.

- `dynamics`: the network, its fit, and `step`, which stands in for an environment's
- `examples`: what it learns from: rows of a rollout as inputs, targets and weights
- `moments`: the running means and variances by which its numbers are scaled
- `errors`: how wrong it is, after one prediction and after several

Pure functions of arrays. `algorithm` and `bench` import it; it imports `types` and `learner.networks`.
"""
