"""What learns to act: PPO, its advantages, and the networks. Start at `ppo.py`.

- `ppo`: the loss, a minibatch's step, the update of an iteration
- `gae`: advantages and returns of a rollout
- `symmetry`: a policy that treats left and right alike, by the mirror image of its gradient
- `networks`: multilayer perceptrons and the Gaussian policy

Pure functions of arrays. The method imports it, and `model` its networks; it imports `types` only.
"""
