"""The data structures of a training iteration, and the symbols used for shapes everywhere.

| symbol | meaning                                  | symbol   | meaning                                   |
|--------|------------------------------------------|----------|-------------------------------------------|
| `I`    | iterations in one compiled call          | `O`, `A` | observation size, action size             |
| `N`    | rows of a rollout, `N = N_r + N_s`       | `P`      | predicted part of the observation         |
| `R`    | robots simulated in parallel             | `B`      | rows of a minibatch                       |
| `N_r`  | rows written by physics (`n_real`)       | `N_s`    | rows written by the transition model      |

Shapes in the comments are those of one seed; seeds exist only outside, as a `jax.vmap` axis.

What the names mean, everywhere:

- `discount` is 0 where the episode ended for good (a fall), else 1; only learner/gae.py applies
  gamma. In a tail with `model.falls` it is the probability that the episode continues.
- `truncation` is 1 where the time limit ended the episode: its value is bootstrapped from
  `next_obs` and no advantage crosses it. A row of physics never has both a fall and a truncation.
- `next_obs` is observed before any reset. Without a reset in between, it is the next row's `obs`, noise
  included.
- `prop` is the predicted part of the observation without its noise, `next_prop` that of `next_obs`.
- `static` and `hyper` are the two halves of the whole config (config/splitting.py); the fields of
  their types are in config/halves.py.
- A robot's `body` holds its own physical parameters; `params_physics` holds those of all robots.
- Row t is real if and only if `t < n_real`; that is not stored.

Why no iteration counter in `TrainState`: under `jax.vmap` over seeds a counter in the state becomes
batched, and so does every loop bound computed from it. The counter is a column of the schedule
instead, and the host counts simulator steps in Python integers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np
from flax import struct
from jaxtyping import Array, Float, Int, PRNGKeyArray

if TYPE_CHECKING:
    from dynappo.config.halves import Hyper as Hyper
    from dynappo.config.halves import Static as Static
else:
    Static = Hyper = Any  # named tuples that config/splitting.py makes

Metrics = dict[str, Array]  # scalars; a dict because it only leaves the loop
Columns = dict[str, Int[Array, "..."]]  # of schedule.columns, `[I]`, or one row of them


class Outcome(struct.PyTreeNode):
    """What one step returns to the learner; the step is the environment's or the model's."""

    reward: Float[Array, "..."]
    discount: Float[Array, "..."]
    truncation: Float[Array, "..."]
    next_obs: Float[Array, "... O"]
    next_prop: Float[Array, "... P"]
    episode_return: Float[Array, "..."]  # sum of rewards of this episode, this row included
    episode_length: Float[Array, "..."]  # rows of this episode, this one included
    valid: Any = 1.0  # [...]; 0 where physics blew up: no row for the model
    metrics: Metrics = struct.field(default_factory=dict)  # per robot; summed over physics' rows


class Transition(struct.PyTreeNode):
    """One row of the rollout buffer; `[N, R]` in front of every shape below."""

    obs: Float[Array, "... O"]
    action: Float[Array, "... A"]
    action_mean: Float[Array, "... A"]  # the KL of the adaptive learning rate needs it
    log_prob: Float[Array, "..."]
    value: Float[Array, "..."]
    reward: Float[Array, "..."]
    discount: Float[Array, "..."]
    truncation: Float[Array, "..."]
    next_obs: Float[Array, "... O"]
    prop: Float[Array, "... P"]
    next_prop: Float[Array, "... P"]
    valid: Float[Array, "..."]
    episode_return: Float[Array, "..."]
    episode_length: Float[Array, "..."]


class Learner(struct.PyTreeNode):
    """Policy and value function, their optimiser, and the learning rate, adapted by the KL."""

    params: Any
    opt_state: Any
    learning_rate: Float[Array, ""]


class Moments(struct.PyTreeNode):
    """Running mean and variance of a vector; `weight` corrects the bias of the first updates."""

    mean: Float[Array, "..."]
    var: Float[Array, "..."]
    weight: Float[Array, ""]


class ModelState(struct.PyTreeNode):
    """The transition model: weights, optimiser, and the moments that scale its input and target."""

    params: Any
    opt_state: Any
    inputs: Moments
    targets: Moments


class Memory(struct.PyTreeNode):
    """The newest M real rows of each robot (model/memory.py), as a ring; `[M, R]` in front of every shape."""

    x: Float[Array, "... I"]  # the model's input,
    y: Float[Array, "... K"]  # its target,
    weight: Float[Array, "..."]  # and 1 or 0
    obs: Float[Array, "... O"]  # where a tail may begin
    prop: Float[Array, "... P"]


class TrainState(struct.PyTreeNode):
    """Everything that a run carries from one iteration to the next."""

    learner: Learner
    model: ModelState | None  # None: plain PPO, no model in the compiled program
    env_state: Any  # [R]
    params_physics: Any  # [R] bodies, drawn once in `algorithm.init`
    robot_index: Int[Array, " R"]  # global, so that no random number depends on the device
    returns: Float[Array, "100"]  # of the last finished episodes, newest last; NaN before
    lengths: Float[Array, "100"]
    key: PRNGKeyArray
    memory: Memory | None = None  # None: without, or plain PPO


class Mirror(NamedTuple):
    """The mirror image, left for right, of a vector: `sign * x[index]`. Its own inverse."""

    index: np.ndarray  # [K] int
    sign: np.ndarray  # [K] 1.0 or -1.0


class Views(NamedTuple):
    """The columns of `obs` that each network sees."""

    actor: np.ndarray
    critic: np.ndarray  # with `ppo.critic = "state"`; with "obs" it sees what the actor sees
    model: np.ndarray


class Env(NamedTuple):
    """An environment as pure functions of one robot, and the sizes that the learner needs.

    `hyper` is the pytree of the config's floats, `body` the robot's own physical parameters.
    `step` never resets, `autoreset` does. States must have the fields `obs` and `prop`. If they have
    a `clock`, the age of the episode, an evaluation sets it.

    What is known is computed, the rest is predicted:

        obs = [ prop, as it is sensed | context ]

    The model predicts `prop`. The context is what is known of the next state: its next value follows
    from the row, and `advance` computes it exactly, in every row that the model writes. So a command,
    the last action, a clock, a phase, the place in the world and the ground there belong to it. What
    no network should see is left out of `views`. `sense` is what sensors make of a prop (used with
    `model.clean`), and `known_reward` is the share of the reward that is a function of obs, action
    and next prop (with `model.known_reward`).

    Fields with a default are optional. docs/environment.md has an example.
    """

    reset: Callable[..., Any]  # (hyper, body, key) -> state
    step: Callable[..., Any]  # (hyper, body, state, action, key) -> state, Outcome
    autoreset: Callable[..., Any]  # (hyper, body, state, Outcome, key) -> state
    obs_size: int
    prop_size: int
    action_size: int
    dt: float  # s, one control step
    episode_length: int  # control steps
    metrics: tuple[str, ...] = ()  # names in Outcome.metrics
    randomize: Callable[..., Any] = lambda hyper, key: None  # (hyper, key) -> body
    # (hyper, context, prop, action, next_prop) -> context [O - P] after `action`; `prop` is as it was
    # sensed. By default nothing is known, and all of obs predicted
    advance: Callable[..., Any] = lambda hyper, context, prop, action, next_prop: context[:0]
    # (hyper, prop, context, key) -> prop [P] as it is sensed; by default exactly
    sense: Callable[..., Any] = lambda hyper, prop, context, key: prop
    # (hyper, context, key) -> context [O - P] of a row of a tail as it is sensed, where noise is on what is
    # known, too; None: exactly. `advance` must read nothing that it changes
    sense_context: Callable[..., Any] | None = None
    views: Views | None = None  # None: every network sees all of obs
    # (hyper, obs, action, next_prop) -> []
    known_reward: Callable[..., Any] = lambda hyper, obs, action, next_prop: np.float32(0)
    # (hyper, prop, context) -> [], 1 where a state is known to be the end of its episode; a tail's discount
    # is 0 there, whatever the model predicts. None: nothing is known of it
    known_end: Callable[..., Any] | None = None
    # (hyper) -> [], the share of the reward that a fall (`discount` 0) pays once, not times dt (with
    # `model.falls`); None: none
    fall_reward: Callable[..., Any] | None = None
    # (state) -> action [A], of an environment whose rows are recorded: what was done then, whatever the
    # policy would do. PPO does not learn from such rows
    recorded: Callable[..., Any] | None = None
    # (hyper, context, key) -> context of a robot that is asked something else, with `schedule.new_commands`
    retell: Callable[..., Any] | None = None
    mirror: tuple[Mirror, Mirror] | None = None  # of obs and action, with `ppo.symmetry`
    input_scale: np.ndarray | None = None  # [O] of each number of obs, with `ppo.scale_inputs`
    # (hyper) -> hyper of an evaluation, which scores.py has made nominal; None: that
    evaluated: Callable[..., Any] | None = None
    mesh: jax.sharding.Mesh | None = None  # devices over which the robots are spread (seeds.py)


def autoreset(reset: Callable[..., Any]) -> Callable[..., Any]:
    """`Env.autoreset` for an environment that starts every episode with its `reset`."""

    def restart(hyper, body, state, outcome, key):
        ended = (outcome.discount == 0) | (outcome.truncation == 1)
        fresh = reset(hyper, body, key)
        return jax.tree.map(lambda new, old: jax.numpy.where(ended, new, old), fresh, state)

    return restart
