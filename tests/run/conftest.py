"""A run and its folder: of one small run."""

from small_run import config, program, whole  # noqa: F401
