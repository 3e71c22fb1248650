"""`python -m dynappo.train` with the toy environment in place of the robot's: starts in seconds.

python tests/toy_train.py --workdir=DIR [--config.FIELD=VALUE ...]
"""

import gc
import sys

import toy_env

from dynappo.run import learning_curves
from dynappo.tasks.velocity import env as env_lib
from dynappo.train import command as train_command

SMALL = (
    "run.device=cpu rollout.num_envs=16 rollout.horizon=8 run.log_every=2 run.checkpoint_every=4 "
    "run.eval_envs=8 run.video_seconds=0.0 run.tensorboard=False run.num_seeds=2 model.hidden=(24,24) "
    "model.epochs=2 ppo.hidden=(16,16) ppo.epochs=2 ppo.minibatches=2 task.episode_length=20 "
    "schedule.start_iteration=1 schedule.end_iteration=5"
).split()

ARGUMENTS = ["--config=configs/go1.py:dyna4", *(f"--config.{field}" for field in SMALL)]

if __name__ == "__main__":
    gc.set_threshold(50_000, 20, 100)  # as conftest.py
    env_lib.make = lambda *_, **__: toy_env.make()
    learning_curves.draw = lambda *_: (
        "no picture"
    )  # it would take as long as all else of such a run
    train_command.main([*ARGUMENTS, *sys.argv[1:]])
