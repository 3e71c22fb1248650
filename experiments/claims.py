"""The numbers that more than one page states, each once: docs/numbers.csv, with hardware, date and source.

    python experiments/claims.py      # writes docs/numbers.csv; a line for each page that says something else

Those of runs are computed from files of results; `MEASURED` has times that somebody took by hand. A new
measurement is a new row here, then this command, then the pages that it names. `STATED` has the words in
which a page states a number; tests/results/test_claims.py holds the pages to them.
"""

import csv
import importlib
import lzma
import re
import runpy
from pathlib import Path

import numpy as np

from dynappo.policy import walks
from experiments import stats

ROOT = Path(__file__).parents[1]
NUMBERS = ROOT / "docs/numbers.csv"
COLUMNS = "name value unit hardware date commit source".split()
HEADLINE = "experiments/21_less/results/headline.csv.xz"
HUMANOID = "experiments/25_humanoid/results/tuning.csv.xz"
SECONDS = "experiments/30_row_cost/results/alone.csv.xz"
ROW_COST = "experiments/30_row_cost/README.md"
ROUGH = "experiments/28_rough/results/fresh.csv.xz"
FEW = "experiments/27_few/results/gpu.csv.xz"
LAPTOP = "experiments/04_laptop/results/make_train.txt"
SAC = "experiments/24_off_policy/results/sac_symmetric.csv"
SAC_FIRST = "experiments/24_off_policy/results/sac_symmetric_cut.csv"
CROSSQ = "experiments/24_off_policy/results/fresh/crossq-256-symmetric-103-107.csv"
CROSSQ_FEW = "experiments/24_off_policy/results/fresh/crossq-64-symmetric-103-105.csv"
FRESH = "2026-11-27", "e01cca1"
COMMITS = {  # of batches of SECONDS; rows of the first do not have theirs
    "H200, 2026-11-27": "24fde7d",
    "H200, 2026-11-27, second host": "b770579",
    "H200, 2026-11-28": "a00ece3",
    "H200, 2026-11-28, second host": "7ab526d7",
    "H200, 2026-11-28, third host": "6b56a815",
    "H200, 2026-11-28, fourth host": "a6010c44",
    "H200, 2026-11-28, fifth host": "a6010c44",
    "H200, 2026-11-28, sixth host": "503dba45",
    "H200, 2026-11-28, seventh host": "71c94de1",
    "H200, 2026-11-28, eighth host": "d4ea24ce",
    "H200, 2026-11-29": "94da69b8",
    "H200, 2026-11-29, second host": "724e00df",
    "H200, 2026-11-29, third host": "32eca169",
    "H200, 2026-11-29, fourth host": "05f6d8fb",
    "H200, 2026-11-30": "2a51cc3d",
    "two cores, 2026-11-29": "215ed131",
}
CORES = "two CPU cores", "2026-11-26"
ROBOTS = {"go1": "g", "go2": "h", "anymal_c": "c", "anymal_d": "d"}
CONTROL = "2026-11-29", "724e00df"
WALKS = {  # of PPO, tuned to walk
    "g": ("2026-11-29", "34c7be27"),
    "h": CONTROL,
    "c": CONTROL,
    "d": ("2026-11-28", "503dba45"),
}
STARTS = "an H200 and slower hosts", "2026-11-24", "", "experiments/03_speed/kernel.md"

MEASURED = [  # name, value, unit, hardware, date, commit, source
    ("make train", "three to seven", "minutes", *CORES, "b9cc75e", f"a clock; {LAPTOP}"),
    ("make test", "seven to fifteen", "minutes", CORES[0], "2026-11-29", "edcf353b", "a clock"),
    ("notebooks", "ten", "minutes", "two CPU cores", "not noted", "", "a clock"),
    ("evaluate", "a minute or two", "", "two CPU cores", "not noted", "", "a clock"),
    ("start, cold", "20 to 35", "s", *STARTS),
    ("start, warm", "7 to 10", "s", *STARTS),
]

