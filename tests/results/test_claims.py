"""docs/numbers.csv follows from the results, and every page that states one of its numbers agrees."""

import csv
import re

import numpy as np
import pytest
from answers import ROOT

from experiments import claims


@pytest.fixture(scope="module")
def computed():
    return [*claims.measured(), *claims.MEASURED]


def test_the_file_is_what_the_results_say(computed):
    """Written again it is the same; each number has hardware, a date, and a source that is there."""
    with claims.NUMBERS.open(newline="") as file:
        assert [*csv.reader(file)] == [claims.COLUMNS, *map(list, computed)], (
            "experiments/claims.py"
        )
    names = [row[0] for row in computed]
    assert len({*names}) == len(names) and {*claims.STATED} <= {*names}
    for row in claims.read().values():
        assert row["hardware"] and row["date"]
        assert row["source"] == "a clock" or (ROOT / row["source"].split()[-1]).is_file()


def test_a_mean_of_some_seeds_says_of_how_many():
    """One of the ten ANYmal-D of PPO never walks."""
    assert claims.million(np.array([1e6, 2e6])) == ("1.5", "M steps")
    assert claims.million(np.array([1e6, np.nan])) == ("1", "M steps, 1 of 2 seeds")
    numbers = claims.read()
    some = [numbers[f"{robot} PPO walks"]["unit"] for robot in claims.ROBOTS]
    assert some == ["M steps"] * 3 + ["M steps, 9 of 10 seeds"]


def test_every_page_states_the_same_number():
    assert claims.wrong(claims.read()) == []


@pytest.mark.parametrize("name", claims.STATED)
def test_a_page_with_another_number_is_named(name):
    """Each place of each number: with another value in the file, its line names the page."""
    numbers = claims.read()
    value = numbers[name]["value"]
    other = "eleven" if not re.fullmatch("[0-9.]+", value) else str(2 * float(value))
    found = claims.wrong(numbers | {name: numbers[name] | {"value": other}})
    pages = sorted(page for page, _ in claims.STATED[name])
    assert sorted(line.split()[0] for line in found) == pages


def test_the_readme_shows_lines_of_a_run():
    """Of `make train`, as it was printed; spaces apart."""
    text = (ROOT / "README.md").read_text().partition("prints this")[2]
    shown = [line.split() for line in text.partition("\n\n")[2].partition("\n\n")[0].splitlines()]
    printed = [line.split() for line in (ROOT / claims.LAPTOP).read_text().splitlines()]
    assert len(shown) > 8 and all(line in printed for line in shown)
