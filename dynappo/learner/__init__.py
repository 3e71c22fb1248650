"""The policy's learner: PPO, advantages, and the networks. Start at `ppo.py`.

- `ppo`: the update of an iteration, a minibatch's step, the loss
- `gae`: advantages and returns of a rollout
- `symmetry`: a policy that treats left and right alike, by the mean of each gradient and its image
- `units`: networks that learn as if parts of an observation came in other units
- `scaling`: inputs of mean 0 and variance 1
- `networks`: multilayer perceptrons and the Gaussian policy

Pure functions of arrays. The method imports it, and `model` imports its networks; it imports only
`types`. The loop calls `update` and `actor_critic` of fast.py, which give the same numbers.
"""