STATED = {  # name -> where, and the words
    "make train": [
        ("README.md", "a Go1 in {} minutes on two CPU cores"),
        ("README.md", "make train # a Go1 learns to walk on two CPU cores: {} minutes"),
        ("Makefile", "train a Go1 on two CPU cores, {} minutes with the set-up"),
    ],
    "make test": [
        ("README.md", "make test # the tests: {} minutes on two idle cores"),
        ("Makefile", "run the tests, {} minutes on two idle cores"),
    ],
    "notebooks": [("notebooks/README.md", "writes their outputs into them, in about {} minutes")],
    "evaluate": [
        ("docs/watch.md", "dynappo evaluate runs/go1 # {} on two cores"),
        ("dynappo/evaluate/command.py", "compiles and runs for {} on two cores"),
    ],
    "start, cold": [
        ("README.md", "the first time after {} s, because XLA compiles"),
        ("docs/troubleshooting.md", "The first start on a GPU takes {} s"),
        ("dynappo/run/show.py", "if cached, else {} s"),
    ],
    "start, warm": [
        ("README.md", "Training starts after {} s"),
        ("docs/troubleshooting.md", "Later starts take {} s"),
        ("dynappo/run/show.py", "{} s if cached"),
    ],
    "go1 walks": [
        ("README.md", "with falls in at most 1 %, after {:.2f} million"),
        ("docs/results.md", "a Go1 walks after {:.2f} M simulator steps"),
    ],
    "go2 walks": [("docs/results.md", "a Go2 after {:.2f} M")],
    "anymal_c walks": [("docs/results.md", "ANYmal-C and -D after {:.2f} and")],
    "anymal_d walks": [("docs/results.md", "and {:.2f} M. PPO alone")],
    "go1 first at 38": [
        ("experiments/README.md", "a model ([21](21_less/README.md)) | {:.2f} M"),
        ("README.md", "follows commands after {:.2f} million"),
        ("docs/speed.md", "1024 need {:.2f} M"),
    ],
    "go1 falls, first at 38": [
        ("README.md", "{:.1f} % of its episodes still have a fall"),
        ("docs/results.md", "(24), {:.1f} and 2.7 % of the episodes of Go1 and Go2"),
    ],
    "go1 PPO walks": [("README.md", "commands and {:.1f} million to walk")],
    "go1 PPO first at 38": [
        ("README.md", "needs {:.1f} million to follow"),
        ("experiments/README.md", " M) | {:.2f} M"),
    ],
    "go1 few, first at 38": [
        ("README.md", "follows commands after {:.1f} thousand steps"),
        ("experiments/README.md", "follows commands after {:.1f} thousand simulator steps"),
    ],
    "anymal_c few, first at 24": [
        ("README.md", "an ANYmal-C after {:.1f} thousand"),
        ("experiments/README.md", "an ANYmal-C after {:.1f} thousand"),
    ],
    "go1 symmetric SAC first at 38": [
        ("docs/results.md", "treat left and right alike is at 38 after {:.2f} M steps"),
        ("experiments/README.md", "SAC with symmetric networks needs {:.2f} M"),
        ("experiments/24_off_policy/README.md", "alike is there after {:.2f} M (the last"),
    ],
    "go1 CrossQ with 256 robots, first at 38": [
        ("experiments/README.md", "no model ([24](24_off_policy/README.md)) | {:.2f} M"),
        ("README.md", "model of them, follows commands after {:.2f} million,"),
        ("experiments/24_off_policy/README.md", "(Go1, today's task) after {:.2f} M simulator"),
    ],
    "go1 CrossQ with 64 robots, first at 38": [
        ("experiments/27_few/README.md", "CrossQ is at 38 after {:.0f},000 steps"),
        ("experiments/27_few/peers.md", "38 of 45, after {:.1f} thousand simulator steps"),
    ],
    "g1 walks": [
        ("experiments/README.md", "G1 walks after {:.2f} million steps"),
        ("README.md", "after {:.2f} million simulator steps (ten of ten"),
        ("docs/results.md", "`best` | {:.2f} ("),
    ],
    "g1 walks, last seed": [
        ("README.md", "the last after {:.2f}"),
        ("docs/results.md", "`best` | 0.70 ({:.2f})"),
    ],
    "g1 PPO walks": [
        ("experiments/README.md", "million steps, with PPO after {:.1f}"),
        ("README.md", "PPO alone {:.1f})"),
        ("docs/results.md", "PPO alone, 256 robots | {:.2f} ("),
    ],
    "go1 seconds to 38": [
        ("README.md", "follows commands after {:.1f} s of training"),
        ("docs/results.md", "alone on an H200 is at 38 after {:.1f} s"),
        ("docs/speed.md", "38 after 58 iterations, {:.1f} s;"),
        (ROW_COST, "instead of {:.2f} s to the level and 0.91"),
    ],
    "go1 seconds to a walk": [
        ("README.md", "s of training and walks after {:.1f}"),
        ("docs/results.md", "s and walks after {:.1f} (mean of five fresh seeds"),
        ("docs/speed.md", "s; walks after {:.1f} s (H200, five seeds)"),
        (ROW_COST, "instead of {:.2f} to a walk, for"),
    ],
    "go1 PPO seconds to 38": [
        ("README.md", "Go1, our kernel | 0.18 | 1.0 | {:.1f} |"),
        ("docs/results.md", "PPO with 2048 robots is at 38 after {:.1f} s"),
        ("docs/speed.md", "H200: Go1 is at 38 after {:.1f} instead of"),
        (ROW_COST, "its fastest setting, takes {:.2f} instead of"),
    ],
    "go1 PPO seconds to a walk": [
        ("README.md", "Go1, our kernel | 0.18 | 1.0 | 0.6 | 1.7 | {:.1f} |"),
        ("docs/results.md", "is at 38 after 0.6 s and walks after {:.1f}."),
        ("docs/speed.md", "walks after {:.1f} instead of"),
        (ROW_COST, "the level and {:.2f} instead of"),
    ],
    "go1 fast PPO's steps to 38, by best's": [
        ("README.md", "for 3 to {:.0f} times the steps"),
        ("docs/speed.md", "but {:.0f} times the simulator steps"),
        (ROW_COST, "a walk, for {:.0f} and"),
    ],
    "go1 fast PPO's steps to a walk, by best's": [
        (ROW_COST, "and {:.0f} times the steps."),
    ],
    "go1 seconds to 38, 16 physics steps": [
        ("docs/results.md", "a Go1 is at 38 after {:.2f} and 1.10 s"),
        ("experiments/README.md", "a Go1 is at its level after {:.2f} s with `best` and 0.95"),
        (ROW_COST, "a Go1 is at its level after {:.2f} s with `best` and 0.95"),
    ],
    "go1 PPO seconds to 38, 16 physics steps": [
        ("docs/results.md", "with PPO after {:.2f} and 1.36"),
        ("experiments/README.md", "s with `best` and {:.2f} with PPO at 0.39 ms"),
        (ROW_COST, "s with `best` and {:.2f} with PPO, which takes"),
    ],
    "go1 fast PPO's steps to 38, by best's, 16 physics steps": [
        (ROW_COST, "for {:.0f} times the steps (9.5 to 17)"),
    ],
    "go1 seconds to a walk, 16 physics steps": [
        (ROW_COST, "PPO takes 1.06 instead of {:.2f} s"),
    ],
    "go1 PPO seconds to a walk, 16 physics steps": [
        (ROW_COST, "told without a test, PPO takes {:.2f} instead of"),
    ],
    "go1 seconds to 38, 32 physics steps": [
        ("docs/results.md", "a Go1 is at 38 after 1.04 and {:.2f} s"),
        ("experiments/README.md", "at 0.39 ms, after {:.2f} and 1.36 at 0.56"),
        (ROW_COST, "At 0.56 ms it is {:.2f} and 1.36 s"),
    ],
    "go1 PPO seconds to 38, 32 physics steps": [
        ("docs/results.md", "with PPO after 0.95 and {:.2f} (five"),
        ("experiments/README.md", "at 0.39 ms, after 1.10 and {:.2f} at 0.56"),
        (ROW_COST, "At 0.56 ms it is 1.10 and {:.2f} s"),
    ],
    "go1 fast PPO's steps to 38, by best's, 32 physics steps": [
        (ROW_COST, "for {:.0f} times the steps (10 to 16)"),
    ],
    "go1 seconds to a walk, 32 physics steps": [
        (ROW_COST, "s, 1.56 instead of {:.2f}, and 2.29"),
    ],
    "go1 PPO seconds to a walk, 32 physics steps": [
        (ROW_COST, "s, {:.2f} instead of 1.92, and"),
    ],
    "go1 seconds to 38, 64 physics steps": [
        (ROW_COST, "it is shown (0.021): {:.2f} and 2.11 s"),
    ],
    "go1 PPO seconds to 38, 64 physics steps": [
        (ROW_COST, "it is shown (0.021): 1.25 and {:.2f} s"),
    ],
    "go1 fast PPO's steps to 38, by best's, 64 physics steps": [
        (ROW_COST, "for {:.0f} times the steps (8.6 to 21)"),
    ],
    "go1 seconds to a walk, 64 physics steps": [
        (ROW_COST, "1.92, and 2.29 instead of {:.2f}."),
    ],
    "go1 PPO seconds to a walk, 64 physics steps": [
        (ROW_COST, "1.92, and {:.2f} instead of 2.64."),
    ],
    "go1 seconds to 38, MuJoCo Warp": [
        ("README.md", "Go1, MuJoCo Warp's own step | 2.2 | {:.1f} |"),
        ("docs/results.md", "at 38 after {:.1f} instead of"),
        (ROW_COST, "`best` is faster: {:.2f} instead of"),
    ],
    "go1 PPO seconds to 38, MuJoCo Warp": [
        ("README.md", "Go1, MuJoCo Warp's own step | 2.2 | 1.7 | {:.1f} |"),
        ("docs/results.md", "instead of {:.1f} s, and walks"),
        (ROW_COST, "instead of {:.2f} s to the level and 3.10"),
    ],
    "go1 seconds to a walk, MuJoCo Warp": [
        ("README.md", "| 2.2 | 1.7 | 4.4 | {:.1f} |"),
        ("docs/results.md", "s, and walks after {:.1f} instead of"),
        (ROW_COST, "to the level and {:.2f} instead of 5.08"),
    ],
    "go1 PPO seconds to a walk, MuJoCo Warp": [
        ("README.md", "| 2.2 | 1.7 | 4.4 | 3.1 | {:.1f} |"),
        ("docs/results.md", "instead of {:.1f} (ten and five"),
        (ROW_COST, "instead of {:.2f} to a walk."),
    ],
    "go1 seconds to 38, MJX-JAX": [
        ("README.md", "| Go1, MJX-JAX | 5.6 | {:.1f} |"),
        ("docs/results.md", "it is at 38 after {:.1f} s and with PPO with 2048"),
        (ROW_COST, "a Go1 is at its level after {:.2f} s with `best` and after 11.80"),
    ],
    "go1 PPO seconds to 38, MJX-JAX": [
        ("README.md", "| Go1, MJX-JAX | 5.6 | 2.3 | {:.1f} |"),
        ("docs/results.md", "with PPO with 2048 robots after {:.1f} (five"),
        (ROW_COST, "and after {:.2f} with PPO with 2048 robots"),
    ],
    "go1 fast PPO's steps to 38, by best's, MJX-JAX": [
        ("docs/results.md", "for {:.0f} times the steps. A G1 at"),
        (ROW_COST, "for {:.0f} times the steps (12 to 18)"),
    ],
    "go1 PPO seconds to a walk, MJX-JAX": [
        ("README.md", "| 5.6 | 2.3 | 11.8 | four of five | {:.1f} |"),
        (ROW_COST, "PPO's five walk, after {:.2f} s, of"),
    ],
    "go1 seconds to 38, exact task": [
        ("README.md", "Go1, Isaac Lab's exact task | 2.3 | {:.1f} |"),
        ("docs/results.md", "a Go1 is at 38 after {:.1f} instead of 5.5 s, an ANYmal-C"),
        (ROW_COST, "at the level after {:.2f} instead of 5.47"),
    ],
    "go1 PPO seconds to 38, exact task": [
        ("README.md", "Go1, Isaac Lab's exact task | 2.3 | 3.5 | {:.1f} |"),
        ("docs/results.md", "instead of {:.1f} s, an ANYmal-C"),
        (ROW_COST, "instead of {:.2f} s on a Go1"),
    ],
    "go1 fast PPO's steps to 38, by best's, exact task": [(ROW_COST, "for {:.1f} and 11 times")],
    "anymal_c seconds to 24, exact task": [
        ("README.md", "ANYmal-C, Isaac Lab's exact task | 2.4 | {:.1f} |"),
        ("docs/results.md", "an ANYmal-C at 24 after {:.1f} instead of"),
        (ROW_COST, "and after {:.2f} instead of 7.53"),
    ],
    "anymal_c PPO seconds to 24, exact task": [
        ("README.md", "ANYmal-C, Isaac Lab's exact task | 2.4 | 2.8 | {:.1f} |"),
        ("docs/results.md", "instead of {:.1f} (five seeds each;"),
        (ROW_COST, "instead of {:.2f} s on an ANYmal-C"),
    ],
    "anymal_c fast PPO's steps to 24, by best's, exact task": [
        (ROW_COST, "for 6.4 and {:.0f} times the steps"),
    ],
    "g1 seconds to its level": [
        ("README.md", "G1, our kernel | 0.5 | {:.2f} |"),
        ("docs/results.md", "within the errors after {:.2f} s and walks"),
        ("docs/speed.md", "within the errors after {:.2f} s, walks"),
        ("experiments/25_humanoid/README.md", "after 3.13 instead of {:.2f} s"),
        ("experiments/25_humanoid/seconds.md", "and `best` after {:.2f} ±"),
        (ROW_COST, "a G1 is at its level after {:.2f} s with `best`"),
    ],
    "g1 PPO seconds to its level": [
        ("README.md", "G1, our kernel | 0.5 | 3.65 | {:.2f} |"),
        ("docs/results.md", "1024 robots and 12 rows after {:.2f} and"),
        ("experiments/25_humanoid/README.md", "than `best`, after {:.2f} instead of"),
        ("experiments/25_humanoid/seconds.md", "it is within the errors after {:.2f} ±"),
        (ROW_COST, "(ten fresh seeds) and {:.2f} with PPO (seven)"),
    ],
    "g1 fast PPO's steps to its level, by best's": [
        ("docs/results.md", "for {:.1f} times the steps, and of a walk"),
        ("experiments/25_humanoid/README.md", "for {:.1f} times the steps. To a walk"),
        ("experiments/25_humanoid/seconds.md", "for {:.1f} times the steps. To a walk"),
        (ROW_COST, "for {:.1f} times the steps. It breaks even"),
    ],
    "g1 seconds to a walk": [
        ("README.md", "G1, our kernel | 0.5 | 3.65 | 3.13 | {:.2f} |"),
        ("docs/results.md", "and walks after {:.2f} (ten fresh seeds)"),
        ("docs/speed.md", "walks after {:.2f} s (H200, ten seeds"),
        ("experiments/25_humanoid/README.md", "3.59 and {:.2f} s, and no"),
        ("experiments/25_humanoid/seconds.md", "± 0.59 and {:.2f} ±"),
        (ROW_COST, "To a walk it is {:.2f} and 3.59 s"),
    ],
    "g1 PPO seconds to a walk": [
        ("README.md", "G1, our kernel | 0.5 | 3.65 | 3.13 | 3.75 | {:.2f} |"),
        ("docs/results.md", "after 3.13 and {:.2f} (seven)"),
        ("experiments/25_humanoid/README.md", "To a walk it is {:.2f} and"),
        ("experiments/25_humanoid/seconds.md", "To a walk it is {:.2f} ±"),
        (ROW_COST, "it is 3.75 and {:.2f} s, and no difference"),
    ],
    "g1 seconds to its level, with settings for seconds": [
        ("docs/results.md", "`best` is within the errors after {:.2f} s (ten fresh seeds on"),
        ("docs/speed.md", "22 to 24 ms, within the errors after {:.2f} s (on a host"),
        (
            "experiments/25_humanoid/README.md",
            "`best` is within the errors after {:.2f} s (ten seeds of",
        ),
        ("experiments/25_humanoid/seconds.md", "3 epochs is within the errors after {:.2f} ±"),
        (ROW_COST, "3 epochs takes {:.2f} s (ten fresh seeds)"),
    ],
    "g1 seconds to its level, MuJoCo Warp": [
        ("README.md", "G1, MuJoCo Warp's own step | 4.4 | {:.1f} |"),
        ("docs/results.md", "A G1 at 4.4 ms is at its level after {:.1f} instead of"),
        ("docs/results.md", "it is {:.1f} instead of 14.9 s (five seeds each)"),
        ("experiments/25_humanoid/README.md", "it is {:.1f} instead of 14.9 s (five"),
        ("experiments/25_humanoid/README.md", "within the errors after {:.2f} s and PPO"),
        ("experiments/25_humanoid/seconds.md", "sooner: within the errors after {:.2f} ±"),
        (ROW_COST, "a G1 takes {:.2f} s with `best`"),
    ],
    "g1 PPO seconds to its level, MuJoCo Warp": [
        ("README.md", "G1, MuJoCo Warp's own step | 4.4 | 6.3 | {:.1f} |"),
        ("docs/results.md", "6.3 instead of {:.1f} s (five seeds each). It walks"),
        ("docs/results.md", "6.3 instead of {:.1f} s (five seeds each). With the"),
        ("experiments/25_humanoid/README.md", "6.3 instead of {:.1f} s (five"),
        ("experiments/25_humanoid/README.md", "s and PPO after {:.2f}. With"),
        ("experiments/25_humanoid/seconds.md", "12 rows after {:.2f} ±"),
        (ROW_COST, "and {:.2f} with PPO on the same card: 2.4 times"),
    ],
    "g1 fast PPO's steps to its level, by best's, MuJoCo Warp": [
        ("experiments/25_humanoid/seconds.md", "for {:.1f} times the steps. All five"),
        (ROW_COST, "for {:.1f} times the steps (4.3 to 5.9). Of `best`"),
    ],
    "g1 seconds to a walk, MuJoCo Warp": [
        ("README.md", "in the second all five, after {:.1f} s"),
        ("experiments/25_humanoid/seconds.md", "walk by their end, after {:.2f} and"),
        (ROW_COST, "Of the second run alone: after {:.2f} and 18.07 s"),
    ],
    "g1 PPO seconds to a walk, MuJoCo Warp": [
        ("README.md", "| 4.4 | 6.3 | 14.9 | seven of ten | {:.1f} |"),
        ("experiments/25_humanoid/seconds.md", "walk by their end, after 6.27 and {:.2f} s;"),
        (ROW_COST, "Of the second run alone: after 6.27 and {:.2f} s, 2.9"),
    ],
    "go2 seconds to its level, rough ground": [
        ("README.md", "Go2 on rough ground, our kernel | 0.3 | {:.1f} |"),
        ("docs/results.md", "a Go2 is at its level later, after {:.1f} s"),
        ("docs/speed.md", "at its level after 8.6 instead of {:.1f} s"),
        ("experiments/28_rough/README.md", "first at the level after {:.1f} s of training"),
        ("experiments/28_rough/time.md", "of tiles and {:.1f} to the level"),
        (ROW_COST, "a Go2 is at its level after {:.1f} s with `best`"),
    ],
    "go2 PPO seconds to its level, rough ground": [
        ("README.md", "Go2 on rough ground, our kernel | 0.3 | 15.0 | {:.1f} |"),
        ("docs/results.md", "PPO with 2048 robots after {:.1f} (five seeds each,"),
        ("docs/speed.md", "on rough ground is at its level after {:.1f} instead of"),
        ("experiments/28_rough/README.md", "in seconds, after {:.2f}; judged"),
        ("experiments/28_rough/time.md", "7.1 ({:.2f} judged about as often"),
        (ROW_COST, "PPO with 2048 robots on that host takes {:.2f} s"),
    ],
    "go2 seconds to its level, rough ground, with settings for seconds": [
        ("docs/speed.md", "on another host all, after {:.1f} s"),
        ("docs/results.md", "all five get there, after {:.1f} s."),
        ("experiments/28_rough/README.md", "all five get there, after {:.1f} s."),
        ("experiments/28_rough/time.md", "take 9.3, {:.1f} and 12.8"),
        (ROW_COST, "got there, [after {:.1f} s]"),
    ],
    "go2 fast PPO's steps to its level, by best's, rough ground": [
        ("experiments/28_rough/README.md", "it needs {:.1f} times the steps (2.6 to"),
        ("experiments/30_row_cost/runs.md", "it needs {:.1f} times the steps (2.6 to 4.0)"),
        ("README.md", "for {:.0f} to 12 times the steps"),
    ],
    "go2 crosses": [
        ("README.md", "crosses {:.0%} of all tiles of stairs"),
    ],
    "laptop return": [
        ("README.md", "evaluation: return {:.2f}"),
        ("notebooks/01_first_run.ipynb", "the return is {:.2f} and the tracking error"),
    ],
    "laptop tracking error": [
        ("README.md", "evaluation: tracking error {:.2f} m/s"),
        ("notebooks/01_first_run.ipynb", "and the tracking error {:.2f} m/s (README.md)"),
    ],
    "laptop seconds": [("README.md", "training {:.1f} s, after 24 s of set-up")],
}


