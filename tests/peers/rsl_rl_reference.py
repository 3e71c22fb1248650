"""Reference values of PPO, computed by rsl-rl-lib 3.0.1's own code, for the tests of this project.

What: runs rsl_rl's ``ActorCritic``, ``RolloutStorage`` and ``PPO`` on small random data, on the CPU
in float32, and saves what went in and what came out:

* ``gae.npz``      returns and advantages, with falls and time-outs
* ``update.npz``   one gradient step: losses, KL, gradients, learning rate, parameters after
* ``updates.npz``  5 epochs x 4 mini-batches: the sequence of KL, learning rate, norm and losses
* ``policy.npz``   log-probability, entropy and KL of diagonal Gaussians, per sample

No formula of rsl_rl is written again here. Its intermediate values are read by wrapping functions
of torch that it calls (``randperm``, ``mean``, ``max``, ``Tensor.backward``, ``clip_grad_norm_``).

The values come from these files of rsl_rl 3.0.1: ``algorithms/ppo.py`` (PPO.act, process_env_step,
compute_returns, update), ``storage/rollout_storage.py`` (add_transitions, compute_returns,
mini_batch_generator), ``modules/actor_critic.py`` (the policy) and ``networks/mlp.py``.

To regenerate (written 2026-11-21)::

    pip install torch==2.13.0 rsl-rl-lib==3.0.1
    python tests/peers/rsl_rl_reference.py [OUTDIR]

Conventions: [T, R] is step by environment, and samples are flattened with T first
(``x.reshape(T * R, ...)``); mini-batch i of every epoch holds the samples
``permutation[i * B : (i + 1) * B]``. Weights are [out, in], as torch has them. A parameter's bare
name (``std``, ``actor.0.weight``, ...) is its value when PPO.update is called; the prefixes are
``collect.`` (while acting), ``grad.`` (before clipping) and ``after.`` (after PPO.update).
``loss.*`` is what PPO.update returns, the mean over the gradient steps; ``step.*`` has an entry
per gradient step: ``norm`` is the gradient's before clipping, ``learning_rate`` the one used.
``done`` is a fall or a time-out, and ``reward`` lacks what PPO adds to it on time-outs.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import io
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from unittest import mock

import numpy as np
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.modules import ActorCritic
from tensordict import TensorDict

Arrays = dict[str, np.ndarray]

SETTINGS = {"clip_param": 0.2, "gamma": 0.99, "lam": 0.95, "value_loss_coef": 1.0}
SETTINGS |= {"entropy_coef": 0.01, "learning_rate": 1e-3, "max_grad_norm": 1.0, "desired_kl": 0.01}
N_ACTIONS = 12


def observe(x: np.ndarray) -> TensorDict:
    return TensorDict({"policy": torch.from_numpy(x)}, batch_size=[len(x)])


def array(x: torch.Tensor) -> np.ndarray:
    return x.detach().clone().numpy()


def make_ppo(obs: np.ndarray, steps: int, epochs: int = 1, batches: int = 1) -> PPO:
    example, groups = observe(obs), {"policy": ["policy"], "critic": ["policy"]}
    sizes = {"actor_hidden_dims": [32, 32, 32], "critic_hidden_dims": [32, 32, 32]}
    with contextlib.redirect_stdout(io.StringIO()):  # it prints its layers
        policy = ActorCritic(
            example, groups, N_ACTIONS, activation="elu", init_noise_std=1.0, **sizes
        )
    flags = {"use_clipped_value_loss": True, "schedule": "adaptive"}
    ppo = PPO(policy, num_learning_epochs=epochs, num_mini_batches=batches, **flags, **SETTINGS)
    ppo.init_storage("rl", len(obs), steps, example, [N_ACTIONS])
    return ppo


def collect(ppo: PPO, obs: np.ndarray, rng: np.random.Generator) -> Arrays:
    """Acts on obs [T + 1, R, n], with random rewards, falls and time-outs; fills the storage."""
    steps, n_envs = obs.shape[0] - 1, obs.shape[1]
    reward = 1.2 * rng.normal(size=(steps, n_envs)).astype(np.float32)
    event = rng.random((steps, n_envs))
    event[-1, :3] = 0.05, 0.15, 0.9  # at the last step: a fall, a time-out, neither
    time_out = ((event >= 0.1) & (event < 0.2)).astype(np.float32)
    done = (event < 0.2).astype(np.float32)  # a fall or a time-out
    with torch.no_grad():
        for t in range(steps):
            ppo.act(observe(obs[t]))
            step = (torch.from_numpy(x[t]) for x in (reward, done))
            ppo.process_env_step(
                observe(obs[t + 1]), *step, {"time_outs": torch.from_numpy(time_out[t])}
            )
        ppo.compute_returns(observe(obs[-1]))
        last_value = array(ppo.policy.evaluate(observe(obs[-1])))[:, 0]
    s = ppo.storage
    out = {"reward": reward, "done": done, "time_out": time_out, "last_value": last_value}
    out |= {"obs": obs[:-1], "action": array(s.actions), "mean": array(s.mu)}
    out |= {"sigma": array(s.sigma), "log_prob": array(s.actions_log_prob)[..., 0]}
    out |= {"value": array(s.values)[..., 0], "returns": array(s.returns)[..., 0]}
    return out | {"advantage": array(s.advantages)[..., 0]}


def params(policy: ActorCritic, prefix: str = "") -> Arrays:
    return {prefix + name: array(p) for name, p in policy.named_parameters()}


def spy(owner: object, name: str, note: Callable) -> contextlib.AbstractContextManager:
    """Calls note(result, *arguments) after each call of the function."""
    original = getattr(owner, name)

    def wrapper(*args, **kwargs):
        out = original(*args, **kwargs)
        note(out, *args)
        return out

    return mock.patch.object(owner, name, wrapper)


@contextlib.contextmanager
def recorded(ppo: PPO) -> Iterator[dict[str, list]]:
    """Lists, one entry per gradient step (``permutation``: per call), filled by PPO.update."""
    log: dict[str, list] = defaultdict(list)

    def mean(out, kl):  # PPO.update calls it for the KL of the samples only
        log["kl"].append(array(kl))
        log["kl_mean"].append(out.item())

    def maximum(out, *_):  # the larger of the unclipped and the clipped loss of each sample
        log["surrogate" if out.ndim == 1 else "value_function"].append(out.mean().item())

    def backward(*_):
        log["grad"].append({n: array(p.grad) for n, p in ppo.policy.named_parameters()})

    def clip(out, *_):
        log["norm"].append(out.item())
        log["learning_rate"].append(ppo.optimizer.param_groups[0]["lr"])

    with (
        spy(torch, "randperm", lambda out, *_: log["permutation"].append(array(out))),
        spy(torch, "mean", mean),
        spy(torch, "max", maximum),
        spy(torch.Tensor, "backward", backward),
        spy(torch.nn.utils, "clip_grad_norm_", clip),
    ):
        yield log


def gae() -> Arrays:
    rng = np.random.default_rng(1)
    obs = rng.normal(size=(13, 16, 1)).astype(np.float32)
    ppo = make_ppo(obs[0], 12)
    ppo.policy.critic = torch.nn.Identity()  # the observation is the value
    data = collect(ppo, obs, rng)
    names = ("reward", "value", "last_value", "done", "time_out", "returns", "advantage")
    last_value = torch.from_numpy(data["last_value"][:, None])
    ppo.storage.compute_returns(last_value, ppo.gamma, ppo.lam, normalize_advantage=False)
    out = {k: data[k] for k in names} | {"advantage_raw": array(ppo.storage.advantages)[..., 0]}
    return out | {"gamma": np.array(ppo.gamma), "lam": np.array(ppo.lam)}


def update(seed: int, epochs: int, batches: int, scale: dict[str, float]) -> Arrays:
    """scale: by how much the parameters move between acting and PPO.update."""
    rng = np.random.default_rng(seed)
    obs = rng.normal(size=(9, 32, 48)).astype(np.float32)
    ppo = make_ppo(obs[0], 8, epochs, batches)
    out = collect(ppo, obs, rng) | params(ppo.policy, "collect.")
    with torch.no_grad():
        for name, p in ppo.policy.named_parameters():
            p.add_(scale.get(name.split(".")[0], 0.0) * torch.randn_like(p))
    out |= params(ppo.policy) | {k: np.array(v) for k, v in SETTINGS.items()}
    with recorded(ppo) as log:
        losses = ppo.update()
    (out["permutation"],) = log["permutation"]  # one for all the epochs
    out |= {f"loss.{k}": np.array(v) for k, v in losses.items()}
    for name in ("kl_mean", "surrogate", "value_function", "norm", "learning_rate"):
        out["step." + name] = np.array(log[name])
    if epochs * batches == 1:
        out |= {"grad." + name: g for name, g in log["grad"][0].items()}
    return out | params(ppo.policy, "after.")


def policy_functions() -> Arrays:
    rng = np.random.default_rng(4)
    mean, shift, noise = rng.normal(size=(3, 64, N_ACTIONS)).astype(np.float32)
    old_mean = mean + 0.5 * shift
    std, old_std = rng.uniform(0.5, 1.5, size=(2, 64, N_ACTIONS)).astype(np.float32)
    ppo = make_ppo(mean, 1)
    policy, tr = ppo.policy, ppo.transition
    policy.actor = torch.nn.Identity()  # the observation is the mean
    policy.std = torch.nn.Parameter(torch.from_numpy(std))  # a row per sample; never optimised
    tr.observations, tr.actions = observe(mean), torch.zeros(64, N_ACTIONS)
    tr.action_mean, tr.action_sigma = torch.from_numpy(old_mean), torch.from_numpy(old_std)
    tr.rewards = tr.dones = tr.actions_log_prob = torch.zeros(64)
    tr.values = torch.zeros(64, 1)
    ppo.storage.add_transitions(tr)
    with recorded(ppo) as log:
        ppo.update()
    order = log["permutation"][0]  # the policy's distribution is now the one of this mini-batch
    out = {"mean": array(policy.action_mean), "std": array(policy.action_std)}
    out |= {"old_mean": old_mean[order], "old_std": old_std[order]}
    out |= {"kl": log["kl"][0], "kl_mean": np.array(log["kl_mean"][0])}
    out["action"] = out["mean"] + out["std"] * noise
    out["log_prob"] = array(policy.get_actions_log_prob(torch.from_numpy(out["action"])))
    return out | {"entropy": array(policy.entropy)}


def generate() -> dict[str, Arrays]:
    """File stem -> name -> array."""
    cases = {
        "gae": gae,
        "update": lambda: update(2, 1, 1, {"actor": 0.03, "critic": 0.05, "std": 0.05}),
        "updates": lambda: update(3, 5, 4, {}),
        "policy": policy_functions,
    }
    packages = {"torch": torch.__version__, "rsl-rl-lib": importlib.metadata.version("rsl-rl-lib")}
    out = {}
    for seed, (stem, case) in enumerate(cases.items()):
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            out[stem] = case() | {"versions": np.array([f"{k} {v}" for k, v in packages.items()])}
    return out


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
    folder.mkdir(parents=True, exist_ok=True)
    for stem, arrays in generate().items():
        np.savez_compressed(folder / f"{stem}.npz", **arrays)


if __name__ == "__main__":
    main()
