"""The other use of a model that can be differentiated: the slope of the return through its predictions.

    J(theta) = mean over robots of sum_{k<H} gamma^k r_k + gamma^H V(o_H),  a_k = mu_theta(o_k) + s_theta e_k

from where physics ended, with the tail's own rewards, falls and noise; `H` is `ppo.first_order_steps`.
As in SVG (Heess and others 2015) and SHAC (Xu and others 2022), but beside PPO and not in its place: its
gradient at the parameters that made the rollout is added to that of every minibatch, so one KL keeps both
in hand.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
from jaxtyping import Array, Float

from dynappo import networks


def gradient(
    static, hyper, params: dict, step: Callable, state: Any, keys: Callable, unit: Float[Array, ""]
) -> dict:
    """The gradient of -w J / (H unit) in `params`, that of the critic 0; w is `ppo.first_order_weight`.

    `static` and `hyper` are the config's group `ppo`, `step` and `state` of a tail (algorithm.py),
    `keys(k)` those of its k-th step. `unit` is the deviation of all advantages, about what PPO divides them
    by; H because PPO's loss is a mean over actions.
    """
    steps = static.first_order_steps

    def objective(params):
        params = params | {"critic": jax.lax.stop_gradient(params["critic"])}
        draw = jax.vmap(lambda key: jax.random.normal(key, params["std"].shape))
        now, factor, total = state, 1.0, 0.0
        for k in range(steps):
            action = networks.policy(static, params, now.obs) + params["std"] * draw(keys(k))
            now, outcome = step(now, action, keys(k))
            total += factor * outcome.reward
            factor *= hyper.gamma * outcome.discount
        total += factor * networks.value(static, params, now.obs)
        return -hyper.first_order_weight * total.mean() / (steps * unit)

    return jax.grad(objective)(params)