def main():
    rows = [*measured(), *MEASURED]
    with NUMBERS.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows([COLUMNS, *rows])
    for line in wrong(read()):
        print(line)


def read() -> dict[str, dict[str, str]]:
    """The rows of docs/numbers.csv by name."""
    with NUMBERS.open(newline="") as file:
        return {row["name"]: row for row in csv.DictReader(file)}


def wrong(numbers: dict[str, dict[str, str]]) -> list[str]:
    """A line for each page that does not state a number as it should."""
    found = []
    for name, places in STATED.items():
        for page, words in places:
            text = " ".join(re.sub(r"[*]", "", (ROOT / page).read_text()).split())
            value = numbers[name]["value"]
            said = words.format(float(value) if re.search(r"{:", words) else value)
            if said.replace(" %", "%") not in text.replace(" %", "%"):
                found.append(f"{page} does not say {said!r} ({name}, docs/numbers.csv)")
    return found


def measured():
    """The rows that follow from results."""
    table = runpy.run_path(str(ROOT / "experiments/21_less/table.py"))
    jobs = table["read"](ROOT / HEADLINE)
    for robot, letter in ROBOTS.items():
        rest = "H200", *FRESH, HEADLINE
        again = "H200", *WALKS[letter], HEADLINE
        level_of = "H200", "2026-11-28", "71c94de1", HEADLINE
        for run, title in (("best", ""), ("ppo-level", " PPO"), ("ppo-walk", " PPO")):
            job = jobs[f"{run}-{letter}"]
            level = walks.level(table["best"](job))
            found = table["reached"](table["seeds"](job), level)
            if run != "ppo-level":
                yield (
                    f"{robot}{title} walks",
                    *million(found.walks),
                    *(rest if run == "best" else again),
                )
            if run != "ppo-walk":
                yield (
                    f"{robot}{title} first at {level:g}",
                    *million(found.level),
                    *(rest if run == "best" else level_of),
                )
        runs = table["seeds"](jobs[f"best-{letter}"])
        falls = 100 * np.mean([table["first"](run, level, "fall_rate") for run in runs])
        yield f"{robot} falls, first at {level:g}", f"{falls:.6g}", "%", *rest
    few = importlib.import_module("experiments.27_few.table")
    fresh = few.fresh(ROOT / FEW)
    for robot, level in (("go1", 38), ("anymal_c", 24)):
        job = fresh[few.ROBOTS[ROBOTS[robot]]]
        steps = f"{np.mean(table['reached'](table['seeds'](job), level).level) / 1e3:.6g}"
        when = "2026-11-28 to 29", "d4ea24ce and 60000061"
        yield f"{robot} few, first at {level}", steps, "thousand steps", "H200", *when, FEW
    yield from off_policy()
    yield from humanoid()
    yield from seconds()
    yield from rough()
    yield from laptop()


