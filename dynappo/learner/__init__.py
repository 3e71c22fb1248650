"""The policy's learner: PPO, advantages, and the networks. Start at `ppo.py`.

- `ppo`: the loss, a minibatch's step, the update of an iteration
- `gae`: advantages and returns of a rollout
- `symmetry`: a policy that treats left and right alike: each gradient is averaged with its image
- `networks`: multilayer perceptrons and the Gaussian policy

Pure functions of arrays. The method imports it, and `model` imports its networks; it imports only
`types`.
"""
