"""Generalised advantage estimation that treats falls and time limits differently."""

import chex
import jax
from jaxtyping import Array, Float


def gae(
    reward: Float[Array, "N R"],
    discount: Float[Array, "N R"],
    truncation: Float[Array, "N R"],
    value: Float[Array, "N R"],
    bootstrap: Float[Array, "N R"],
    *,
    gamma: float | Float[Array, ""],
    lambda_: float | Float[Array, ""],
) -> tuple[Float[Array, "N R"], Float[Array, "N R"]]:
    """Advantages and returns (Schulman et al. 2016, eq. 16).

        delta_t = r_t + gamma d_t b_t - v_t
        A_t     = delta_t + gamma lambda d_t (1 - truncation_t) A_{t+1},     A_N = 0
        returns = A + v

    with `discount` d (0 after a fall), `value` v = V(o_t), and `bootstrap` b, the value of the next
    state. Libraries differ in b where the time limit ends an episode: we pass V(next_obs) of the
    true last observation; rsl_rl adds gamma V(o_t) to the reward (rsl_rl/algorithms/ppo.py).
    """
    chex.assert_equal_shape([reward, discount, truncation, value, bootstrap])
    delta = reward + gamma * discount * bootstrap - value
    decay = gamma * lambda_ * discount * (1 - truncation)

    def backward(later, row):
        delta, decay = row
        advantage = delta + decay * later
        return advantage, advantage

    # unrolled, 16 rows take one kernel instead of two each
    _, advantages = jax.lax.scan(backward, delta[0] * 0, (delta, decay), reverse=True, unroll=16)
    return advantages, advantages + value