def off_policy():
    """Of other methods, with symmetric networks: SAC, of each seed the mean of two tries; CrossQ with many
    and with few robots."""
    peers = importlib.import_module("experiments.27_few.peers_table")

    def level(path, name=None):
        with (ROOT / path).open(newline="") as file:
            rows = [row for row in peers.runs.rows(file) if row.get("name") == name]
        return peers.runs.reached(peers.runs.seeds(rows), peers.LEVEL).level

    tries = [level(path, "sac-symmetric") for path in (SAC_FIRST, SAC)]  # the same seeds, in order
    rest = "H200", "2026-11-28", "d4ea24ce and e1fe5f03", f"{SAC_FIRST} {SAC}"
    yield "go1 symmetric SAC first at 38", *million(np.mean(tries, 0)), *rest
    rest = "H200", "2026-11-29", "94da69b8"
    yield "go1 CrossQ with 256 robots, first at 38", *million(level(CROSSQ)), *rest, CROSSQ
    name = "go1 CrossQ with 64 robots, first at 38"
    steps = f"{np.mean(level(CROSSQ_FEW)) / 1e3:.6g}"
    yield name, steps, "thousand steps", *rest, CROSSQ_FEW


def million(steps) -> tuple[str, str]:
    """Value and unit: mean of the seeds that get there, and how many do if not all."""
    there = np.isfinite(steps)
    some = "" if there.all() else f", {there.sum()} of {len(there)} seeds"
    return f"{np.nanmean(steps) / 1e6:.6g}", f"M steps{some}"


