"""Numbers that could be wrong without a word: of one small run."""

from small_run import config, program, whole  # noqa: F401
