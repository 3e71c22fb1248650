"""What the tests of results share: the files of experiments/, and the tables and words of its pages."""

import csv
import functools
import importlib
import lzma
import re
import sys

import numpy as np
from answers import ROOT

from experiments import paper

EXPERIMENTS = ROOT / "experiments"
ROW_COST = "30_row_cost"
HUMANOID = EXPERIMENTS / "25_humanoid"
LESS = EXPERIMENTS / "21_less"
LETTERS = {"Go1": "g", "Go2": "h", "ANYmal-C": "c", "ANYmal-D": "d"}
DEPLOY = EXPERIMENTS / "22_deploy"


@functools.cache
def script(name):
    """The module FOLDER/NAME, imported as the script itself is: with its folder's other files."""
    folder, _, stem = name.partition("/")
    others = {path.stem for path in (EXPERIMENTS / folder).glob("*.py")}
    kept = {other: sys.modules.pop(other) for other in others & sys.modules.keys()}
    sys.path.insert(0, str(EXPERIMENTS / folder))
    try:
        return importlib.import_module(stem or "plot")
    finally:
        sys.path.pop(0)
        for other in others:
            sys.modules.pop(other, None)
        sys.modules.update(kept)


def shows(text, *values):
    """Whether the numbers in a cell are these, each to the digits that it has; what is halfway may go up or
    down."""
    numbers = re.findall(r"(?<![\w.])\d+(?:\.\d+)?", text)
    digits = [len(number.partition(".")[2]) for number in numbers]
    return len(numbers) == len(values) and all(
        abs(float(number) - value) <= 0.5 * 10.0**-count + 1e-9
        for number, count, value in zip(numbers, digits, values, strict=True)
    )


@functools.cache
def few_jobs(batch):
    """Jobs of a batch of 27_few by name."""
    return script("27_few/table").read(EXPERIMENTS / "27_few/results/gpu.csv.xz", batch)


@functools.cache
def few_of(batch, name):
    """Of a job of 27_few: seeds, and where each is first at its level and walks."""
    table = script("27_few/table")
    seeds = table.runs.seeds(few_jobs(batch)[name])
    return seeds, table.runs.reached(seeds, table.level_of(seeds[0]))


@functools.cache
def few_fresh(letter):
    """`few_of` all fresh seeds of today's `few` on a robot."""
    table = script("27_few/table")
    rows = table.fresh(EXPERIMENTS / "27_few/results/gpu.csv.xz")[table.ROBOTS[letter]]
    seeds = table.runs.seeds(rows)
    return seeds, table.runs.reached(seeds, table.level_of(rows))


def cells(line):
    """Of a row of a Markdown table, without bold."""
    return [cell.strip() for cell in line.replace("**", "").strip("| ").split("|")]


@functools.cache
def less(name):
    """The table script of 21_less, and a packed file of its runs."""
    table = script("21_less/table")
    return table, table.read(LESS / f"results/{name}.csv.xz")


@functools.cache
def packed(name):
    """`(batch, name) -> seed -> rows` of a packed file of 22_deploy."""
    found = {}
    with lzma.open(DEPLOY / f"{name}.csv.xz", "rt", newline="") as file:
        for row in csv.DictReader(file):
            job = found.setdefault((row["batch"], row["name"]), {})
            job.setdefault(row["seed"], []).append(row)
    return found


def column(job, name):
    """Of a job's seeds and evaluations, `[S, E]`."""
    return np.array([[float(row[name]) for row in rows] for rows in job.values()])


def reached_of(job, level):
    """Steps of each seed of a job of run.py to a return."""
    table, _ = less("ppo")
    return table.reached(table.seeds(job), level).level


def ours_of(name, results="headline"):
    """Steps of a job of the headline, or of another file."""
    table, jobs = less(results)
    return table.reached(table.seeds(jobs[name]), 38 if name[-1] in "gh" else 24)


def fields_of(path):
    """`name -> (robot, fields without those of run)` of a file of jobs."""
    found = {}
    for name, line in paper.jobs(LESS / path).items():
        robot, *fields = line.split()
        fields = dict(field.split("=", 1) for field in fields)
        found[name] = robot, {k: v for k, v in fields.items() if not k.startswith("run.")}
    return found


def around(one, digits=1, words=""):
    """4.8 times as long (3.7 to 7.0)"""
    return "{:.{d}f}{} ({:.{d}f} to {:.{d}f})".format(one[0], words, *one[1:], d=digits)


def of_host(table, host):
    """The rows of its jobs: name -> seed -> rows."""
    found = {}
    for row in table.read():
        if row["batch"] == host:
            found.setdefault(row["name"], {}).setdefault(row["seed"], []).append(row)
    return found


def row_cost_words(name):
    """A page of 30_row_cost in one line."""
    return " ".join((EXPERIMENTS / ROW_COST / f"{name}.md").read_text().split())


def headline(name):
    """The line of a job of 21_less/headline.txt."""
    lines = (EXPERIMENTS / "21_less/headline.txt").read_text().splitlines()
    (line,) = [line for line in lines if line.split()[0] == name]
    return f"{line} "