def humanoid():
    table = runpy.run_path(str(ROOT / "experiments/25_humanoid/table.py"))
    where = "four H100", "2026-11-26", "62c7c90", HUMANOID
    rows = [row for row in table["read"]("tuning.csv.xz") if row["batch"].startswith("fresh")]
    for name, title in (("best", ""), ("ppo", " PPO")):
        some = [
            row
            for row in rows
            if row["name"].split("-")[0] == name and 940 <= int(row["seed"]) < 950
        ]
        found = stats.reached_by_tracking(*table["evaluations"](some)).walks
        yield f"g1{title} walks", *million(found), *where
        yield f"g1{title} walks, last seed", f"{np.nanmax(found) / 1e6:.6g}", "M steps", *where


def seconds():
    table = importlib.import_module("experiments.30_row_cost.table")
    every = table.of_rows(table.read())
    walks = {"a walk": "walks"}
    for place, robot, engine, goals in (
        ("go1.kernel", "go1", "", {"38": "level"} | walks),
        ("go1.fine16", "go1", ", 16 physics steps", {"38": "level"} | walks),
        ("go1.fine32", "go1", ", 32 physics steps", {"38": "level"} | walks),
        ("go1.fine64", "go1", ", 64 physics steps", {"38": "level"} | walks),
        ("go1.warp", "go1", ", MuJoCo Warp", {"38": "level"} | walks),
        ("go1.jax", "go1", ", MJX-JAX", {"38": "level"}),
        ("go1.exact", "go1", ", exact task", {"38": "level"}),
        ("anymal_c.exact", "anymal_c", ", exact task", {"24": "level"}),
        ("g1.kernel", "g1", "", {"its level": "level"} | walks),
        ("g1.warp", "g1", ", MuJoCo Warp", {"its level": "level"} | walks),
        ("go2.rough", "go2", ", rough ground", {"its level": "level"}),
    ):
        best, ppos = table.settings(every, place)
        ppo = table.fastest_beside(best, ppos)
        for level, of in goals.items():
            (_, few, mine), (_, steps, its) = (getattr(run, of).mean(0) for run in (best, ppo))
            yield f"{robot} seconds to {level}{engine}", f"{mine:.6g}", "s", *where(best)
            yield f"{robot} PPO seconds to {level}{engine}", f"{its:.6g}", "s", *where(ppo)
            if place == "go2.rough":  # judged as often in steps, not in seconds
                steps = table.fewest(every, best, ppos).level[:, 1].mean()
            name = f"{robot} fast PPO's steps to {level}, by best's{engine}"
            yield name, f"{steps / few:.6g}", "", *where(ppo)
        if place == "go1.jax":  # not all of `best` walk
            name = f"{robot} PPO seconds to a walk{engine}"
            yield name, f"{ppo.walks[:, 2].mean():.6g}", "s", *where(ppo)
        if place in ("g1.kernel", "go2.rough"):
            quick = table.fastest(table.variants(every, best))
            name = f"{robot} seconds to its level{engine}, with settings for seconds"
            yield name, f"{quick.level[:, 2].mean():.6g}", "s", *where(quick)


def where(run) -> tuple[str, str, str, str]:
    """Hardware, date, commit and file of a run of `SECONDS`."""
    card, date = run.batch.split(", ")[:2]
    return card, date, COMMITS[run.batch], SECONDS


def rough():
    with lzma.open(ROOT / ROUGH, "rt", newline="") as file:  # rows of a seed are in order
        rows = [row for row in csv.DictReader(file) if row["name"] == "go2-best"]
    last = {row["seed"]: float(row["crossed"]) for row in rows}
    yield "go2 crosses", f"{np.mean([*last.values()]):.6g}", "", "two H200", *FRESH, ROUGH


def laptop():
    text = (ROOT / LAPTOP).read_text()
    for name, words, unit in (
        ("return", "evaluation: return +", ""),
        ("tracking error", "evaluation: tracking error +", "m/s"),
        ("seconds", "training +", "s"),
    ):
        (value,) = re.findall(words + "([0-9.]+)", text)
        yield f"laptop {name}", value, unit, CORES[0], "2026-11-27", "d188c4a", LAPTOP


if __name__ == "__main__":
    main()
